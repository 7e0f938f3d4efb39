"""Colours of tiles: palettes, the available styles, and their legends.

The styles of every kind of raster are those of `products.formats.raster.styles`. Quantities derived
from a terrain model are computed for every tile (`rendering.painting`).

Index 0 of a palette is transparent (not measured), 1 to 255 run from the low to the high end of
a range.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Annotated

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.raster.cog import RasterClass
from solmap.products.formats.raster.styles import (
    GREY,
    INFERNO,
    RAMPS,
    RED_BLUE,
    STYLES,
    TWILIGHT,
    VIRIDIS,
    Ramp,
    TileStyle,
    range_of,
)
from solmap.products.model import Layer, ProductKind

LEVELS = 254
"""Steps between index 1 and index 255."""


@lru_cache(maxsize=64)
def palette_of(ramp: Ramp) -> np.ndarray:
    """256 rows of red, green and blue; row 0 is never seen."""
    anchors = np.array([_rgb(colour) for colour in ramp], dtype=np.float64)
    at = np.linspace(0.0, 1.0, len(anchors))
    where = np.concatenate([[0.0], np.linspace(0.0, 1.0, LEVELS + 1)])
    channels = [np.interp(where, at, anchors[:, channel]) for channel in range(3)]
    palette = np.rint(np.column_stack(channels)).astype(np.uint8)
    palette.setflags(write=False)
    return palette


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


def stretch_palette(palette: np.ndarray, low: float, high: float) -> np.ndarray:
    """The palette of an image whose indices `low` and `high` are its black and its white."""
    index = np.clip((np.arange(256) - low) / (high - low) * LEVELS + 1.5, 1, 255)
    return palette[index.astype(int)]


def indices_of(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Palette indices of float values; NaN becomes 0."""
    steps = (values - np.float32(low)) * np.float32(LEVELS / (high - low)) + np.float32(1.5)
    np.clip(steps, 1.0, 255.0, out=steps)
    np.copyto(steps, 0.0, where=np.isnan(steps))
    return steps.astype(np.uint8)


DEFAULT = "default"
"""The default style of a kind."""


ELEVATIONS = (ProductKind.DTM, ProductKind.FAR_DTM, ProductKind.REGION_DTM)
IMAGERY = {
    ProductKind.ORTHOPHOTO,
    ProductKind.REGION_ORTHOPHOTO,
    ProductKind.ORBITAL,
    ProductKind.COLOUR,
} | {kind for kind, style in STYLES.items() if style.is_classes}
"""Kinds of eight bits; all others are rasters of 32-bit floats and have tiles of values."""

_NORTH_FACING = TileStyle(RED_BLUE, (-20.0, 20.0), "degree", title="Slopes that face north")
_GROUND = (
    RasterClass(1, "measured", "#21918c"),
    RasterClass(2, "interpolated", "#fde725"),
    RasterClass(3, "occluded", "#440154"),
)
_OF_TERRAIN = {
    "hillshade": TileStyle(GREY, (0.0, 1.0), has_legend=False, title="Hillshade"),
    "shaded-relief": TileStyle(VIRIDIS, unit="m", title="Elevation, shaded"),
    "slope": TileStyle(INFERNO, (0.0, 40.0), "degree", title="Slope"),
    "aspect": TileStyle(TWILIGHT, (0.0, 360.0), "degree", title="Aspect"),
    "northerly-tilt": TileStyle(
        RED_BLUE, (-20.0, 20.0), "degree", title="North-facing slope component"
    ),
    "north-facing": _NORTH_FACING,
    "uncertainty": TileStyle(
        INFERNO, (0.0, 0.5), "m", band="standard_deviation", title="Standard deviation of elevation"
    ),
    "pose-deviation": TileStyle(
        INFERNO, (0.0, 0.5), "m", band="pose_deviation", title="Standard deviation by pose"
    ),
    "observations": TileStyle(
        VIRIDIS, (0.0, 100.0), band="observations", title="Number of observations"
    ),
    "class": TileStyle(
        GREY, band="class", is_classes=True, classes=_GROUND, title="How the ground is known"
    ),
    "contours": TileStyle(("#8c4a12",), has_legend=False, title="Contours"),
}
_OF_REGION = {
    **_OF_TERRAIN,
    "source": TileStyle(
        GREY, band="nearest_stop", is_classes=True, has_legend=False, title="Source stop"
    ),
}
_OF_SLOPE = {
    "uncertainty": TileStyle(
        INFERNO,
        (0.0, 5.0),
        "degree",
        band="standard_deviation",
        title="Standard deviation of slope",
    )
}
_MORE = {
    **dict.fromkeys(ELEVATIONS, _OF_TERRAIN),
    ProductKind.REGION_DTM: _OF_REGION,
    ProductKind.SLOPE: _OF_SLOPE,
    ProductKind.REGION_SLOPE: _OF_SLOPE,
    ProductKind.NORTHERLY_TILT: {"north-facing": _NORTH_FACING},
    ProductKind.REGION_NORTHERLY_TILT: {"north-facing": _NORTH_FACING},
}


