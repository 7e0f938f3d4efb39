"""Terrain models on coarser cells: for questions that a rover's size asks, not a pebble's.

The elevation of a coarse cell is the mean of the cells in it that have one. The grid of the result
is one of whole blocks again, so that its map tiles are read and never resampled.
"""

from __future__ import annotations

import numpy as np

from photogrammetry.arrays import Float32, Raster
from photogrammetry.errors import TerrainError
from photogrammetry.terrain.grid import MapGrid

CoarseRaster = Float32[np.ndarray, "coarse_rows coarse_cols"]
"""Values of larger cells."""
LEAST_SHARE = 0.25
"""Share of a coarse cell's area that must have been seen. A quarter: of 4 x 4 cells, one row."""


def coarse_grid(grid: MapGrid, cell_m: float) -> MapGrid:
    """The grid of whole blocks with larger cells around a grid; itself if its cells are as large.

    Raises:
        TerrainError: `cell_m` is not 0.01 m times a power of two.
    """
    is_coarser = cell_m > grid.cell_m * (1 + 1e-9)
    return MapGrid.covering(grid.bounds, cell_m) if is_coarser else grid


def seen_window(elevation: Raster) -> tuple[slice, slice]:
    """The smallest window that holds all elevations.

    Raises:
        TerrainError: there is none.
    """
    known = np.isfinite(elevation)
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        raise TerrainError("a terrain model without elevations has nothing to map: look at its log")
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def manageable_cell_m(elevation: Raster, grid: MapGrid, cell_m: float, most_cells: int) -> float:
    """`cell_m`, doubled until what was seen of a terrain model has no more than `most_cells`."""
    rows, cols = seen_window(elevation)
    area_m2 = (rows.stop - rows.start) * (cols.stop - cols.start) * grid.cell_m**2
    while area_m2 > most_cells * cell_m**2:
        cell_m *= 2
    return cell_m


def coarsened(elevation: Raster, grid: MapGrid, cell_m: float) -> tuple[CoarseRaster, MapGrid]:
    """Mean elevation of larger cells, and their grid; NaN where too little was seen."""
    coarse = coarse_grid(grid, cell_m)
    if coarse is grid:
        return elevation, grid
    factor = round(coarse.cell_m / grid.cell_m)
    top = round((coarse.north - grid.north) / grid.cell_m)
    left = round((grid.west - coarse.west) / grid.cell_m)
    known = np.isfinite(elevation)
    level = np.float32(np.mean(elevation[known], dtype=np.float64)) if known.any() else 0.0
    heights = np.where(known, elevation - level, np.float32(0))
    count = _sums(known.astype(np.float32), (top, left), factor, coarse)
    total = _sums(heights, (top, left), factor, coarse)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count + level
    return np.where(count >= LEAST_SHARE * factor**2, mean, np.float32(np.nan)), coarse


def _sums(values: Raster, corner: tuple[int, int], factor: int, coarse: MapGrid) -> CoarseRaster:
    """Sums over blocks of `factor` x `factor` cells of a raster that starts at `corner`."""
    (top, left), (rows, cols) = corner, values.shape
    first_row, first_col = top // factor, left // factor
    last_row, last_col = -(-(top + rows) // factor), -(-(left + cols) // factor)
    shape = (last_row - first_row, last_col - first_col)
    part = np.zeros((shape[0] * factor, shape[1] * factor), np.float32)
    top, left = top - first_row * factor, left - first_col * factor
    part[top : top + rows, left : left + cols] = values
    sums = np.zeros(coarse.shape, np.float32)
    sums[first_row:last_row, first_col:last_col] = part.reshape(
        shape[0], factor, shape[1], factor
    ).sum(axis=(1, 3))
    return sums
