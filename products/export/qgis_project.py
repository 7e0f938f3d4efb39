"""QGIS projects: the layers of a map in groups, with the server's colours, in the map's own CRS.

A project (`.qgz`) is a ZIP archive with one XML document (`.qgs`). The elements are those written
by QGIS 3.22; omitted ones get QGIS's defaults, so that later versions also read it. Files are named
relative to the project. Each layer contains the CRS as WKT 2, so that no CRS database is needed;
distances are those of the map's plane (ellipsoid `NONE`).

Layers of the whole map come first, then regions and stops, each a group; vectors are above rasters.
Of a group the orthophoto, the contours and the outlines are initially visible, the others hidden.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import rasterio
from pyproj import CRS

from solmap.photogrammetry.terrain.dtm.grid import Bounds, union
from solmap.products.crs import MARS, LandingPoint, local_crs
from solmap.products.formats.raster.raster import band_names, class_names, open_raster
from solmap.products.formats.raster.styles import STYLES, TileStyle, range_of
from solmap.products.model import Layer, ProductKind, ScopeLevel

_VERSION = "3.22.0"
_DOCTYPE = b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
_DATE = (1980, 1, 1, 0, 0, 0)
"""Date of the document in the archive: equal layers give equal bytes."""
_DARKEST, _BRIGHTEST = 1, 255
"""Stored values of an 8-bit image; 0 is where it has no data."""


@dataclass(frozen=True, slots=True)
class VectorStyle:
    """How features are drawn: one colour, or one for each value of an attribute."""

    geometry: Literal["Point", "Line", "Polygon"]
    colour: str
    """`#rrggbb`; for polygons the outline."""
    size_mm: float
    """Diameter of a point, width of a line."""
    attribute: str = ""
    values: tuple[tuple[str, str], ...] = ()
    """Values of the attribute and their colours."""
    is_shown: bool = False
    """Visible when the project is opened."""


TELEMETRY, ADJUSTED = "#1769e0", "#e02d25"
"""As on the server's map: the traverse by telemetry is blue, adjusted red."""
_SOLUTIONS = (("adjusted", ADJUSTED), ("telemetry", TELEMETRY))
_TIES = (("intra-stereo", "#888888"), ("inter-stereo", "#44bb99"), ("cross-site", "#aa3377"))
_CONTOURS = VectorStyle("Line", "#8a4b14", 0.2, is_shown=True)
_HAVENS = VectorStyle("Polygon", "#0aa3c2", 0.4)
_PATH = VectorStyle("Line", ADJUSTED, 0.6, "solution", _SOLUTIONS, is_shown=True)
_STOPS = VectorStyle("Point", ADJUSTED, 2.4, "solution", _SOLUTIONS, is_shown=True)
VECTOR_STYLES = {
    ProductKind.TRAVERSE: _PATH,
    ProductKind.MISSION_TRAVERSE: VectorStyle("Line", ADJUSTED, 0.6, is_shown=True),
    ProductKind.STOPS: _STOPS,
    ProductKind.MISSION_STOPS: VectorStyle("Point", ADJUSTED, 1.6, is_shown=True),
    ProductKind.FOOTPRINTS: VectorStyle("Polygon", "#555555", 0.2),
    ProductKind.POINTING: VectorStyle("Line", "#0b8f86", 0.2),
    ProductKind.TIE_POINTS: VectorStyle("Point", "#888888", 1.0, "kind", _TIES),
    ProductKind.DIPS: VectorStyle("Point", "#222222", 2.0),
    ProductKind.CONTOURS: _CONTOURS,
    ProductKind.FAR_CONTOURS: _CONTOURS,
    ProductKind.REGION_CONTOURS: _CONTOURS,
    ProductKind.HAVENS: _HAVENS,
    ProductKind.REGION_HAVENS: _HAVENS,
}
_SHOWN_RASTERS = {
    ProductKind.ORTHOPHOTO,
    ProductKind.REGION_ORTHOPHOTO,
    ProductKind.HILLSHADE,
    ProductKind.REGION_HILLSHADE,
    ProductKind.FAR_HILLSHADE,
    ProductKind.ORBITAL,
}
_ORDER = [*VECTOR_STYLES, ProductKind.COLOUR, ProductKind.ORTHOPHOTO, *STYLES]
"""Order of layers in a group, the topmost first."""


@dataclass(frozen=True, slots=True)
class MapFile:
    """A layer of a map, and its file."""

    layer: Layer
    path: Path
    """A local file to read its bands and classes from."""
    href: str
    """Path relative to the project."""


