"""How each kind of raster is coloured, what else is drawn of it, and the legend that says so.

The range of a style is fixed where the quantity has one of its own (slope, aspect, hillshade), so
that a colour means the same on every sol, and the layer's otherwise. What is drawn of a terrain
model beside its elevation is computed for every tile (`rendering.shading`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from solmap.gis_server.rendering.colours import GREY, INFERNO, RED_BLUE, TWILIGHT, VIRIDIS, Ramp
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.raster.cog import RasterClass
from solmap.products.formats.raster.raster import HAZARDS, SIGHTS
from solmap.products.model import Layer, ProductKind

DEFAULT = "default"
"""The style of a kind that is drawn unless another is asked for."""


@dataclass(frozen=True, slots=True)
class Style:
    """Colours of a quantity."""

    colours: Ramp
    range: tuple[float, float] | None = None
    """Values at the first and last colour; None for the layer's own."""
    unit: str = ""
    has_legend: bool = True
    band: str = ""
    """Name of the band that is drawn; the first by default."""
    is_classes: bool = False
    """Values are classes, whose colours and names the file itself has; nothing is averaged."""
    classes: tuple[RasterClass, ...] = ()
    """The classes of a kind that always has the same, for the legend."""
    is_colour: bool = False
    """Three bands are shown as red, green and blue, as they are."""
    title: str = ""
    """What it shows, where that is not what the layer is called."""


STYLES = {
    ProductKind.DTM: Style(VIRIDIS, unit="m"),
    ProductKind.ORTHOPHOTO: Style(GREY, has_legend=False),
    ProductKind.ORBITAL: Style(GREY, has_legend=False),
    ProductKind.SOURCES: Style(GREY, has_legend=False, is_classes=True),
    ProductKind.COLOUR: Style(GREY, has_legend=False, is_colour=True),
    ProductKind.SLOPE: Style(INFERNO, (0.0, 40.0), "degree"),
    ProductKind.ASPECT: Style(TWILIGHT, (0.0, 360.0), "degree"),
    ProductKind.NORTHERLY_TILT: Style(RED_BLUE, (-20.0, 20.0), "degree"),
    ProductKind.ROUGHNESS: Style(VIRIDIS, (0.0, 0.1), "m"),
    ProductKind.INSOLATION: Style(INFERNO, unit="Wh/m2/sol"),
    ProductKind.VIEWSHED: Style(GREY, is_classes=True, classes=SIGHTS),
    ProductKind.HAZARD: Style(GREY, is_classes=True, classes=HAZARDS),
    ProductKind.HILLSHADE: Style(GREY, (0.0, 1.0), has_legend=False),
    ProductKind.FAR_DTM: Style(VIRIDIS, unit="m"),
    ProductKind.FAR_HILLSHADE: Style(GREY, (0.0, 1.0), has_legend=False),
    ProductKind.REGION_DTM: Style(VIRIDIS, unit="m"),
    ProductKind.REGION_SEAMS: Style(INFERNO, (0.0, 0.3), "m"),
    ProductKind.REGION_HILLSHADE: Style(GREY, (0.0, 1.0), has_legend=False),
    ProductKind.REGION_SLOPE: Style(INFERNO, (0.0, 40.0), "degree"),
    ProductKind.REGION_ASPECT: Style(TWILIGHT, (0.0, 360.0), "degree"),
    ProductKind.REGION_NORTHERLY_TILT: Style(RED_BLUE, (-20.0, 20.0), "degree"),
    ProductKind.REGION_ROUGHNESS: Style(VIRIDIS, (0.0, 0.1), "m"),
    ProductKind.REGION_INSOLATION: Style(INFERNO, unit="Wh/m2/sol"),
    ProductKind.REGION_HAZARD: Style(GREY, is_classes=True, classes=HAZARDS),
}
"""Slopes end at 40 degrees: loose ground is no steeper, and no rover climbs it."""

ELEVATIONS = (ProductKind.DTM, ProductKind.FAR_DTM, ProductKind.REGION_DTM)
PICTURES = {ProductKind.ORTHOPHOTO, ProductKind.ORBITAL, ProductKind.COLOUR} | {
    kind for kind, style in STYLES.items() if style.is_classes
}
"""Kinds of eight bits; all others are rasters of 32-bit floats and have tiles of values."""

_NORTH_FACING = Style(RED_BLUE, (-20.0, 20.0), "degree", title="Slopes that face north")
_OF_TERRAIN = {
    "hillshade": Style(GREY, (0.0, 1.0), has_legend=False, title="Hillshade"),
    "shaded-relief": Style(VIRIDIS, unit="m", title="Elevation, shaded"),
    "slope": Style(INFERNO, (0.0, 40.0), "degree", title="Slope"),
    "aspect": Style(TWILIGHT, (0.0, 360.0), "degree", title="Aspect"),
    "northerly-tilt": Style(RED_BLUE, (-20.0, 20.0), "degree", title="Tilt towards north"),
    "north-facing": _NORTH_FACING,
    "uncertainty": Style(
        INFERNO, (0.0, 0.5), "m", band="standard_deviation", title="Standard deviation of elevation"
    ),
    "contours": Style(("#8c4a12",), has_legend=False, title="Contours"),
}
_OF_SLOPE = {
    "uncertainty": Style(
        INFERNO,
        (0.0, 5.0),
        "degree",
        band="standard_deviation",
        title="Standard deviation of slope",
    )
}
_MORE = {
    **dict.fromkeys(ELEVATIONS, _OF_TERRAIN),
    ProductKind.SLOPE: _OF_SLOPE,
    ProductKind.REGION_SLOPE: _OF_SLOPE,
    ProductKind.NORTHERLY_TILT: {"north-facing": _NORTH_FACING},
    ProductKind.REGION_NORTHERLY_TILT: {"north-facing": _NORTH_FACING},
}


def styles_of(kind: ProductKind) -> dict[str, Style]:
    """All styles of a kind of raster by name, the default first.

    Raises:
        ProductNotFoundError: products of that kind are not drawn as tiles.
    """
    try:
        return {DEFAULT: STYLES[kind], **_MORE.get(kind, {})}
    except KeyError:
        drawn = ", ".join(STYLES)
        raise ProductNotFoundError(f"{kind} has no tiles; {drawn} have") from None


def range_of(style: Style, layer: Layer) -> tuple[float, float]:
    """Values at the two ends of the colours."""
    low, high = style.range or layer.range or (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def legend_of(layer: Layer, style: Style | None = None) -> dict[str, Any] | None:
    """Value and colour along the range, for what needs explaining; by default the kind's style."""
    style = style or STYLES.get(layer.ref.kind)
    if style is None or not style.has_legend:
        return None
    if style.is_classes:
        named = [{"name": one.name, "colour": one.colour} for one in style.classes]
        return {"stops": [], "unit": "", "classes": named}
    values = np.linspace(*range_of(style, layer), len(style.colours))
    stops = [[round(float(v), 3), colour] for v, colour in zip(values, style.colours, strict=True)]
    return {"stops": stops, "unit": style.unit or layer.unit or ""}
