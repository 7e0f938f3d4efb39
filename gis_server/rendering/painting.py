"""Rendering of a raster to the image of a tile: one function for every style.

Shades, slopes and directions of a terrain model follow from the gradient of the plane fitted to
the elevations around a cell, as in the layers that are made once (`photogrammetry.terrain`). A
cell is a pixel of the tile: at a low zoom the gradient is taken over a longer baseline, so that a
hillshade is equally sharp and correct at every zoom.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import rasterio
from rasterio.enums import Resampling

from solmap.gis_server.rendering.contours import contour_cover, contour_margin, interval_of
from solmap.gis_server.rendering.png import colour_png, indexed_png
from solmap.gis_server.rendering.reading import Patch, read_patch, read_tile
from solmap.gis_server.rendering.styles import (
    ELEVATIONS,
    IMAGERY,
    StyleQuery,
    UnknownStyleError,
    indices_of,
    palette_of,
    stretch_palette,
)
from solmap.gis_server.rendering.webp import colour_webp, indexed_webp
from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.planes import Gradients, nine_cell_gradients, window_gradients
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.raster.cog import RasterClass
from solmap.products.formats.raster.orthophoto import source_colour
from solmap.products.formats.raster.raster import band_names, class_names
from solmap.products.formats.raster.styles import (
    STYLES,
    TileStyle,
    range_of,
)
from solmap.products.formats.raster.tiling import TileAddress
from solmap.products.model import Layer, ProductKind

_WIDEST = 128
"""Cells that a window may reach to either side: half a tile."""
_LEVEL = np.float32(1e-6)
"""Gradient below which ground has no aspect: single precision."""
_NOT_AVERAGED = {ProductKind.ASPECT, ProductKind.REGION_ASPECT} | {
    kind for kind, style in STYLES.items() if style.is_classes
}
_SHADOW = 0.3
"""Fraction of a colour that remains in the shade."""
_AS_IT_IS = 128
"""Shade that leaves a colour as it is; the brightest is twice that."""
_COVER = bytes(range(256))


def margin_of(query: StyleQuery, cell_m: float) -> int:
    """Cells that a window reaches to either side.

    Raises:
        UnknownStyleError: it is too wide for a tile.
    """
    if query.baseline is None:
        return 1
    half = max(1, round((query.baseline / cell_m - 1) / 2))
    if half > _WIDEST:
        raise UnknownStyleError(
            f"a baseline of {query.baseline:g} m is {2 * half + 1} cells of {cell_m:g} m; use one "
            f"below {2 * _WIDEST * cell_m:g} m or for a tile of a lower zoom"
        )
    return half


def gradient_of(elevation: Raster, cell_m: float, half: int) -> Gradients:
    """Rise per metre towards east and north; the outer `half` cells are invalid."""
    if half == 1:
        return nine_cell_gradients(elevation, cell_m)
    return window_gradients(elevation, cell_m, (2 * half + 1) * cell_m)


def hillshade(gradient: Gradients, query: StyleQuery) -> Raster:
    """Cosine of the sun's incidence, 0 to 1: 0 where the ground turns away from the sun."""
    azimuth, elevation = math.radians(query.azimuth), math.radians(query.elevation)
    g_e, g_n = gradient * np.float32(query.exaggeration)
    across = np.float32(math.cos(elevation) * math.sin(azimuth))
    along = np.float32(math.cos(elevation) * math.cos(azimuth))
    light = np.float32(math.sin(elevation)) - across * g_e - along * g_n
    light /= np.sqrt(np.float32(1.0) + g_e * g_e + g_n * g_n)
    return np.clip(light, 0.0, 1.0)


def slope(gradient: Gradients, _query: StyleQuery) -> Raster:
    """Degrees from the horizontal."""
    return np.degrees(np.arctan(np.hypot(*gradient)))


def aspect(gradient: Gradients, _query: StyleQuery) -> Raster:
    """Azimuth in which the ground falls, degrees clockwise from north; NaN where level."""
    g_e, g_n = gradient
    azimuth = np.degrees(np.arctan2(-g_e, -g_n))
    azimuth[azimuth < 0] += np.float32(360.0)
    azimuth[(np.abs(g_e) < _LEVEL) & (np.abs(g_n) < _LEVEL)] = np.nan
    return azimuth


