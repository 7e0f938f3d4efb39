"""Terrain models on coarser cells: for questions that a rover's size asks, not a pebble's.

The elevation of a coarse cell is the mean of the cells in it that have one. The grid of the result
is one of whole blocks again, so that its map tiles are read and never resampled.
"""

from __future__ import annotations

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.grid import MapGrid

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
    whole = np.full(coarse.shape, np.nan, np.float32)
    place_means(whole, coarse, elevation, grid)
    return whole, coarse


def place_means(whole: CoarseRaster, coarse: MapGrid, values: Raster, grid: MapGrid) -> None:
    """Put the means of a raster's cells, or of a part of it, into the larger cells that hold them.

    Args:
        whole: The larger cells, changed in place.
        coarse: Their grid.
        values: The cells; parts of a raster begin and end on whole larger cells.
        grid: Their grid, on the same lattice.
    """
    factor = round(coarse.cell_m / grid.cell_m)
    top = round((coarse.north - grid.north) / grid.cell_m)
    left = round((grid.west - coarse.west) / grid.cell_m)
    rows, cols = -(-(top + grid.rows) // factor), -(-(left + grid.cols) // factor)
    first_row, first_col = top // factor, left // factor
    before = (top - first_row * factor, left - first_col * factor)
    after = (rows * factor - top - grid.rows, cols * factor - left - grid.cols)
    around = ((before[0], after[0]), (before[1], after[1]))
    padded = np.pad(values, around, constant_values=np.nan) if any(map(any, around)) else values
    whole[first_row:rows, first_col:cols] = _means(padded, factor)


def _means(values: Raster, factor: int) -> CoarseRaster:
    """Means over blocks of `factor` x `factor` cells; NaN where too little is known."""
    known = np.isfinite(values)
    level = np.float32(np.mean(values[known], dtype=np.float64)) if known.any() else np.float32(0)
    size = (values.shape[1] // factor, values.shape[0] // factor)
    share, total = (
        cv2.resize(part, size, interpolation=cv2.INTER_AREA)
        for part in (known.astype(np.float32), np.where(known, values - level, np.float32(0)))
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(share >= LEAST_SHARE, total / share + level, np.float32(np.nan))
