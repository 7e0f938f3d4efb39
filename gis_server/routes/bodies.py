"""The bodies of answers, and how catalogue records become them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from pydantic import BaseModel

from solmap.gis_server.rendering.identify import FeatureFound, Identified, LayerValue
from solmap.gis_server.rendering.styles import PICTURES, STYLES, legend_of, range_of
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, Bounds, union
from solmap.products.catalogue.catalogue import ImageEntry, MissionEntry
from solmap.products.crs import LandingPoint, local_crs, local_proj4, lon_lat
from solmap.products.formats.raster.tiling import CELL_SIZES, EXTENT, whole_zoom_of, zoom_of
from solmap.products.model import Layer

_NO_LAYERS: Bounds = (-50.0, -50.0, 50.0, 50.0)
"""Shown of a mission with nothing on its map yet, metres."""
_ZOOMS_OUT = 3
"""Zooms below that at which a layer fills one tile: there it is 32 pixels, then a dot."""


class Landing(BaseModel):
    """Where the map is tied to Mars."""

    name: str
    longitude: float
    latitude: float
    radius_m: float
    source: str


class LocalCrs(BaseModel):
    """The map's coordinate system, as WKT2 and for proj4js."""

    wkt: str
    proj4: str


class TileMatrixSet(BaseModel):
    """How the map is cut into tiles."""

    extent: Bounds
    cell_sizes: tuple[float, ...]
    tile_size: int


class Mission(BaseModel):
    """A mission and its map; `bounds` hold all its layers, metres."""

    mission: str
    title: str
    landing: Landing
    crs: LocalCrs
    lsl_note: str | None
    tile_matrix_set: TileMatrixSet
    bounds: Bounds


class LegendClass(BaseModel):
    """A class of ground and its colour."""

    name: str
    colour: str


class Legend(BaseModel):
    """Values and their colours, or classes and theirs."""

    stops: list[tuple[float, str]]
    unit: str
    classes: list[LegendClass] = []


class MapLayer(BaseModel):
    """A layer of the map and the addresses of its parts."""

    id: str
    scope: str
    level: str
    kind: str
    digest: str
    title: str
    type: Literal["raster", "vector"]
    bounds: Bounds
    cell_m: float | None
    minzoom: int
    maxzoom: int
    unit: str | None
    range: tuple[float, float] | None
    sols: tuple[int, ...]
    made_at: str
    tiles: str | None
    values: str | None
    """Tiles of values, for shading in the browser."""
    styles: str | None
    """What `style` of a tile may be, with legends."""
    features: str | None
    legend: Legend | None
    download: str
    provenance: str


class Image(BaseModel):
    """An image of the rover and the addresses of its files."""

    id: str
    mission: str
    stop: str
    site: int
    drive: int
    sol: int
    instrument: str
    eye: str
    product_type: str
    start_time: str | None
    local_solar_time: str | None
    partner: str | None
    unpaired_because: str | None
    browse: str
    original: str


class ValueHere(BaseModel):
    """A raster layer's value at a place."""

    id: str
    scope: str
    kind: str
    title: str
    value: float
    sigma: float | None
    unit: str | None
    label: str | None
    """What the value stands for, where it is a class: an image's name, a kind of ground."""
    bands: dict[str, float] = {}
    """All bands of the layer by name, such as standard deviation and observations."""


class FeatureHere(BaseModel):
    """A feature at or near a place."""

    layer: str
    kind: str
    title: str
    id: str | None
    distance_m: float
    properties: dict[str, Any]


class Place(BaseModel):
    """All that is known of a place: metres of the local map, degrees of Mars, layers, features."""

    east: float
    north: float
    lon: float
    lat: float
    elevation_m: float | None
    elevation_sigma_m: float | None
    layers: list[ValueHere]
    features: list[FeatureHere]


