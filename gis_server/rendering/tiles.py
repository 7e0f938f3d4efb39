"""From a tile's address to its picture.

Rasters are snapped to the tile matrix set, so a tile at the raster's own zoom is one block, a tile
below it one block of an overview, and a tile above it a part of a block whose cells are repeated:
cells stay what was measured, whatever the zoom. Windows are clipped to the raster by hand, because
GDAL's boundless reads decode blocks again and again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import rasterio
from rasterio.enums import Resampling
from rasterio.windows import Window

from gis_server.rendering.png import colour_png, indexed_png
from gis_server.rendering.readers import RasterPool
from gis_server.rendering.styles import PALETTES, indices_of, range_of, style_of
from photogrammetry.terrain.grid import BLOCK
from products.model import Layer
from products.raster import grid_of
from products.store import ProductStore
from products.tiling import TileAddress


def render_tile(layer: Layer, address: TileAddress, store: ProductStore, pool: RasterPool) -> bytes:
    """The PNG of a tile; transparent where nothing was measured.

    Raises:
        ProductNotFoundError: the layer has no tiles.
    """
    style = style_of(layer.ref.kind)
    if not overlap(layer.bounds, address.bounds):
        return empty_tile()
    with pool.reading(store.path(layer.ref)) as dataset:
        if style.is_colour:
            bands = [read_tile(dataset, address, band) for band in (1, 2, 3)]
            return _colour_png(bands)
        how = Resampling.nearest if style.is_classes else Resampling.average
        values = read_tile(dataset, address, style.band, how)
        palette = _own_palette(dataset) if style.is_classes else PALETTES[layer.ref.kind]
    if values is None:
        return empty_tile()
    indices = indices_of(values, *range_of(style, layer))
    return indexed_png(indices, palette) if indices.any() else empty_tile()


def _own_palette(dataset: rasterio.DatasetReader) -> np.ndarray:
    """The colours that a file of classes gives them: 256 rows of red, green and blue."""
    colours = dataset.colormap(1)
    return np.array([colours[index][:3] for index in range(256)], np.uint8)


def _colour_png(bands: Sequence[np.ndarray | None]) -> bytes:
    """Red, green and blue as a picture; transparent where all are 0."""
    known = [band for band in bands if band is not None]
    if len(known) < len(bands) or not any(band.any() for band in known):
        return empty_tile()
    return colour_png(np.stack(known, axis=-1))


@lru_cache(maxsize=1)
def empty_tile() -> bytes:
    """A transparent tile."""
    return indexed_png(np.zeros((BLOCK, BLOCK), np.uint8), np.zeros((256, 3), np.uint8))


def overlap(
    one: tuple[float, float, float, float], other: tuple[float, float, float, float]
) -> bool:
    """Whether two (west, south, east, north) share any ground."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def read_tile(
    dataset: rasterio.DatasetReader,
    address: TileAddress,
    band: int = 1,
    how: Resampling = Resampling.average,
) -> np.ndarray | None:
    """Stored values of a tile, nodata where the raster ends; None where it holds none of it."""
    grid = grid_of(dataset)
    west, north = address.west_north
    ratio = address.cell_m / grid.cell_m
    step = min(ratio, 1.0)  # tiles and grids share a lattice: what is left over is rounding
    row = round((grid.north - north) / grid.cell_m / step) * step
    col = round((west - grid.west) / grid.cell_m / step) * step
    if ratio < 1.0 - 1e-9:
        return _repeated(dataset, band, row, col, ratio)
    return _reduced(dataset, band, row, col, ratio, how)


def _reduced(
    dataset: rasterio.DatasetReader,
    band: int,
    row: float,
    col: float,
    ratio: float,
    how: Resampling,
) -> np.ndarray | None:
    """A tile whose pixels are `ratio` cells wide, 1 or more, from the overview that fits."""
    rows = _span(row / ratio, dataset.height / ratio)
    cols = _span(col / ratio, dataset.width / ratio)
    if not (rows and cols):
        return None
    top, left = max(row + rows.start * ratio, 0.0), max(col + cols.start * ratio, 0.0)
    bottom = min(row + rows.stop * ratio, dataset.height)
    right = min(col + cols.stop * ratio, dataset.width)
    part = dataset.read(
        band,
        window=Window(left, top, right - left, bottom - top),
        out_shape=(len(rows), len(cols)),
        resampling=how,
    )
    if part.shape == (BLOCK, BLOCK):
        return part
    tile = np.full((BLOCK, BLOCK), dataset.nodata, part.dtype)
    tile[rows.start : rows.stop, cols.start : cols.stop] = part
    return tile


def _span(origin: float, size: float) -> range:
    """Pixels of a tile starting at `origin` that lie on a raster of `size` such pixels."""
    return range(max(0, math.floor(-origin)), min(BLOCK, math.ceil(size - origin)))


def _repeated(
    dataset: rasterio.DatasetReader, band: int, row: float, col: float, ratio: float
) -> np.ndarray | None:
    """A tile whose pixels are a fraction of a cell wide."""
    pixels = (np.arange(BLOCK) + 0.5) * ratio
    rows, cols = np.floor(row + pixels).astype(int), np.floor(col + pixels).astype(int)
    rows, cols = (
        rows[(rows >= 0) & (rows < dataset.height)],
        cols[(cols >= 0) & (cols < dataset.width)],
    )
    if len(rows) < BLOCK or len(cols) < BLOCK:  # rasters end on whole blocks
        return None
    window = Window(cols[0], rows[0], cols[-1] - cols[0] + 1, rows[-1] - rows[0] + 1)
    part = dataset.read(band, window=window)
    return part[np.ix_(rows - rows[0], cols - cols[0])]
