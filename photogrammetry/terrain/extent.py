"""Which part of a terrain model views may show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from solmap.photogrammetry.arrays import Flags, Raster, Vector3
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.looks import Look


def bounds_to_show(dtm: Dtm, looks: Sequence[Look]) -> tuple[float, float, float, float]:
    """Bounds of the seen cells near which any view may show ground.

    Raises:
        TerrainError: the terrain model is empty, or no view looks at it.
    """
    seen = np.isfinite(dtm.elevation)
    if not seen.any():
        raise TerrainError("the terrain model has no seen cell, so there is nothing to show")
    near = np.zeros_like(seen)
    for row, col, rows, cols in windows(dtm.grid, BLOCK):
        window = (slice(row, row + rows), slice(col, col + cols))
        if seen[window].any():
            sphere = _sphere(dtm.grid.part(row, col, rows, cols), dtm.elevation[window])
            near[window] = any(look.may_show(*sphere) for look in looks)
    near &= seen
    if not near.any():
        raise TerrainError(
            f"none of the {len(looks)} views looks at the terrain model's seen cells"
        )
    (top, bottom), (left, right) = (_extent(near.any(axis=axis)) for axis in (1, 0))
    return dtm.grid.part(top, left, bottom - top, right - left).bounds


def _extent(marked: Flags) -> tuple[int, int]:
    """First and one after the last that is marked."""
    where = np.flatnonzero(marked)
    return int(where[0]), int(where[-1]) + 1


def _sphere(grid: MapGrid, elevation: Raster) -> tuple[Vector3, float]:
    """Middle and radius of a sphere around a piece of ground."""
    west, south, east, north = grid.bounds
    first = np.array([west, south, float(np.nanmin(elevation))])
    last = np.array([east, north, float(np.nanmax(elevation))])
    return (first + last) / 2, float(np.linalg.norm(last - first)) / 2


def windows(grid: MapGrid, side: int) -> Iterator[tuple[int, int, int, int]]:
    """(row, col, rows, cols) of windows that cover the grid."""
    for row in range(0, grid.rows, side):
        for col in range(0, grid.cols, side):
            yield row, col, min(side, grid.rows - row), min(side, grid.cols - col)