def northerly_tilt(gradient: Gradients, _query: StyleQuery) -> Raster:
    """Tilt towards north in degrees, positive where the ground faces north."""
    g_e, g_n = gradient
    return np.degrees(np.arctan(-g_n / np.sqrt(np.float32(1.0) + g_e * g_e)))


def north_facing(tilt: Raster, query: StyleQuery) -> Raster:
    """Tilt towards north where it reaches the threshold, NaN elsewhere."""
    return np.where(tilt >= np.float32(query.threshold), tilt, np.float32(np.nan))


OF_TERRAIN: dict[str, Callable[[Gradients, StyleQuery], Raster]] = {
    "hillshade": hillshade,
    "slope": slope,
    "aspect": aspect,
    "northerly-tilt": northerly_tilt,
    "north-facing": lambda gradient, query: north_facing(northerly_tilt(gradient, query), query),
}
"""Quantities that follow from the gradient, by the name of the style."""


@dataclass(frozen=True, slots=True)
class ImageFormat:
    """Encoder of painted tiles; index 0 and black, 0 0 0, are transparent."""

    media_type: str
    indexed: Callable[..., bytes]
    """Encode palette indices with a palette and the opacity of the first indices."""
    colour: Callable[[np.ndarray], bytes]
    """Encode an image of red, green and blue."""


PNG = ImageFormat("image/png", indexed_png, colour_png)
WEBP = ImageFormat("image/webp", indexed_webp, colour_webp)


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """A tile to paint: its layer, address, style and raster."""

    layer: Layer
    address: TileAddress
    query: StyleQuery
    style: TileStyle
    dataset: rasterio.DatasetReader
    form: ImageFormat = PNG

    @property
    def cell_m(self) -> float:
        """Size of the cells that a patch of this tile has."""
        return max(self.address.cell_m, float(self.dataset.transform.a))

    def patch(self, margin: int, border: int = 0) -> Patch | None:
        """The cells of the style's band."""
        band = band_index(self.layer, self.dataset, self.style.band)
        how = averaging(self.layer.ref.kind)
        return read_patch(self.dataset, self.address, band, how, margin=margin, border=border)

    def encode(self, values: np.ndarray) -> bytes | None:
        """The image of the values of every pixel; None if none is known."""
        indices = indices_of(values, *range_of(self.style, self.layer))
        colours = palette_of(self.style.colours)
        return self.form.indexed(indices, colours) if indices.any() else None


def averaging(kind: ProductKind) -> Resampling:
    """Resampling of cells to larger pixels: directions are cyclic and classes have no mean."""
    return Resampling.nearest if kind in _NOT_AVERAGED else Resampling.average


def band_index(layer: Layer, dataset: rasterio.DatasetReader, name: str) -> int:
    """The number of a band; the first where no name is given.

    Raises:
        ProductNotFoundError: there is no such band.
    """
    if not name:
        return 1
    names = band_names(dataset)
    if name not in names:
        raise ProductNotFoundError(f"{layer.id} has no band {name}; it has {', '.join(names)}")
    return names.index(name) + 1


def painter_of(
    layer: Layer, query: StyleQuery, style: TileStyle
) -> Callable[[Canvas], bytes | None]:
    """The painter of a layer in a style; a painter returns None where nothing was measured."""
    kind = layer.ref.kind
    if style.is_colour:
        return _paint_colour
    if kind in IMAGERY:
        return _paint_classes if style.is_classes else _paint_imagery
    if kind in ELEVATIONS:
        if style.is_classes:
            return _paint_classes_of_band
        return _OF_TERRAIN.get(query.style, _paint_values)
    return _paint_values


def _paint_colour(canvas: Canvas) -> bytes | None:
    """Red, green and blue unchanged; transparent where all are 0."""
    bands = [read_tile(canvas.dataset, canvas.address, band) for band in (1, 2, 3)]
    known = [band for band in bands if band is not None]
    if len(known) < len(bands) or not any(band.any() for band in known):
        return None
    return canvas.form.colour(np.stack(known, axis=-1))


def _paint_classes(canvas: Canvas) -> bytes | None:
    """Classes in the colours that their file gives them."""
    codes = read_tile(canvas.dataset, canvas.address, how=Resampling.nearest)
    if codes is None or not codes.any():
        return None
    colours = canvas.dataset.colormap(1)
    return canvas.form.indexed(
        codes, np.array([colours[code][:3] for code in range(256)], np.uint8)
    )