def mission_body(entry: MissionEntry, layers: Iterable[Layer]) -> Mission:
    """A mission and the extent of its layers."""
    landing = entry.landing
    return Mission(
        mission=entry.mission,
        title=entry.title,
        landing=Landing.model_validate(landing, from_attributes=True),
        crs=LocalCrs(wkt=local_crs(landing).to_wkt(), proj4=local_proj4(landing)),
        lsl_note=entry.lsl_note,
        tile_matrix_set=TileMatrixSet(extent=EXTENT, cell_sizes=CELL_SIZES, tile_size=BLOCK),
        bounds=_around(layer.bounds for layer in layers),
    )


def _around(boxes: Iterable[Bounds]) -> Bounds:
    filled = [box for box in boxes if any(box)]  # a layer without features is published as 0 0 0 0
    return union(filled) if filled else _NO_LAYERS


def layer_body(layer: Layer) -> MapLayer:
    """A layer and its addresses."""
    ref = layer.ref
    place = f"{ref.scope.name}/{ref.kind}/{ref.digest}"
    style = STYLES.get(ref.kind) if layer.type == "raster" else None
    is_vector = layer.type == "vector"
    return MapLayer(
        id=layer.id,
        scope=ref.scope.name,
        level=str(ref.scope.level),
        kind=str(ref.kind),
        digest=ref.digest,
        title=layer.title,
        type="vector" if is_vector else "raster",
        bounds=layer.bounds,
        cell_m=layer.cell_m,
        minzoom=max(0, whole_zoom_of(layer.bounds) - _ZOOMS_OUT),
        maxzoom=len(CELL_SIZES) - 1 if layer.cell_m is None else zoom_of(layer.cell_m),
        unit=layer.unit,
        range=range_of(style, layer) if style and layer.range else layer.range,
        sols=layer.sols,
        made_at=layer.made_at,
        tiles=f"/tiles/{place}/{{z}}/{{x}}/{{y}}.png" if style else None,
        values=_values_of(layer, place) if style else None,
        styles=f"/api/layers/{place}/styles" if style else None,
        features=f"/api/layers/{place}/features.geojson" if is_vector else None,
        legend=Legend.model_validate(legend) if (legend := legend_of(layer)) else None,
        download=f"/download/{place}",
        provenance=f"/api/layers/{place}/provenance",
    )


def _values_of(layer: Layer, place: str) -> str | None:
    is_picture = layer.ref.kind in PICTURES
    return None if is_picture else f"/tiles/{place}/{{z}}/{{x}}/{{y}}.values"


def image_body(entry: ImageEntry) -> Image:
    """An image and its addresses."""
    known = {name: getattr(entry, name) for name in Image.model_fields if hasattr(entry, name)}
    known["browse"] = f"/images/{entry.id}/browse.png"
    known["original"] = f"/images/{entry.id}/original"
    return Image.model_validate(known)


def place_body(landing: LandingPoint, east: float, north: float, found: Identified) -> Place:
    """A place and what was found there."""
    longitude, latitude = (float(degrees[0]) for degrees in lon_lat(landing, east, north))
    elevation = found.elevation
    return Place(
        east=east,
        north=north,
        lon=round(longitude, 9),
        lat=round(latitude, 9),
        elevation_m=elevation.value if elevation else None,
        elevation_sigma_m=elevation.sigma if elevation else None,
        layers=[_value_body(value) for value in found.values],
        features=[_feature_body(feature) for feature in found.features],
    )


def _value_body(value: LayerValue) -> ValueHere:
    layer = value.layer
    return ValueHere(
        id=layer.id,
        scope=layer.ref.scope.name,
        kind=str(layer.ref.kind),
        title=layer.title,
        value=value.value,
        sigma=value.sigma,
        label=value.label,
        bands=value.bands,
        unit=layer.unit,
    )


def _feature_body(found: FeatureFound) -> FeatureHere:
    return FeatureHere(
        layer=found.layer.id,
        kind=str(found.layer.ref.kind),
        title=found.layer.title,
        id=found.id,
        distance_m=found.distance_m,
        properties=found.properties,
    )