def project_bytes(title: str, landing: LandingPoint, files: Sequence[MapFile]) -> bytes:
    """A QGIS project (`.qgz`) of the rasters and vectors among some files.

    Args:
        title: Title of the project's window.
        landing: Origin of the map; it decides the CRS.
        files: Layers to show; models and panoramas, which are not on a map, are left out, and so
            are layers without features.
    """
    shown = sorted(
        (f for f in files if f.layer.ref.kind in _ORDER and any(f.layer.bounds)),
        key=lambda file: _ORDER.index(file.layer.ref.kind),
    )
    crs = local_crs(landing)
    root = Element("qgis", projectname=title, version=_VERSION)
    SubElement(root, "title").text = title
    root.append(_crs(crs, "projectCrs"))
    tree = SubElement(root, "layer-tree-group")
    for name, members in _groups(shown).items():
        is_first = not tree.findall("layer-tree-group")
        group = SubElement(
            tree, "layer-tree-group", name=name, checked="Qt::Checked", expanded=str(int(is_first))
        )
        for file in members:
            group.append(_tree_layer(file))
    box = dict(zip(("xmin", "ymin", "xmax", "ymax"), map(repr, _extent(shown)), strict=True))
    view = SubElement(SubElement(root, "ProjectViewSettings"), "DefaultViewExtent", box)
    view.append(_crs(crs, "crs")[0])
    canvas = SubElement(root, "mapcanvas", name="theMapCanvas")
    SubElement(canvas, "units").text = "meters"
    extent = SubElement(canvas, "extent")
    for tag, value in box.items():
        SubElement(extent, tag).text = value
    canvas.append(_crs(crs, "destinationsrs"))
    layers = SubElement(root, "projectlayers")
    for file in shown:
        is_raster = file.layer.type == "raster"
        layers.append(_raster(file, crs) if is_raster else _vector(file, landing))
    properties = SubElement(root, "properties")
    system, measure = SubElement(properties, "SpatialRefSys"), SubElement(properties, "Measure")
    SubElement(system, "ProjectionsEnabled", type="int").text = "1"
    SubElement(measure, "Ellipsoid", type="QString").text = "NONE"
    indent(root, " ")
    return _archive(
        b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n" + tostring(root)
    )


