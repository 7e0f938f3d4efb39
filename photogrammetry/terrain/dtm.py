"""The terrain model of a stop: all dense parallax of its pairs, fused cell by cell.

Every view gives each cell it sees one height. A cell stands for the ground that a person looking
straight down would see in it: where points of two levels fall into one cell (a rock's top and the
ground at its foot) the upper part counts, so rocks keep their tops. A cell with points is MEASURED;
one that only the mesh between neighbouring pixels of one surface crosses is INTERPOLATED.

A parallax error dp moves a point along its ray by P dp/p (P: from camera to point). On ground with
gradient g (rise per metre) the elevation at a fixed place changes by the part of this that leaves
the ground, so with f the focal length and Z the depth

    sigma_h^2 = (sigma_p/p)^2 (P_up - g.P_plan)^2 / k + (Z sigma_i/f)^2 (1 + g.g) / k
                + (sigma_a/p)^2 (P_up - g.P_plan)^2
                + s^2 / n + (r sag)^2 + (c Z/f)^2 / 12 G^2

where sigma_a is what all parallaxes of a view share (two stops as one instrument; else 0), sigma_p
is the rest, n points share k = max(1, n / c^2) independent matches (windows of c x c pixels
overlap), s is the scatter within the cell and r the roughness of ground between pixels. Flat ground
is known to (sigma_p/p) times the camera's height: centimetres at 20 m, though the range is not.

The last term is for ground that stereo takes for seen although it is not. Relief lower than the
window's height on the ground, c Z/f, is not resolved, and hides ground of which the matcher makes
a ramp along the line of sight, up to as much too high. Such ramps are seen edge-on: their plane
passes closer below the camera than they lie below it, so with h = -(P_up - g.P_plan) the share

    G = 1 - h / |P_up|      between 0 and 1

of that uncertainty (uniform over the window) is added. It is 0 on level and on rising ground.

Views are averaged with weights 1/sigma_h^2, those that disagree by more than two sigma counting for
less (Huber), and what disagreement remains enlarges the standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from photogrammetry.arrays import Float64
from photogrammetry.errors import TerrainError
from photogrammetry.matching.dense import SharedSigma
from photogrammetry.terrain.grid import BLOCK, MapGrid
from photogrammetry.terrain.ground import SightParams, camera_on_map, map_from_pair_rotation
from photogrammetry.terrain.heights import ViewHeights, view_heights
from photogrammetry.terrain.records import Dtm, GroundClass, TerrainView
from photogrammetry.terrain.surface import Gradients, gradients

HUBER = 2.0
"""Standard deviations beyond which a view counts for less."""
ROUNDS = 3
"""Rounds of reweighting; the weights hardly change after two."""
STEEPEST = 1.0
"""Gradient above which a cell's own slope is not believed: beyond 45 degrees, a rock's side."""


@dataclass(frozen=True, slots=True)
class DtmParams(SightParams):
    """How to build a terrain model."""

    cell_m: float = 0.04
    """Side of a cell: four orthophoto cells, and the spacing of Navcam samples at 50 m."""
    sigma_image_px: float = 0.25
    """Standard deviation of an image coordinate: half a pixel's rounding by the matching window."""
    correlation_px: float = 9.0
    """Side of the window that refines dense parallax: pixels this close share their error."""
    roughness: float = 0.2
    """How far ground strays between pixels, over the length: the slope of rocky plains over some
    decimetres is about ten degrees (RMS)."""
    slope_baseline_m: float = 0.5
    """Baseline of the slope that enters the standard deviation: some cells, less than a rover."""


def build_dtm(views: Sequence[TerrainView], params: DtmParams, grid: MapGrid | None = None) -> Dtm:
    """The terrain model of all views, on `grid` or on the smallest grid of whole blocks.

    Raises:
        TerrainError: no view has a trusted parallax, or none falls into `grid`.
    """
    heights = [view_heights(view, params, params.cell_m) for view in views]
    if not any(len(one) for one in heights):
        raise TerrainError(
            f"none of the {len(views)} views has a parallax above "
            f"{params.sigma_parallax_px / params.max_relative_sigma:.1f} px within "
            f"{params.radius_m} m: look at the matching, or allow a larger max_relative_sigma"
        )
    grid = grid or _grid_around(heights, params.cell_m)
    if grid.cell_m != params.cell_m:
        raise TerrainError(f"the grid's cells are {grid.cell_m} m, the parameters' {params.cell_m}")
    entries = _Entries.of(heights, grid)
    if not len(entries.cell):
        raise TerrainError(f"no measured ground falls into the grid {grid.bounds}")
    flat = np.zeros((2, *grid.shape), dtype=np.float32)
    level, _ = _fuse(entries, _variances(entries, views, grid, flat, params))
    gradient = gradients(
        level.reshape(grid.shape).astype(np.float32), params.cell_m, params.slope_baseline_m, 0.25
    )
    gradient = np.nan_to_num(np.where(np.abs(gradient) < STEEPEST, gradient, 0.0))
    level, sigma = _fuse(entries, _variances(entries, views, grid, gradient, params))
    return _dtm(entries, grid, level, sigma)


def _grid_around(heights: Sequence[ViewHeights], cell_m: float) -> MapGrid:
    """The smallest grid of whole blocks that holds all cells."""
    seen = [one for one in heights if len(one)]
    first_row, last_row = min(o.row.min() for o in seen), max(o.row.max() for o in seen)
    first_col, last_col = min(o.col.min() for o in seen), max(o.col.max() for o in seen)
    top, bottom = int(first_row) // BLOCK, int(last_row) // BLOCK + 1
    left, right = int(first_col) // BLOCK, int(last_col) // BLOCK + 1
    block_m = BLOCK * cell_m
    rows, cols = (bottom - top) * BLOCK, (right - left) * BLOCK
    return MapGrid(left * block_m, -top * block_m, cell_m, rows, cols)


