"""Terrain models read together onto one grid: for questions about an area."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import rasterio
from rasterio.enums import Resampling
from rasterio.windows import Window

from solmap.gis_server.analysis.ground import Ground, cell_of
from solmap.gis_server.rendering.readers import RasterPool
from solmap.photogrammetry.arrays import Classes, Raster
from solmap.photogrammetry.terrain.dtm.grid import Bounds, MapGrid
from solmap.products.formats.raster.raster import band_names, grid_of
from solmap.products.model import Layer
from solmap.products.store.product_store import ProductStore


def mosaic(ground: Ground, grid: MapGrid) -> tuple[Raster, list[Layer]]:
    """Elevation on a grid: at every cell of the finest model that has one, of equals the surest.

    Models of smaller cells are averaged, those of larger ones repeated. Returned with the models
    that have a say.
    """
    elevation = np.full(grid.shape, np.nan, np.float32)
    best = np.full(grid.shape, np.inf, np.float32)
    number = np.full(grid.shape, -1, np.int32)
    order = sorted(range(len(ground.models)), key=lambda k: -cell_of(ground.models[k]))
    former = math.inf
    for k in order:
        layer = ground.models[k]
        part = _overlap(layer.bounds, grid)
        if part is None:
            continue
        if cell_of(layer) < former:  # a finer model speaks wherever it has measured
            former, best[:] = cell_of(layer), np.inf
        with ground.pool.reading(ground.store.address(layer.ref)) as dataset:
            height, sigma = _read(dataset, grid, part)
        rows, cols = part
        better = np.isfinite(height) & (sigma < best[rows, cols])
        elevation[rows, cols][better] = height[better]
        best[rows, cols][better] = sigma[better]
        number[rows, cols][better] = k
    used = sorted(set(number[number >= 0].tolist()))
    return elevation, [ground.models[k] for k in used]


def _overlap(bounds: Bounds, grid: MapGrid) -> tuple[slice, slice] | None:
    """Rows and columns of a grid that lie wholly within bounds; None where there are none."""
    west, south, east, north = bounds
    rows = slice(
        max(0, math.ceil((grid.north - north) / grid.cell_m - 1e-6)),
        min(grid.rows, math.floor((grid.north - south) / grid.cell_m + 1e-6)),
    )
    cols = slice(
        max(0, math.ceil((west - grid.west) / grid.cell_m - 1e-6)),
        min(grid.cols, math.floor((east - grid.west) / grid.cell_m + 1e-6)),
    )
    return (rows, cols) if rows.stop > rows.start and cols.stop > cols.start else None


def _read(
    dataset: rasterio.DatasetReader, grid: MapGrid, part: tuple[slice, slice]
) -> tuple[Raster, Raster]:
    """Elevation and its standard deviation on a part of the grid."""
    window, shape = _window(grid_of(dataset), grid, part)
    names = band_names(dataset)
    wanted = [names.index(n) + 1 for n in ("elevation", "standard_deviation") if n in names]
    how = Resampling.average if window.width > shape[1] else Resampling.nearest
    read = dataset.read(wanted, window=window, out_shape=(len(wanted), *shape), resampling=how)
    sigma = read[1] if len(read) > 1 else np.zeros(shape, np.float32)
    unsure: Raster = np.where(np.isfinite(sigma), sigma, np.float32(1e6))
    return read[0], unsure


def worst_of(
    layers: Sequence[Layer], grid: MapGrid, store: ProductStore, pool: RasterPool
) -> tuple[Classes, list[Layer]]:
    """Classes on a grid: at every cell the highest code of all layers, 0 where none knows it.

    Returned with the layers that lie on the grid.
    """
    found = np.zeros(grid.shape, np.uint8)
    used = []
    for layer in layers:
        part = _overlap(layer.bounds, grid)
        if part is None:
            continue
        with pool.reading(store.address(layer.ref)) as dataset:
            window, shape = _window(grid_of(dataset), grid, part)
            codes = dataset.read(1, window=window, out_shape=shape, resampling=Resampling.nearest)
        here = found[part]
        np.maximum(here, codes, out=here)
        used.append(layer)
    return found, used


def _window(
    own: MapGrid, grid: MapGrid, part: tuple[slice, slice]
) -> tuple[Window, tuple[int, int]]:
    """Where a part of a grid lies among the cells of a file, and its rows and columns."""
    rows, cols = part
    ratio = grid.cell_m / own.cell_m
    top = (own.north - grid.north) / own.cell_m + rows.start * ratio
    left = (grid.west - own.west) / own.cell_m + cols.start * ratio
    shape = (rows.stop - rows.start, cols.stop - cols.start)
    return Window(left, top, shape[1] * ratio, shape[0] * ratio), shape