def _archive(document: bytes) -> bytes:
    body = io.BytesIO()
    with zipfile.ZipFile(body, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(zipfile.ZipInfo("project.qgs", _DATE), document, zipfile.ZIP_DEFLATED)
    return body.getvalue()


def _groups(files: Sequence[MapFile]) -> dict[str, list[MapFile]]:
    """Files by subject: the whole map, its regions, then the stops, the last first."""
    groups: dict[tuple[int, str], list[MapFile]] = {}
    for file in files:
        scope = file.layer.ref.scope
        of_stop = scope.level is ScopeLevel.STOP
        is_vector = file.layer.type == "vector"
        key = (2, scope.name) if of_stop else (int("region" in scope.name), "")
        if not of_stop and not is_vector and key[0] == 0:
            key = (3, "")  # an orbital image is below everything
        groups.setdefault(key, []).append(file)
    named: dict[str, list[MapFile]] = {}
    stops = [key for key in groups if key[0] == 2]  # noqa: PLR2004 - as above
    latest = sorted(stops, key=lambda key: (groups[key][0].layer.sols, key[1]), reverse=True)
    for key in [(0, ""), *latest, (1, ""), (3, "")]:
        members = groups.get(key, [])
        if members:
            named[_group_title(key, members[0].layer)] = members
    return named


def _group_title(key: tuple[int, str], layer: Layer) -> str:
    if key[0] == 2:  # noqa: PLR2004 - a stop
        return ", ".join(layer.full_title.split(", ")[1:3])
    return {0: "Traverse and images", 1: "Merged map", 3: "Orbital image"}[key[0]]


def _tree_layer(file: MapFile) -> Element:
    kind = file.layer.ref.kind
    style = VECTOR_STYLES.get(kind)
    is_shown = style.is_shown if style else kind in _SHOWN_RASTERS
    return Element(
        "layer-tree-layer",
        id=_id(file),
        name=_name(file),
        source=file.href,
        providerKey="gdal" if file.layer.type == "raster" else "ogr",
        checked="Qt::Checked" if is_shown else "Qt::Unchecked",
        expanded="0",
    )


def _id(file: MapFile) -> str:
    """Identifier of a layer; QGIS replaces those of ten characters or fewer by its own."""
    return f"solmap_{file.layer.ref.scope}_{file.layer.ref.kind}".replace("-", "_")


def _name(file: MapFile) -> str:
    return file.layer.full_title


def _map_layer(file: MapFile, crs: CRS | None, provider: str) -> Element:
    """Elements common to layers of both types."""
    layer = Element("maplayer", type=file.layer.type)
    for tag, text in (("id", _id(file)), ("datasource", file.href), ("layername", _name(file))):
        SubElement(layer, tag).text = text
    if crs is not None:
        layer.append(_crs(crs, "srs"))
    SubElement(layer, "provider").text = provider
    return layer


def _crs(crs: CRS, tag: str) -> Element:
    element = Element(tag)
    system = SubElement(element, "spatialrefsys")
    SubElement(system, "wkt").text = crs.to_wkt()
    SubElement(system, "description").text = crs.name
    return element


def _extent(files: Sequence[MapFile]) -> Bounds:
    """The box of all rasters; of all features if there are none."""
    boxes = [file.layer.bounds for file in files if file.layer.type == "raster"]
    boxes = boxes or [file.layer.bounds for file in files]
    return union(boxes) if boxes else (0.0, 0.0, 1.0, 1.0)


def _raster(file: MapFile, crs: CRS) -> Element:
    layer = _map_layer(file, crs, "gdal")
    style = STYLES[file.layer.ref.kind]
    with open_raster(file.path) as dataset:
        SubElement(layer, "pipe").append(_renderer(dataset, file.layer, style))
    return layer


def _renderer(dataset: rasterio.DatasetReader, layer: Layer, style: TileStyle) -> Element:
    renderer = Element("rasterrenderer", opacity="1", alphaBand="-1")
    if style.is_classes:
        renderer.set("type", "paletted")
        renderer.set("band", "1")
        palette, colours = SubElement(renderer, "colorPalette"), dataset.colormap(1)
        for value, name in class_names(dataset).items():
            colour = f"#{bytes(colours[value][:3]).hex()}"
            entry = {"value": str(value), "label": name, "color": colour, "alpha": "255"}
            SubElement(palette, "paletteEntry", entry)
    elif style.is_colour:
        renderer.set("type", "multibandcolor")
        for band, name in enumerate(("red", "green", "blue"), start=1):
            renderer.set(f"{name}Band", str(band))
            _stretch(renderer, f"{name}ContrastEnhancement", dataset, band)
    elif dataset.dtypes[0] == "uint8":
        renderer.set("type", "singlebandgray")
        renderer.set("grayBand", "1")
        renderer.set("gradient", "BlackToWhite")
        _stretch(renderer, "contrastEnhancement", dataset, 1)
    else:
        band = band_names(dataset).index(style.band) + 1 if style.band else 1
        renderer.set("type", "singlebandpseudocolor")
        renderer.set("band", str(band))
        _ramp(renderer, style, range_of(style, layer))
    return renderer


def _stretch(renderer: Element, tag: str, dataset: rasterio.DatasetReader, band: int) -> None:
    """Black and white of an 8-bit band; QGIS applies its scale and offset."""
    scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
    element = SubElement(renderer, tag)
    for name, stored in (("minValue", _DARKEST), ("maxValue", _BRIGHTEST)):
        SubElement(element, name).text = repr(float(scale * stored + offset))
    SubElement(element, "algorithm").text = "StretchToMinimumMaximum"


def _ramp(renderer: Element, style: TileStyle, ends: tuple[float, float]) -> None:
    low, high = ends
    renderer.set("classificationMin", repr(low))
    renderer.set("classificationMax", repr(high))
    shader = SubElement(
        SubElement(renderer, "rastershader"),
        "colorrampshader",
        colorRampType="INTERPOLATED",
        classificationMode="1",
        minimumValue=repr(low),
        maximumValue=repr(high),
        clip="0",
    )
    values = np.linspace(low, high, len(style.colours)).tolist()
    for value, colour in zip(values, style.colours, strict=True):
        label = f"{value:.4g} {style.unit}".strip()
        SubElement(shader, "item", value=repr(value), label=label, color=colour, alpha="255")


def _vector(file: MapFile, landing: LandingPoint) -> Element:
    style = VECTOR_STYLES[file.layer.ref.kind]
    # Features are in degrees of Mars; those of an untied map are in its own metres.
    crs = local_crs(landing) if landing.origin else CRS.from_user_input(MARS)
    layer = _map_layer(file, crs, "ogr")
    layer.set("geometry", style.geometry)
    renderer = SubElement(layer, "renderer-v2")
    symbols = Element("symbols")
    if style.attribute:
        renderer.set("type", "categorizedSymbol")
        renderer.set("attr", style.attribute)
        categories = SubElement(renderer, "categories")
        for number, (value, colour) in enumerate(style.values):
            texts = {"value": value, "label": value, "symbol": str(number), "render": "true"}
            SubElement(categories, "category", texts)
            symbols.append(_symbol(style, colour, number))
    else:
        renderer.set("type", "singleSymbol")
        symbols.append(_symbol(style, style.colour, 0))
    renderer.append(symbols)
    return layer


def _symbol(style: VectorStyle, colour: str, number: int) -> Element:
    kind, classes = {
        "Point": ("marker", "SimpleMarker"),
        "Line": ("line", "SimpleLine"),
        "Polygon": ("fill", "SimpleFill"),
    }[style.geometry]
    symbol = Element("symbol", {"type": kind, "name": str(number), "alpha": "1"})
    layer = SubElement(symbol, "layer", {"class": classes, "enabled": "1", "pass": "0"})
    rgba = ",".join(str(int(colour[i : i + 2], 16)) for i in (1, 3, 5))
    size = f"{style.size_mm:g}"
    for key, value in {
        "marker": {"name": "circle", "color": f"{rgba},255", "size": size, "size_unit": "MM"},
        "line": {"line_color": f"{rgba},255", "line_width": size, "line_width_unit": "MM"},
        "fill": {
            "color": f"{rgba},40",
            "outline_color": f"{rgba},255",
            "outline_width": size,
            "outline_width_unit": "MM",
        },
    }[kind].items():
        SubElement(layer, "prop", k=key, v=value)
    return symbol