@dataclass(frozen=True, slots=True, eq=False)
class _Entries:
    """What all views say of all cells, one row a view and cell."""

    shape: tuple[int, int]
    cell: np.ndarray
    view: np.ndarray
    height: np.ndarray
    points: np.ndarray
    scatter: np.ndarray
    sigma_px: np.ndarray
    sag: np.ndarray

    @classmethod
    def of(cls, heights: Sequence[ViewHeights], grid: MapGrid) -> _Entries:
        """The entries that fall into the grid."""
        first_row, first_col = round(-grid.north / grid.cell_m), round(grid.west / grid.cell_m)
        parts = []
        for number, one in enumerate(heights):
            row, col = one.row - first_row, one.col - first_col
            inside = (row >= 0) & (row < grid.rows) & (col >= 0) & (col < grid.cols)
            cell = row[inside] * grid.cols + col[inside]
            view = np.full(len(cell), number, dtype=np.int32)
            fields = (one.height, one.points, one.scatter, one.sigma_px, one.sag)
            parts.append((cell, view, *(field[inside] for field in fields)))
        return cls(grid.shape, *(np.concatenate(column) for column in zip(*parts, strict=True)))

    def sums(self, weights: Float64[np.ndarray, " entries"]) -> Float64[np.ndarray, " cells"]:
        """Sum of the weights of every cell's entries."""
        return np.bincount(self.cell, weights, minlength=self.shape[0] * self.shape[1])


def _variances(
    entries: _Entries,
    views: Sequence[TerrainView],
    grid: MapGrid,
    gradient: Gradients,
    params: DtmParams,
) -> Float64[np.ndarray, " entries"]:
    """Variance of the elevation of every entry, on ground with this gradient."""
    row, col = np.divmod(entries.cell, grid.cols)
    east = grid.west + (col + 0.5) * grid.cell_m
    north = grid.north - (row + 0.5) * grid.cell_m
    g_east, g_north = gradient[0].ravel()[entries.cell], gradient[1].ravel()[entries.cell]
    camera = np.array([camera_on_map(view.lsl_from_pair) for view in views])[entries.view]
    forward = np.array([map_from_pair_rotation(v.lsl_from_pair)[:, 2] for v in views])[entries.view]
    focal = np.array([view.geometry.focal_px for view in views])[entries.view]
    base = np.array([view.geometry.base_m for view in views])[entries.view]
    P = np.column_stack([east, north, entries.height]) - camera
    Z = np.maximum(np.einsum("ij,ij->i", P, forward), grid.cell_m)
    leaving = P[:, 2] - g_east * P[:, 0] - g_north * P[:, 1]
    shared_px = _shared_px(views, entries.view, focal * base / Z)
    own_px = np.sqrt(np.maximum(entries.sigma_px.astype(np.float64) ** 2 - shared_px**2, 0.0))
    along = (own_px * Z / (focal * base) * leaving) ** 2
    together = (shared_px * Z / (focal * base) * leaving) ** 2
    across = (params.sigma_image_px * Z / focal) ** 2 * (1 + g_east**2 + g_north**2)
    matches = np.maximum(1.0, entries.points / params.correlation_px**2)
    points = np.maximum(1.0, entries.points)
    grazing = np.clip(1 + leaving / np.maximum(np.abs(P[:, 2]), grid.cell_m), 0, 1)
    unresolved = params.correlation_px * Z / focal * grazing
    return (
        (along + across) / matches
        + together
        + entries.scatter**2 / points
        + (params.roughness * entries.sag) ** 2
        + unresolved**2 / 12
    )


def _shared_px(
    views: Sequence[TerrainView], view: np.ndarray, parallax_px: Float64[np.ndarray, " entries"]
) -> Float64[np.ndarray, " entries"]:
    """Standard deviation that every entry's parallax shares with all others of its view."""
    shared = [view.shared or SharedSigma() for view in views]
    offset_px = np.array([one.offset_px for one in shared])[view]
    stretch = np.array([one.stretch for one in shared])[view]
    return np.hypot(offset_px, stretch * parallax_px)


def _fuse(
    entries: _Entries, variance: Float64[np.ndarray, " entries"]
) -> tuple[Float64[np.ndarray, " cells"], Float64[np.ndarray, " cells"]]:
    """Elevation and standard deviation of every cell; NaN where there is no entry."""
    reweighting = np.ones_like(variance)
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(ROUNDS):
            weight = reweighting / variance
            total = entries.sums(weight)
            level = entries.sums(weight * entries.height) / total
            off = np.abs(entries.height - level[entries.cell]) / np.sqrt(variance)
            reweighting = HUBER / np.maximum(HUBER, off)
        redundancy = entries.sums(np.ones_like(variance)) - 1
        disagreement = entries.sums(off**2 * reweighting) / np.maximum(1, redundancy)
        return level, np.sqrt(np.maximum(1.0, disagreement) / total)


def _dtm(entries: _Entries, grid: MapGrid, level: np.ndarray, sigma: np.ndarray) -> Dtm:
    """The record of the fused cells."""
    seen = np.isfinite(level)
    points = entries.sums(entries.points.astype(np.float64))
    ground = np.where(points > 0, GroundClass.MEASURED, GroundClass.INTERPOLATED)
    ground = np.where(seen, ground, GroundClass.UNSEEN).astype(np.uint8)
    sigma = np.where(seen, sigma, np.nan)
    elevation, sigma_m, observations = (
        layer.reshape(grid.shape).astype(np.float32) for layer in (level, sigma, points)
    )
    return Dtm(grid, elevation, sigma_m, observations, ground.reshape(grid.shape))