def styles_of(kind: ProductKind) -> dict[str, TileStyle]:
    """All styles of a kind of raster by name, the default first.

    Raises:
        ProductNotFoundError: products of that kind are not drawn as tiles.
    """
    try:
        return {DEFAULT: STYLES[kind], **_MORE.get(kind, {})}
    except KeyError:
        drawn = ", ".join(STYLES)
        raise ProductNotFoundError(f"{kind} has no tiles; {drawn} have") from None


class UnknownStyleError(Exception):
    """A layer has no such style, or the style no such colours, range or interval."""


_NAME = r"^[a-z-]{1,32}$"
_Finite = Annotated[float, Field(allow_inf_nan=False)]


class StyleQuery(BaseModel):
    """Style of a tile, its colours and its light, named as in the tile's URL.

    The defaults are those of the precomputed layers. A style ignores parameters that it does not
    use.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    style: Annotated[str, Field(pattern=_NAME)] = DEFAULT
    colours: Annotated[str | None, Field(pattern=_NAME, description="name of a ramp")] = None
    """The style's own by default."""
    low: Annotated[_Finite | None, Field(description="value of the first colour")] = None
    """Value of the first colour, in the layer's unit; by default the style's own."""
    high: Annotated[_Finite | None, Field(description="value of the last colour")] = None
    azimuth: Annotated[
        _Finite, Field(ge=-360, le=360, description="of the sun, degrees clockwise from north")
    ] = 315.0
    """North-west, as on printed maps."""
    elevation: Annotated[
        _Finite, Field(ge=0, le=90, description="of the sun above the horizon, degrees")
    ] = 45.0
    exaggeration: Annotated[_Finite, Field(gt=0, le=100, description="of heights, in shading")] = (
        1.0
    )
    threshold: Annotated[
        _Finite, Field(ge=-90, le=90, description="least tilt towards north, degrees")
    ] = 5.0
    """Least northerly tilt that counts as facing north."""
    baseline: Annotated[
        _Finite | None,
        Field(gt=0, le=100, description="length over which slope is measured, metres"),
    ] = None
    """Three of the tile's cells by default."""
    interval: Annotated[
        _Finite | None, Field(ge=0.001, le=1000, description="between contours, metres")
    ] = None
    """Chosen by the layer's range by default."""


