"""The terrain model of a stop: all dense parallax of its pairs, fused cell by cell.

Every view gives one height for each cell it sees. A cell represents the ground visible from
straight above: where a cell contains points of two levels (a rock's top and the ground at its foot)
the upper part is used, so rocks keep their tops. A cell with points is MEASURED; one that is only
covered by the mesh between neighbouring pixels of one surface is INTERPOLATED.

A parallax error dp moves a point along its ray by P dp/p (P: from camera to point). On ground with
gradient g (rise per metre) the elevation at a fixed position changes by the component of this away
from the ground, so with f the focal length and Z the depth

    sigma_h^2 = (sigma_p/p)^2 (P_up - g.P_plan)^2 / k + (Z sigma_i/f)^2 (1 + g.g) / k
                + (sigma_a/p)^2 (P_up - g.P_plan)^2
                + s^2 / n + (r sag)^2 + (c Z/f)^2 / 12 G^2

where sigma_a is the common part of all parallaxes of a view (wide-baseline pairs; else 0), sigma_p
is the rest, n points come from k = max(1, n / c^2) independent matches (windows of c x c pixels
overlap), s is the scatter within the cell and r the roughness of ground between pixels. The height
of flat ground is accurate to (sigma_p/p) times the camera's height: centimetres at 20 m, although
the range is less accurate.

The last term is for hidden ground that matching interpolates. Relief lower than the window's height
on the ground, c Z/f, is not resolved, and hides ground that the matcher replaces by a ramp along
the line of sight, too high by up to that much. Such ramps are seen edge-on: the distance of their
plane below the camera is less than their own depth below it, so with h = -(P_up - g.P_plan) the
fraction

    G = 1 - h / |P_up|      between 0 and 1

of that uncertainty (uniform over the window) is added. It is 0 on level and on rising ground.

`fusion` adds the variance of the poses and averages the views.

Ground seen at a grazing angle is biased upwards (`matching.height_bias`); where links of the stop
determine the bias, it is subtracted from the model.

With `Gridding.TIN` gaps between measured cells are filled by triangles, as in the paper (section
5). The measured cells, each the weighted mean of its points, are triangulated on the map
(Delaunay). A cell without points gets its height from the plane of its triangle if none of the
triangle's sides is longer than the widest gap to be bridged and if the cell is not occluded
(`occlusion`). With the barycentric coordinates l of the cell the variance is

    sigma^2 = sum(l sigma_i^2) + (r L q)^2,      q = (1 - sum l^2) / 2

where L is the triangle's longest side and r the roughness of ground: in the middle of a side L q is
L/4, as in the mesh between two lines of an image.

Far ground, measured by wide-baseline stereo, has its own parameters: at 200 m a Navcam pixel covers
0.16 m across the line of sight and, from a mast, twenty metres along it, so cells are larger and
gaps wider than in the map of a stop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from scipy.spatial import Delaunay

from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.matching.height_bias import (
    NO_BIAS,
    mean_of_known,
    metres_per_line,
)
from solmap.photogrammetry.planes import Gradients, window_gradients
from solmap.photogrammetry.ranges import (
    MOST_SIDE,
    CellSize,
    Metres,
    Pixels,
    ShareAboveZero,
    ShortMetres,
)
from solmap.photogrammetry.terrain.dtm.fusion import (
    PATCH,
    Entries,
    FusionParams,
    Levels,
    fuse,
    variances,
)
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, MapGrid
from solmap.photogrammetry.terrain.dtm.ground import camera_on_map
from solmap.photogrammetry.terrain.dtm.heights import ViewHeights, view_heights
from solmap.photogrammetry.terrain.dtm.occlusion import mark_occluded
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass, TerrainView

STEEPEST = 1.0
"""Gradient above which a cell's own slope is not used: beyond 45 degrees, a rock's side."""
FACET_M = 0.1
"""Standard deviation of the Gaussian that smooths facets, as in surface alignment,"""
LEAST_KNOWN = 0.15
"""and the fraction of its weight that known cells must have."""
LEAST_NODES = 4
"""Fewest points of a triangulation."""
Weights3 = Float64[np.ndarray, "n 3"]


class Gridding(StrEnum):
    """Filling of cells between the measured ones (paper, section 5)."""

    GRID = "grid"
    """Interpolate by the mesh of connected pixels in an image."""
    TIN = "tin"
    """Interpolate by triangles between measured cells."""


@dataclass(frozen=True, slots=True)
class DtmParams(FusionParams):
    """How to build a terrain model."""

    method: Gridding = Gridding.GRID
    """How gaps are filled: `grid`, by the mesh of pixels, which follows jumps of the image; or
    `tin`, by triangles, a tenth to a fifth more accurate in more than twice the time."""

    cell_m: CellSize = 0.04
    """Side of a cell: four orthophoto cells, and the spacing of Navcam samples at 50 m."""
    slope_baseline_m: ShortMetres = 0.5
    """Baseline of the slope that enters the standard deviation: some cells, less than a rover."""

    def __post_init__(self) -> None:
        if 2 * self.radius_m > MOST_SIDE * self.cell_m:
            raise TerrainError(
                f"ground as far as {self.radius_m} m has more than {MOST_SIDE} cells of "
                f"{self.cell_m} m a side: give larger cells or a smaller radius"
            )


@dataclass(frozen=True, slots=True)
class FarDtmParams(DtmParams):
    """How to build a terrain model of far ground."""

    cell_m: CellSize = 0.64
    """Four Navcam pixels at 200 m; sixteen cells of a stop's model, so that both maps nest."""
    max_relative_sigma: ShareAboveZero = 0.1
    """A baseline of 10 m is accurate to ten percent beyond a kilometre: the radius ends the map
    before."""
    radius_m: Metres = 500.0
    """As far as wide-baseline stereo in the paper (section 5): range errors there are a twentieth
    with a baseline of 10 m (docs/reference/measurements/matching.md)."""
    max_spike_px: Pixels = 5.0
    """Parallax changes by B / h per line, seven pixels with 10 m: far more than with a rig."""
    max_gap_m: Metres = 8.0
    """Widest gap bridged. The line spacing Z^2 / f (h + Z s) of ground that rises away from the
    camera by s a metre is 1.5 m for s = 0.1 at 200 m, and 8 m for s = 0.013."""
    slope_baseline_m: ShortMetres = 8.0
    """Some cells, as in the model of a stop."""


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
            f"{params.radius_m} m: check the matching, or allow a larger max_relative_sigma"
        )
    grid = grid or _grid_around(heights, params.cell_m)
    if grid.cell_m != params.cell_m:
        raise TerrainError(
            f"the grid's cells are {grid.cell_m} m, but those of the parameters {params.cell_m} m"
        )
    entries = Entries.of(heights, grid)
    if not len(entries):
        raise TerrainError(f"no measured ground lies in the grid {grid.bounds}")
    gradient = _significant_gradient(entries, params)
    dtm = _dtm(entries, fuse(entries, variances(entries, views, gradient, params)))
    ground = mark_occluded(dtm.ground, dtm.elevation, grid, views, params)
    dtm = replace(dtm, ground=ground)
    dtm = dtm if meshed else fill_by_triangles(dtm, params.max_gap_m, params.roughness)
    return _lowered(dtm, views)


