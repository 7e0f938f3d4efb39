"""Terrain models in coarser or finer cells, and their elevations at single points.

The elevation of a coarse cell is the mean of the known cells in it; it is used for analyses at the
scale of a rover. The grid of the result consists of whole blocks again, so that its map tiles need
no resampling.

Elevation at a point is bilinear between known cell centres, if these have more than half of the
weight: gaps are not filled. Where several models cover a point, the one with the finest cells is
used. Standard deviations are averaged with the same weights, as if the cells were fully correlated;
the result is never too small.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64, Int32, PerPoint, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.kernels import values_between

CoarseRaster = Float32[np.ndarray, "coarse_rows coarse_cols"]
"""Values of larger cells."""
FineRaster = Float32[np.ndarray, "fine_rows fine_cols"]
"""Values of smaller cells."""
LEAST_SHARE = 0.25
"""Least fraction of a coarse cell's area with elevations: one row of 4 x 4 cells."""
MapPoints = Float64[np.ndarray, "n 2"]
"""(east, north) in metres of the local map."""
NOWHERE = -1
"""Source of a point that no model covers."""
Elevations = Callable[[MapPoints], PerPoint]
"""Elevation at (east, north); NaN where the ground is not known."""


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
        raise TerrainError("the terrain model has no elevations: see the log of its run")
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def coarsen(elevation: Raster, grid: MapGrid, cell_m: float) -> tuple[CoarseRaster, MapGrid]:
    """Mean elevation of larger cells, and their grid; NaN where too few cells are known."""
    coarse = coarse_grid(grid, cell_m)
    if coarse is grid:
        return elevation, grid
    whole = np.full(coarse.shape, np.nan, np.float32)
    own, means = coarse_means(elevation, grid, coarse)
    whole[own] = means
    return whole, coarse