def resolve_style(layer: Layer, query: StyleQuery) -> TileStyle:
    """The style of a layer with the requested colours and range.

    Raises:
        ProductNotFoundError: the layer has no tiles.
        UnknownStyleError: it has no such style, or there are no such colours.
    """
    styles = styles_of(layer.ref.kind)
    if query.style not in styles:
        known = ", ".join(styles)
        raise UnknownStyleError(f"{layer.id} has no style {query.style}; it has {known}")
    style = styles[query.style]
    if query.colours is None and query.low is None and query.high is None:
        return style
    if style.is_classes or style.is_colour:
        raise UnknownStyleError(
            f"{layer.id} has colours of its own: leave out colours, low and high"
        )
    low, high = range_of(style, layer)
    ends = low if query.low is None else query.low, high if query.high is None else query.high
    if not ends[0] < ends[1]:
        raise UnknownStyleError(
            f"low={ends[0]:g} is not below high={ends[1]:g}; the range of {layer.id} is {low:g} to "
            f"{high:g}"
        )
    return replace(style, colours=_ramp_of(query.colours, style), range=ends)


def _ramp_of(name: str | None, style: TileStyle) -> tuple[str, ...]:
    if name is None:
        return style.colours
    if name not in RAMPS:
        raise UnknownStyleError(f"there are no colours {name}; there are {', '.join(RAMPS)}")
    return RAMPS[name]


class LegendClass(BaseModel):
    """A class of ground and its colour."""

    name: str
    colour: str


class Legend(BaseModel):
    """Values and their colours, or classes and theirs."""

    stops: list[tuple[float, str]]
    unit: str
    classes: list[LegendClass] = []


def legend_of(layer: Layer, style: TileStyle | None = None) -> Legend | None:
    """Values and colours along the range, or classes; by default of the kind's style."""
    style = style or STYLES.get(layer.ref.kind)
    if style is None or not style.has_legend:
        return None
    if style.is_classes:
        named = [LegendClass(name=one.name, colour=one.colour) for one in style.classes]
        return Legend(stops=[], unit="", classes=named)
    values = np.linspace(*range_of(style, layer), len(style.colours)).tolist()
    stops = [(round(v, 3), colour) for v, colour in zip(values, style.colours, strict=True)]
    return Legend(stops=stops, unit=style.unit or layer.unit or "")


_BAR, _ROW, _TOP, _WIDTH = 24, 22, 30, 220
_INK, _PAPER = (40, 40, 40), 255
_FONT, _SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.42


def draw_legend(layer: Layer, style: TileStyle) -> bytes:
    """PNG of the colours of a style with their values or the names of their classes."""
    legend = legend_of(layer, style) or Legend(stops=[], unit="")
    classes = [(one.name, one.colour) for one in legend.classes]
    stops = [(f"{value:.5g}", colour) for value, colour in reversed(legend.stops)]
    rows = stops or classes
    canvas = np.full((_TOP + _ROW * max(1, len(rows)) + 8, _WIDTH, 3), _PAPER, np.uint8)
    unit = f" ({legend.unit})" if legend.unit else ""
    _write(canvas, f"{style.title or layer.ref.kind}{unit}", 8, 18)
    for number, (text, colour) in enumerate(rows):
        top = _TOP + _ROW * number
        red, green, blue = palette_of((colour,) * 2)[1].tolist()
        canvas[top : top + _ROW - (2 if classes else 0), 8 : 8 + _BAR] = blue, green, red
        _write(canvas, text, 16 + _BAR, top + 15)
    if stops:
        _blend(canvas, style, len(stops))
    return bytes(cv2.imencode(".png", canvas)[1])


def _blend(canvas: np.ndarray, style: TileStyle, count: int) -> None:
    """A bar without steps, the low end below; every value stands at the middle of its row."""
    rows = _ROW * count
    share = np.clip((rows - _ROW / 2 - np.arange(rows)) / (rows - _ROW), 0.0, 1.0)
    colours = palette_of(style.colours)[np.rint(1 + 254 * share).astype(int)]
    canvas[_TOP : _TOP + rows, 8 : 8 + _BAR] = colours[:, None, ::-1]


def _write(canvas: np.ndarray, text: str, left: int, base: int) -> None:
    cv2.putText(canvas, text, (left, base), _FONT, _SIZE, _INK, 1, cv2.LINE_AA)