def classes_in(dataset: rasterio.DatasetReader, style: TileStyle) -> tuple[RasterClass, ...]:
    """The classes of a style: those that every layer of its kind has, else those of the file."""
    if style.classes:
        return style.classes
    if style.band:
        stops = json.loads(dataset.tags().get("STOPS", "[]"))
        return tuple(RasterClass(k, name, source_colour(k + 1)) for k, name in enumerate(stops))
    colours = dataset.colormap(1)
    return tuple(
        RasterClass(value, name, "#{:02x}{:02x}{:02x}".format(*colours[value][:3]))
        for value, name in class_names(dataset).items()
    )


def _paint_classes_of_band(canvas: Canvas) -> bytes | None:
    """Classes that a band of floats holds; where a pixel is of several, none is drawn."""
    band = band_index(canvas.layer, canvas.dataset, canvas.style.band)
    values = read_tile(canvas.dataset, canvas.address, band, Resampling.nearest)
    if values is None:
        return None
    codes = np.zeros(values.shape, np.uint8)
    palette = np.zeros((256, 3), np.uint8)
    for index, one in enumerate(classes_in(canvas.dataset, canvas.style)):
        code = index % 255 + 1  # 0 is transparent
        codes[values == one.value] = code
        palette[code] = palette_of((one.colour,) * 2)[1]
    return canvas.form.indexed(codes, palette) if codes.any() else None


def _paint_imagery(canvas: Canvas) -> bytes | None:
    """Eight-bit values are palette indices: colours and stretch only change the palette."""
    grey = read_tile(canvas.dataset, canvas.address)
    if grey is None or not grey.any():
        return None
    palette = palette_of(canvas.style.colours)
    if canvas.style.range is not None:
        scale, offset = canvas.dataset.scales[0], canvas.dataset.offsets[0]
        low, high = ((end - offset) / scale for end in canvas.style.range)
        palette = stretch_palette(palette, low, high)
    return canvas.form.indexed(grey, palette)


def _paint_values(canvas: Canvas) -> bytes | None:
    """The values of a band."""
    patch = canvas.patch(margin=0)
    if patch is None:
        return None
    values = patch.tile(patch.values)
    if canvas.query.style == "north-facing":
        values = north_facing(values, canvas.query)
    return canvas.encode(values)


def _paint_terrain(canvas: Canvas) -> bytes | None:
    """Paint a quantity that follows from the gradient."""
    half = margin_of(canvas.query, canvas.cell_m)
    patch = canvas.patch(half)
    if patch is None:
        return None
    gradient = gradient_of(patch.values, patch.cell_m, half)
    inner = np.ascontiguousarray(patch.tile(gradient))
    return canvas.encode(OF_TERRAIN[canvas.query.style](inner, canvas.query))


def _paint_shaded(canvas: Canvas) -> bytes | None:
    """Elevation in colour under the sun; level ground keeps its colour."""
    patch = canvas.patch(1)
    if patch is None:
        return None
    indices = indices_of(patch.tile(patch.values), *range_of(canvas.style, canvas.layer))
    if not indices.any():
        return None
    light = hillshade(patch.tile(gradient_of(patch.values, patch.cell_m, 1)), canvas.query)
    level = max(math.sin(math.radians(canvas.query.elevation)), _SHADOW)
    shares = _SHADOW + (1 - _SHADOW) / level * np.where(np.isnan(light), np.float32(level), light)
    shades = cv2.convertScaleAbs(shares, alpha=_AS_IT_IS)
    colours = palette_of(canvas.style.colours)[indices]
    shown = cv2.multiply(colours, cv2.merge([shades] * 3), scale=1.0 / _AS_IT_IS)
    np.maximum(shown, 1, out=shown)  # black would be transparent
    shown[indices == 0] = 0
    return canvas.form.colour(shown)


def _paint_contours(canvas: Canvas) -> bytes | None:
    """Lines of equal elevation."""
    patch = canvas.patch(contour_margin(canvas.cell_m), border=1)
    if patch is None:
        return None
    cover = contour_cover(patch, interval_of(canvas.layer, canvas.query.interval))
    palette = np.broadcast_to(palette_of(canvas.style.colours)[1], (256, 3))
    return canvas.form.indexed(cover, palette, _COVER) if cover.any() else None


_OF_TERRAIN = {
    **dict.fromkeys(OF_TERRAIN, _paint_terrain),
    "shaded-relief": _paint_shaded,
    "contours": _paint_contours,
}
