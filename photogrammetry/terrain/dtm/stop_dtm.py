"""The terrain model of a stop, made by fusing the dense parallaxes of all its pairs, cell by cell.

Every view gives one height for each cell it sees. A cell represents the ground visible from
straight above: where a cell contains points of two levels (a rock's top and the ground at its foot)
the upper part is used, so the elevation of a rock is that of its top. A cell with points is
MEASURED; one that is only covered by the mesh that joins neighbouring pixels on one continuous
surface is INTERPOLATED.

A parallax error dp moves a point along its ray by P dp/p (P: from camera to point). On ground with
gradient g (rise per metre) the elevation at a fixed position changes by (P_up - g.P_plan) dp/p,
where P_up and P_plan are the vertical and horizontal parts of P. So with f the focal length and Z
the depth

    sigma_h^2 = (sigma_p/p)^2 (P_up - g.P_plan)^2 / k + (Z sigma_i/f)^2 (1 + g.g) / k
                + (sigma_a/p)^2 (P_up - g.P_plan)^2
                + s^2 / n + (r sag)^2 + G^2 (c Z/f)^2 / 12

where sigma_a is the part of the parallax error that is common to a view (wide-baseline pairs; else
0), sigma_p is the rest, n points come from k = max(1, n / c^2) independent matches (windows of
c x c pixels overlap), s is the scatter within the cell, r the roughness of ground between pixels
and sag the length over which the ground may deviate from the mesh. The height of flat ground is
accurate to (sigma_p/p) times the camera's height: centimetres at 20 m, although the distance along
the ray is less accurate.

The last term is the error where matching has interpolated hidden ground. Relief smaller than the
window's footprint c Z/f is not resolved. The matcher replaces the ground hidden behind it by a ramp
along the line of sight, up to c Z/f too high. The plane of such a ramp passes closer below the
camera (by h = -(P_up - g.P_plan)) than the ramp itself lies (|P_up|). The fraction

    G = 1 - h / |P_up|      clipped to 0..1

of this uncertainty (uniform over the window) is added. It is 0 on level and on rising ground.

`fusion` adds the variance of the poses and averages the views.

Ground seen at a grazing angle is biased upwards (`matching.height_bias`); where links of the stop
to other stops determine the bias, it is subtracted from the model.

With `Gridding.TIN` gaps between measured cells are filled by triangles, as by Di et al. (2008,
section 5). The measured cells, each the weighted mean of its points, are triangulated on the map
(Delaunay). A cell without points gets its height from the plane of its triangle if none of the
triangle's sides is longer than the widest gap to be bridged and if the cell is not occluded
(`occlusion`). With the barycentric coordinates l of the cell the variance is

    sigma^2 = sum(l sigma_i^2) + (r L q)^2,      q = (1 - sum l^2) / 2

where L is the triangle's longest side and r the roughness of ground: in the middle of a side L q is
L/4, the same as for the mesh between two image lines.

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
from solmap.photogrammetry.threads import in_threads

STEEPEST = 1.0
"""Patch gradients of this (45 degrees) and more are not used: they are the sides of rocks."""
FACET_M = 0.1
"""Sigma of the Gaussian that smooths elevations before the bias is computed, metres."""
LEAST_KNOWN = 0.15
"""Smallest share of the Gaussian's weight on known cells for a result."""
LEAST_NODES = 4
"""Fewest points of a triangulation."""
Weights3 = Float64[np.ndarray, "n 3"]


class Gridding(StrEnum):
    """Filling of cells between the measured ones (Di et al. 2008, section 5)."""

    GRID = "grid"
    """Interpolate by the mesh of connected pixels in an image."""
    TIN = "tin"
    """Interpolate by triangles between measured cells."""


@dataclass(frozen=True, slots=True)
class DtmParams(FusionParams):
    """How to build a terrain model."""

    method: Gridding = Gridding.GRID
    """How gaps are filled: `grid` by the mesh of pixels, which breaks at depth discontinuities;
    `tin` by triangles, 10 to 20 % more accurate but more than twice as slow."""

    cell_m: CellSize = 0.04
    """Side of a cell, equal to the width of four orthophoto cells and to the spacing of Navcam
    samples at 50 m."""
    slope_baseline_m: ShortMetres = 0.5
    """Baseline of the slope that enters the standard deviation: several cells, shorter than a
    rover."""

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
    """Four Navcam pixels at 200 m; sixteen cells of a stop's model, so that the two grids align."""
    max_relative_sigma: ShareAboveZero = 0.1
    """With a 10 m baseline ten percent is reached only beyond a kilometre, so `radius_m` is the
    effective limit."""
    radius_m: Metres = 500.0
    """As far as wide-baseline stereo of Di et al. (2008, section 5): range errors there are 5 % of
    the range with a baseline of 10 m (docs/reference/measurements/matching.md)."""
    max_spike_px: Pixels = 5.0
    """Parallax changes by B/h per image line: about seven pixels for B = 10 m, far more than for a
    rig."""
    max_gap_m: Metres = 8.0
    """Widest gap bridged. The line spacing Z^2 / (f (h + Z s)) of ground that rises away from the
    camera by s a metre is 1.5 m for s = 0.1 at 200 m, and 8 m for s = 0.013."""
    slope_baseline_m: ShortMetres = 8.0
    """Several cells, as in the model of a stop."""


