"""How each kind of raster is coloured, and the legend that says so.

A style turns values into palette indices: 0 is transparent (not measured), 1 to 255 run from the
low to the high end of its range. The range is fixed where the quantity has one of its own (slope,
aspect, hillshade), so that a colour means the same on every sol, and the layer's otherwise.

Colours: viridis and inferno rise in lightness and read well without colour vision; aspect is cyclic
(twilight), so that 359 and 1 degrees look alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from products.classes import HAZARDS, SIGHTS
from products.cog import RasterClass
from products.errors import ProductNotFoundError
from products.model import Layer, ProductKind

_LEVELS = 254
"""Steps between index 1 and index 255."""


def _ramp(colours: str) -> tuple[str, ...]:
    return tuple(colours.split())


GREY = ("#000000", "#ffffff")
VIRIDIS = _ramp("#440154 #472d7b #3b528b #2c728e #21918c #28ae80 #5ec962 #addc30 #fde725")
INFERNO = _ramp("#000004 #210c4a #57106e #8a226a #bc3754 #e45a31 #f98e09 #f9cb35 #fcffa4")
RED_BLUE = _ramp("#67001f #b2182b #d6604d #f4a582 #f7f7f7 #92c5de #4393c3 #2166ac #053061")
TWILIGHT = _ramp("#e2d9e2 #95b5c7 #6276ba #592a8f #2f1436 #741e4f #b25652 #cca389 #e2d9e2")


@dataclass(frozen=True, slots=True)
class Style:
    """Colours of a kind of raster."""

    colours: tuple[str, ...]
    """Evenly spaced over the range, `#rrggbb`."""
    range: tuple[float, float] | None = None
    """Values at the first and last colour; None for the layer's own."""
    unit: str = ""
    has_legend: bool = True
    band: int = 1
    is_classes: bool = False
    """Values are classes, whose colours and names the file itself has; nothing is averaged."""
    classes: tuple[RasterClass, ...] = ()
    """The classes of a kind that always has the same, for the legend."""
    is_colour: bool = False
    """Three bands are shown as red, green and blue, as they are."""


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


PICTURES = {ProductKind.ORTHOPHOTO, ProductKind.ORBITAL, ProductKind.COLOUR} | {
    kind for kind, style in STYLES.items() if style.is_classes
}
"""Kinds of eight bits; all others are rasters of 32-bit floats and have tiles of values."""


def style_of(kind: ProductKind) -> Style:
    """The style of a kind of raster.

    Raises:
        ProductNotFoundError: products of that kind are not drawn as tiles.
    """
    try:
        return STYLES[kind]
    except KeyError:
        drawn = ", ".join(STYLES)
        raise ProductNotFoundError(f"{kind} has no tiles; {drawn} have") from None


def palette_of(style: Style) -> np.ndarray:
    """256 rows of red, green and blue; row 0 is never seen."""
    anchors = np.array([_rgb(colour) for colour in style.colours], dtype=np.float64)
    at = np.linspace(0.0, 1.0, len(anchors))
    where = np.concatenate([[0.0], np.linspace(0.0, 1.0, _LEVELS + 1)])
    channels = [np.interp(where, at, anchors[:, channel]) for channel in range(3)]
    return np.rint(np.column_stack(channels)).astype(np.uint8)


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


PALETTES = {kind: palette_of(style) for kind, style in STYLES.items()}


def range_of(style: Style, layer: Layer) -> tuple[float, float]:
    """Values at the two ends of the colours."""
    low, high = style.range or layer.range or (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def indices_of(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Palette indices of float values; NaN becomes 0.

    Stored 8-bit pictures are palette indices already and pass through.
    """
    if values.dtype == np.uint8:
        return values
    steps = (values - np.float32(low)) * np.float32(_LEVELS / (high - low)) + np.float32(1.5)
    measured = np.isfinite(steps)
    np.clip(steps, 1.0, 255.0, out=steps)
    return np.where(measured, steps, 0.0).astype(np.uint8)


def legend_of(layer: Layer) -> dict[str, object] | None:
    """Value and colour along the range, for kinds whose colours need explaining."""
    style = STYLES.get(layer.ref.kind)
    if style is None or not style.has_legend:
        return None
    if style.is_classes:
        named = [{"name": one.name, "colour": one.colour} for one in style.classes]
        return {"stops": [], "unit": "", "classes": named}
    values = np.linspace(*range_of(style, layer), len(style.colours))
    stops = [[round(float(v), 3), colour] for v, colour in zip(values, style.colours, strict=True)]
    return {"stops": stops, "unit": style.unit or layer.unit or ""}