def _lowered(dtm: Dtm, views: Sequence[TerrainView]) -> Dtm:
    """The model minus the height bias of ground seen at a grazing angle, common to all views."""
    bias = views[0].height_bias
    if bias == NO_BIAS:
        return dtm
    camera = np.mean([camera_on_map(view.lsl_from_pair) for view in views], axis=0)
    east, north = (axis.astype(np.float32) for axis in dtm.grid.centres())
    up = mean_of_known(dtm.elevation, FACET_M / dtm.grid.cell_m, LEAST_KNOWN)
    focal_px = min(view.geometry.focal_px for view in views)
    east, north = east - np.float32(camera[0]), north - np.float32(camera[1])
    metres = metres_per_line(up, north[:, None], east[None], float(camera[2]), focal_px)
    elevation = dtm.elevation - np.float32(bias.lines) * metres
    sigma_m = np.hypot(dtm.sigma_m, np.float32(bias.sigma) * metres)
    return replace(dtm, elevation=elevation, sigma_m=sigma_m)


def _significant_gradient(entries: Entries, params: DtmParams) -> Gradients:
    """The gradient of the ground in patches; 0 where unknown or too steep for ground."""
    patch_m = PATCH * params.cell_m
    gradient = window_gradients(entries.patch_means(), patch_m, params.slope_baseline_m, 0.25)
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