def coarse_means(
    values: Raster, grid: MapGrid, coarse: MapGrid
) -> tuple[tuple[slice, slice], CoarseRaster]:
    """Rows and columns of a raster, or of a part of it, in larger cells, and their means.

    Args:
        values: The cells; parts of a raster begin and end on whole larger cells.
        grid: Their grid; cells that are larger still are interpolated.
        coarse: The grid of the larger cells, on the same lattice.
    """
    if grid.cell_m > coarse.cell_m:
        wide = round(grid.cell_m / coarse.cell_m)
        values, grid = finer(values, wide), grid.divided(wide)
    factor = round(coarse.cell_m / grid.cell_m)
    top = round((coarse.north - grid.north) / grid.cell_m)
    left = round((grid.west - coarse.west) / grid.cell_m)
    rows, cols = -(-(top + grid.rows) // factor), -(-(left + grid.cols) // factor)
    first_row, first_col = top // factor, left // factor
    before = (top - first_row * factor, left - first_col * factor)
    after = (rows * factor - top - grid.rows, cols * factor - left - grid.cols)
    around = ((before[0], after[0]), (before[1], after[1]))
    padded = np.pad(values, around, constant_values=np.nan) if any(map(any, around)) else values
    return (slice(first_row, rows), slice(first_col, cols)), _means(padded, factor)


def _means(values: Raster, factor: int) -> CoarseRaster:
    """Means over blocks of `factor` x `factor` cells; NaN where too few are known."""
    known = np.isfinite(values)
    level = np.float32(np.mean(values[known], dtype=np.float64)) if known.any() else np.float32(0)
    share, total = (
        _shrink(part, factor)
        for part in (known.astype(np.float32), np.where(known, values - level, np.float32(0)))
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(share >= LEAST_SHARE, total / share + level, np.float32(np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class GroundSamples:
    """The ground at n points; NaN where it was not measured."""

    elevation: PerPoint
    """Metres above the tangent plane."""
    sigma_m: PerPoint
    """Standard deviation of the elevation, including that of the poses."""
    pose_sigma_m: PerPoint
    """The part of it common to neighbouring points; 0 where poses are treated as exact."""
    source: Int32[np.ndarray, " n"]
    """Number of the model that gives the elevation; `NOWHERE` where none does."""

    def __len__(self) -> int:
        return len(self.elevation)

    @property
    def own_sigma_m(self) -> PerPoint:
        """Standard deviation without the part common to neighbouring points."""
        return np.sqrt(np.maximum(self.sigma_m**2 - self.pose_sigma_m**2, 0.0))

    @classmethod
    def unknown(cls, n: int) -> GroundSamples:
        """Points without any elevation."""
        unknown = np.full(n, np.nan)
        return cls(unknown, unknown.copy(), unknown.copy(), np.full(n, NOWHERE, np.int32))


def sample_bilinear(values: Raster, grid: MapGrid, places: MapPoints) -> PerPoint:
    """Cell values between cell centres; NaN beyond the grid and in gaps."""
    row = (grid.north - places[:, 1]) / grid.cell_m - 0.5
    col = (places[:, 0] - grid.west) / grid.cell_m - 0.5
    return values_between(np.ascontiguousarray(values), row, col)


def finest_samples(models: Sequence[tuple[float, GroundSamples]]) -> GroundSamples:
    """At every point the sample of the model with the finest cells; of equal ones the most certain.

    Args:
        models: Cell size in metres and samples of each model, all at the same points. Their own
            sources are kept.
    """
    if not models:
        raise ValueError("there is no model to sample")
    cells = sorted({cell_m for cell_m, _ in models})
    rank = np.stack(
        [np.where(np.isfinite(s.elevation), float(cells.index(c)), np.inf) for c, s in models]
    )
    sigma = np.stack([np.nan_to_num(s.sigma_m, nan=np.inf) for _, s in models])
    sigma = np.where(rank == rank.min(axis=0), sigma, np.inf)
    unsure = np.where(np.isfinite(sigma), sigma, np.finfo(np.float64).max)
    best = np.argmin(np.where(rank == rank.min(axis=0), unsure, np.inf), axis=0)

    def chosen(name: str) -> np.ndarray:
        values: np.ndarray = np.stack([getattr(s, name) for _, s in models])
        return values[best, np.arange(values.shape[1])]

    return GroundSamples(
        chosen("elevation"), chosen("sigma_m"), chosen("pose_sigma_m"), chosen("source")
    )


def merge_classes(classes: Sequence[np.ndarray]) -> np.ndarray:
    """Measured before interpolated; without an elevation, occluded if any is."""
    found = np.zeros_like(classes[0])
    for ground in (GroundClass.OCCLUDED, GroundClass.INTERPOLATED, GroundClass.MEASURED):
        found[np.any([one == ground for one in classes], axis=0)] = ground
    return found


def coarser_dtm(dtm: Dtm, factor: int) -> Dtm:
    """A terrain model with cells `factor` times as wide and errors as large as before.

    Neighbouring cells share matches, so their mean is hardly more accurate than one of them.
    """
    if factor == 1:
        return dtm
    grid = dtm.grid
    if grid.rows % factor or grid.cols % factor:
        raise TerrainError(f"{grid.shape} cells cannot be joined {factor} by {factor}")
    known = np.isfinite(dtm.elevation)
    share = _shrink(known.astype(np.float32), factor)

    def mean(layer: Raster) -> CoarseRaster:
        with np.errstate(invalid="ignore", divide="ignore"):
            return _shrink(np.where(known, layer, np.float32(0)), factor) / share

    pose = None if dtm.pose_sigma_m is None else mean(dtm.pose_sigma_m)
    return Dtm(
        grid.window(slice(0, grid.rows, factor), slice(0, grid.cols, factor)),
        mean(dtm.elevation),
        np.sqrt(mean(np.square(dtm.sigma_m))),
        _shrink(dtm.observations, factor) * np.float32(factor**2),
        merge_classes([dtm.ground[i::factor, j::factor] for i, j in np.ndindex(factor, factor)]),
        pose,
    )


def finer_dtm(dtm: Dtm, factor: int) -> Dtm:
    """A terrain model with `factor` times finer cells; elevations are interpolated."""
    if factor == 1:
        return dtm
    return Dtm(
        dtm.grid.divided(factor),
        finer(dtm.elevation, factor),
        repeat(dtm.sigma_m, factor),
        repeat(dtm.observations, factor) / np.float32(factor**2),
        repeat(dtm.ground, factor),
        None if dtm.pose_sigma_m is None else repeat(dtm.pose_sigma_m, factor),
    )


def finer(values: Raster, factor: int) -> FineRaster:
    """Values in `factor` times finer cells: bilinear between known ones, the same beside gaps."""
    if factor == 1:
        return values
    rows, cols = values.shape
    size = (cols * factor, rows * factor)
    smooth = cv2.resize(values, size, interpolation=cv2.INTER_LINEAR)
    return np.where(np.isfinite(smooth), smooth, repeat(values, factor))


def repeat(layer: np.ndarray, factor: int) -> np.ndarray:
    """Values in `factor` times finer cells, each that of the cell that it lies in."""
    return layer.repeat(factor, axis=0).repeat(factor, axis=1)


def _shrink(values: Raster, factor: int) -> CoarseRaster:
    """Means over blocks of `factor` x `factor` cells."""
    size = (values.shape[1] // factor, values.shape[0] // factor)
    return cv2.resize(values, size, interpolation=cv2.INTER_AREA)
