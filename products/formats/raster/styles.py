"""Colour ramps, and the styles of every kind of raster.

The range of a style is fixed where the quantity has its own range (slope, aspect, hillshade), so
that a colour has the same meaning on every sol, and the layer's otherwise. viridis and inferno
increase in lightness and are readable without colour vision; twilight is cyclic, so that directions
of 359 and 1 degrees have similar colours; red-blue is light in the middle.
"""

from __future__ import annotations

from dataclasses import dataclass

from solmap.products.formats.raster.cog import RasterClass
from solmap.products.formats.raster.raster import HAZARD_CLASSES, VISIBILITY_CLASSES
from solmap.products.model import Layer, ProductKind

Ramp = tuple[str, ...]
"""Colours, `#rrggbb`, evenly spaced over a range."""


def _ramp(colours: str) -> Ramp:
    return tuple(colours.split())


GREY = ("#000000", "#ffffff")
VIRIDIS = _ramp("#440154 #472d7b #3b528b #2c728e #21918c #28ae80 #5ec962 #addc30 #fde725")
INFERNO = _ramp("#000004 #210c4a #57106e #8a226a #bc3754 #e45a31 #f98e09 #f9cb35 #fcffa4")
RED_BLUE = _ramp("#67001f #b2182b #d6604d #f4a582 #f7f7f7 #92c5de #4393c3 #2166ac #053061")
TWILIGHT = _ramp("#e2d9e2 #95b5c7 #6276ba #592a8f #2f1436 #741e4f #b25652 #cca389 #e2d9e2")
RAMPS: dict[str, Ramp] = {
    "grey": GREY,
    "viridis": VIRIDIS,
    "inferno": INFERNO,
    "red-blue": RED_BLUE,
    "twilight": TWILIGHT,
}
"""Colour ramps by the name used in tile requests."""


@dataclass(frozen=True, slots=True)
class TileStyle:
    """Colours of a quantity."""

    colours: Ramp
    range: tuple[float, float] | None = None
    """Values at the first and last colour; None for the layer's own."""
    unit: str = ""
    has_legend: bool = True
    band: str = ""
    """Name of the band to show; the first by default."""
    is_classes: bool = False
    """Values are classes, whose colours and names are in the file; they are not averaged."""
    classes: tuple[RasterClass, ...] = ()
    """The classes of a kind with fixed classes, for the legend."""
    is_colour: bool = False
    """Three bands are shown as red, green and blue, unchanged."""
    title: str = ""
    """Name of the quantity, if not that of the layer."""


STYLES = {
    ProductKind.DTM: TileStyle(VIRIDIS, unit="m"),
    ProductKind.ORTHOPHOTO: TileStyle(GREY, has_legend=False),
    ProductKind.ORBITAL: TileStyle(GREY, has_legend=False),
    ProductKind.SOURCES: TileStyle(GREY, has_legend=False, is_classes=True),
    ProductKind.COLOUR: TileStyle(GREY, has_legend=False, is_colour=True),
    ProductKind.SLOPE: TileStyle(INFERNO, (0.0, 40.0), "degree"),
    ProductKind.ASPECT: TileStyle(TWILIGHT, (0.0, 360.0), "degree"),
    ProductKind.NORTHERLY_TILT: TileStyle(RED_BLUE, (-20.0, 20.0), "degree"),
    ProductKind.ROUGHNESS: TileStyle(VIRIDIS, (0.0, 0.1), "m"),
    ProductKind.INSOLATION: TileStyle(INFERNO, unit="Wh/m2/sol"),
    ProductKind.VIEWSHED: TileStyle(GREY, is_classes=True, classes=VISIBILITY_CLASSES),
    ProductKind.HAZARD: TileStyle(GREY, is_classes=True, classes=HAZARD_CLASSES),
    ProductKind.HILLSHADE: TileStyle(GREY, (0.0, 1.0), has_legend=False),
    ProductKind.FAR_DTM: TileStyle(VIRIDIS, unit="m"),
    ProductKind.FAR_HILLSHADE: TileStyle(GREY, (0.0, 1.0), has_legend=False),
    ProductKind.REGION_DTM: TileStyle(VIRIDIS, unit="m"),
    ProductKind.REGION_ORTHOPHOTO: TileStyle(GREY, has_legend=False),
    ProductKind.REGION_SEAMS: TileStyle(INFERNO, (0.0, 0.3), "m"),
    ProductKind.REGION_HILLSHADE: TileStyle(GREY, (0.0, 1.0), has_legend=False),
    ProductKind.REGION_SLOPE: TileStyle(INFERNO, (0.0, 40.0), "degree"),
    ProductKind.REGION_ASPECT: TileStyle(TWILIGHT, (0.0, 360.0), "degree"),
    ProductKind.REGION_NORTHERLY_TILT: TileStyle(RED_BLUE, (-20.0, 20.0), "degree"),
    ProductKind.REGION_ROUGHNESS: TileStyle(VIRIDIS, (0.0, 0.1), "m"),
    ProductKind.REGION_INSOLATION: TileStyle(INFERNO, unit="Wh/m2/sol"),
    ProductKind.REGION_HAZARD: TileStyle(GREY, is_classes=True, classes=HAZARD_CLASSES),
}
"""Slopes end at 40 degrees: loose ground is not steeper, and rovers do not climb it."""


def range_of(style: TileStyle, layer: Layer) -> tuple[float, float]:
    """Values at the two ends of the colours."""
    low, high = style.range or layer.range or (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, low + 0.5)