def fill_by_triangles(dtm: Dtm, gap_m: float, roughness: float) -> Dtm:
    """A model of measured and occluded cells with its gaps of up to `gap_m` filled."""
    measured = dtm.ground == GroundClass.MEASURED
    near = cv2.distanceTransform((~measured).astype(np.uint8), cv2.DIST_L2, 5) * dtm.grid.cell_m
    # no point in a triangle is farther from a corner than its longest side over the root of three
    open_ = (dtm.ground == GroundClass.UNSEEN) & (near <= gap_m / np.sqrt(3))
    border = cv2.dilate(open_.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    nodes = np.argwhere(measured & (border | ~_has_measured_neighbours(measured)))
    cells = np.argwhere(open_)
    if len(nodes) < LEAST_NODES or not len(cells):
        return dtm
    found = _Triangles.around(nodes, cells, gap_m / dtm.grid.cell_m)
    return found.fill(dtm, roughness)


def _has_measured_neighbours(measured: np.ndarray) -> np.ndarray:
    """Measured cells whose eight neighbours are measured: their triangles contain no gap."""
    return cv2.erode(measured.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


@dataclass(frozen=True, slots=True, eq=False)
class _Triangles:
    """Cells in a triangle of measured ones."""

    cells: np.ndarray
    """(n, 2): row and column."""
    corners: np.ndarray
    """(n, 3, 2): rows and columns of the measured cells around."""
    weights: Weights3
    side: np.ndarray
    """Longest side, cells."""

    @classmethod
    def around(cls, nodes: np.ndarray, cells: np.ndarray, gap: float) -> _Triangles:
        """The triangles around some cells whose sides are no longer than `gap` cells."""
        mesh = Delaunay(nodes.astype(np.float64))
        sides = np.diff(nodes[mesh.simplices[:, [0, 1, 2, 0]]], axis=1)
        longest = np.sqrt((sides.astype(np.float64) ** 2).sum(axis=2)).max(axis=1)
        triangle = mesh.find_simplex(cells.astype(np.float64))
        inside = (triangle >= 0) & (longest[triangle] <= gap)
        cells, triangle = cells[inside], triangle[inside]
        frame = mesh.transform[triangle]
        first = np.einsum("nij,nj->ni", frame[:, :2], cells - frame[:, 2])
        weights = np.column_stack([first, 1 - first.sum(axis=1)])
        return cls(cells, nodes[mesh.simplices[triangle]], weights, longest[triangle])

    def mean(self, layer: np.ndarray) -> np.ndarray:
        """A layer's values on the planes of the triangles."""
        at_corners = layer[self.corners[..., 0], self.corners[..., 1]]
        return np.einsum("ni,ni->n", self.weights, at_corners)

    def fill(self, dtm: Dtm, roughness: float) -> Dtm:
        """The model with these cells interpolated."""
        row, col = self.cells.T
        spread = (1 - np.square(self.weights).sum(axis=1)) / 2
        stray = roughness * self.side * dtm.grid.cell_m * spread
        variance = np.maximum(self.mean(np.square(dtm.sigma_m.astype(np.float64))), 0)
        elevation, sigma_m, ground = dtm.elevation.copy(), dtm.sigma_m.copy(), dtm.ground.copy()
        elevation[row, col] = self.mean(elevation.astype(np.float64))
        sigma_m[row, col] = np.sqrt(variance + np.square(stray))
        ground[row, col] = GroundClass.INTERPOLATED
        pose = None if dtm.pose_sigma_m is None else dtm.pose_sigma_m.copy()
        if pose is not None:
            pose[row, col] = self.mean(pose)
        return replace(dtm, elevation=elevation, sigma_m=sigma_m, ground=ground, pose_sigma_m=pose)