def build_dtm(views: Sequence[TerrainView], params: DtmParams, grid: MapGrid | None = None) -> Dtm:
    """The terrain model of all views, on `grid` or on the smallest grid of whole blocks.

    Raises:
        TerrainError: no view has a trusted parallax, or no measured ground lies in `grid`.
    """
    meshed = params.method is Gridding.GRID
    heights = in_threads(
        lambda view: view_heights(view, params, params.cell_m, meshed=meshed), views
    )
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
    return _without_height_bias(dtm, views)


def _without_height_bias(dtm: Dtm, views: Sequence[TerrainView]) -> Dtm:
    """The model with the height bias subtracted; all views have the same bias."""
    bias = views[0].height_bias
    if bias == NO_BIAS:
        return dtm
    camera = np.mean([camera_on_map(view.lsl_from_pair) for view in views], axis=0)
    east, north = (axis.astype(np.float32) for axis in dtm.grid.centres())
    up = mean_of_known(dtm.elevation, FACET_M / dtm.grid.cell_m, LEAST_KNOWN)
    focal_px = min(view.geometry.focal_px for view in views)
    east, north = east - np.float32(camera[0]), north - np.float32(camera[1])
    metres = metres_per_line(up, north, east, float(camera[2]), focal_px)
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
    """The terrain model from the fused cells."""
    grid, seen = entries.grid, np.isfinite(fused.level)
    points = entries.sums(entries.points)
    ground = np.where(points > 0, GroundClass.MEASURED, GroundClass.INTERPOLATED)
    ground = np.where(seen, ground, GroundClass.UNSEEN).astype(np.uint8)
    layers = (fused.level, fused.sigma_m, points.astype(np.float32), fused.pose_sigma_m)
    elevation, sigma_m, observations, pose_sigma_m = (layer.reshape(grid.shape) for layer in layers)
    return Dtm(grid, elevation, sigma_m, observations, ground.reshape(grid.shape), pose_sigma_m)


def fill_by_triangles(dtm: Dtm, gap_m: float, roughness: float) -> Dtm:
    """The model with gaps up to `gap_m` filled.

    It contains only measured and occluded cells at first.
    """
    measured = dtm.ground == GroundClass.MEASURED
    near = cv2.distanceTransform((~measured).astype(np.uint8), cv2.DIST_L2, 5) * dtm.grid.cell_m
    # no point in a triangle is farther from the nearest corner than the triangle's longest side
    # divided by sqrt(3)
    open_ = (dtm.ground == GroundClass.UNSEEN) & (near <= gap_m / np.sqrt(3))
    border = cv2.dilate(open_.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    nodes = np.argwhere(measured & (border | ~_has_measured_neighbours(measured)))
    cells = np.argwhere(open_)
    if len(nodes) < LEAST_NODES or not len(cells):
        return dtm
    found = _CellsInTriangles.around(nodes, cells, gap_m / dtm.grid.cell_m)
    return found.fill(dtm, roughness)


def _has_measured_neighbours(measured: np.ndarray) -> np.ndarray:
    """Measured cells whose eight neighbours are measured, so no gap adjoins them."""
    return cv2.erode(measured.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


@dataclass(frozen=True, slots=True, eq=False)
class _CellsInTriangles:
    """Unmeasured cells, each with the triangle of measured cells around it."""

    cells: np.ndarray
    """(n, 2): row and column."""
    corners: np.ndarray
    """(n, 3, 2): rows and columns of the measured cells around."""
    weights: Weights3
    side: np.ndarray
    """Longest side, cells."""

    @classmethod
    def around(cls, nodes: np.ndarray, cells: np.ndarray, gap: float) -> _CellsInTriangles:
        """The cells that lie in triangles with sides up to `gap` cells."""
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
