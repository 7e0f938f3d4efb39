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

To this comes what the poses leave open, and views are averaged (`fusion`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.fusion import (
    PATCH,
    Entries,
    FusionParams,
    Levels,
    fuse,
    variances,
)
from solmap.photogrammetry.terrain.grid import BLOCK, MapGrid
from solmap.photogrammetry.terrain.heights import ViewHeights, view_heights
from solmap.photogrammetry.terrain.occlusion import mark_occluded
from solmap.photogrammetry.terrain.planes import Gradients, gradients
from solmap.photogrammetry.terrain.records import Dtm, GroundClass, TerrainView
from solmap.photogrammetry.terrain.tin import fill_by_triangles

STEEPEST = 1.0
"""Gradient above which a cell's own slope is not believed: beyond 45 degrees, a rock's side."""


class Gridding(StrEnum):
    """What becomes of cells between the measured ones (paper, section 5)."""

    GRID = "grid"
    """They are crossed by the mesh of pixels that hang together in an image."""
    TIN = "tin"
    """They lie in a triangle of measured cells."""


@dataclass(frozen=True, slots=True)
class DtmParams(FusionParams):
    """How to build a terrain model."""

    method: Gridding = Gridding.GRID
    """The mesh knows where the image jumps and takes less than half of the time; elevations between
    triangles are a tenth to a fifth more accurate (docs/benchmarks.md)."""

    cell_m: float = 0.04
    """Side of a cell: four orthophoto cells, and the spacing of Navcam samples at 50 m."""
    slope_baseline_m: float = 0.5
    """Baseline of the slope that enters the standard deviation: some cells, less than a rover."""


def build_dtm(views: Sequence[TerrainView], params: DtmParams, grid: MapGrid | None = None) -> Dtm:
    """The terrain model of all views, on `grid` or on the smallest grid of whole blocks.

    Raises:
        TerrainError: no view has a trusted parallax, or none falls into `grid`.
    """
    meshed = params.method is Gridding.GRID
    heights = [view_heights(view, params, params.cell_m, meshed=meshed) for view in views]
    if not any(len(one) for one in heights):
        raise TerrainError(
            f"none of the {len(views)} views has a parallax above "
            f"{params.sigma_parallax_px / params.max_relative_sigma:.1f} px within "
            f"{params.radius_m} m: look at the matching, or allow a larger max_relative_sigma"
        )
    grid = grid or _grid_around(heights, params.cell_m)
    if grid.cell_m != params.cell_m:
        raise TerrainError(f"the grid's cells are {grid.cell_m} m, the parameters' {params.cell_m}")
    entries = Entries.of(heights, grid)
    if not len(entries):
        raise TerrainError(f"no measured ground falls into the grid {grid.bounds}")
    gradient = _believable_gradient(entries, params)
    dtm = _dtm(entries, fuse(entries, variances(entries, views, gradient, params)))
    ground = mark_occluded(dtm.ground, dtm.elevation, grid, views, params)
    dtm = replace(dtm, ground=ground)
    return dtm if meshed else fill_by_triangles(dtm, params.max_gap_m, params.roughness)


def _believable_gradient(entries: Entries, params: DtmParams) -> Gradients:
    """The gradient of the ground in patches; 0 where it is unknown or too steep for ground."""
    patch_m = PATCH * params.cell_m
    gradient = gradients(entries.patch_means(), patch_m, params.slope_baseline_m, 0.25)
    gradient[~(np.abs(gradient) < STEEPEST)] = 0.0
    return gradient


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


def _dtm(entries: Entries, fused: Levels) -> Dtm:
    """The record of the fused cells."""
    grid, seen = entries.grid, np.isfinite(fused.level)
    points = entries.sums(entries.points)
    ground = np.where(points > 0, GroundClass.MEASURED, GroundClass.INTERPOLATED)
    ground = np.where(seen, ground, GroundClass.UNSEEN).astype(np.uint8)
    layers = (fused.level, fused.sigma_m, points, fused.pose_sigma_m)
    elevation, sigma_m, observations, pose_sigma_m = (
        layer.reshape(grid.shape).astype(np.float32) for layer in layers
    )
    return Dtm(grid, elevation, sigma_m, observations, ground.reshape(grid.shape), pose_sigma_m)
