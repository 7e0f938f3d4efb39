"""Least-squares matching of the surfaces of two stops, as heights on a level grid.

The image of the ground depends on the sun, its shape does not. The dense parallax of a stop gives
the heights of the ground around it on a grid; a point Y of the later stop's ground, transformed by
R Y + t to the level frame of the earlier one, lies above the ground there by

    r = z(R Y + t) - h(n, e),        dr = (dz - grad h . (dn, de)),

and the motion that makes r vanish is found by least squares (Gruen and Akca 2005, ISPRS J. 59,
151-174; Chen and Medioni 1992), with Tukey's biweight, from coarse to fine: Gaussians of half a
metre first, of 10 cm at last. Smoothing on the ground is the same for both stops. Windows in the
images differ: at a grazing ray they are ten times longer along the ray than across, and placed
stops on opposite sides 3 to 8 cm too far apart.

The first rounds compare relief alone, heights less their mean over a metre, so that errors of tilt
and pointing, which grow with range, do not bias low relief. The final correlation of relief
distinguishes a true position from a wrong one (`correlation`).

Visibility: facets seen at a small angle are crests and the steps behind them, which matching
extends too far; they are excluded, and so is ground that one stop sees from more than twice as far
as the other. Heights are compared cell by cell where both stops have them, and their differences
are smoothed. Smoothed separately, ground hidden behind a crest at one stop would get the height of
the crest.

Ground seen at a grazing angle is measured too high (`height_bias`). Between two stops on either
side this causes a tilt of 0.05 to 0.1 degrees, and, because each stop sees its own side of the
relief at larger angles, a few centimetres of distance. The bias in lines b, the same for both
stops, is a seventh unknown, which can be separated from a tilt and from a shift:

    r + b (l_later - l_earlier) = 0,        b = 0 +- 1 line

Neighbouring cells share stones, crests and windows, so residuals are correlated. The covariance is
therefore that of scores summed over blocks of ground (Liang and Zeger 1986, Biometrika 73, 13-22):
(A + K)^-1 (B + K) (A + K)^-1 with the normal matrix A, the sum B of squared scores of blocks, and
the prior K. Errors common to all blocks are added: a parallax that is too small everywhere moves
the ground of both stops away from them. Where the suns differ, other faces are lit and matched, and
the ground that both stops see is displaced and turned as a whole, by more than blocks show. With
the true pointings of all pairs, four registrations under opposite suns (two simulated worlds) had
errors of 1.2 cm per axis in the middle of that ground and of 0.08 degrees of azimuth, where blocks
state 0.2 to 0.6 cm and 0.01 to 0.03. These two enter times half the difference of the unit vectors
towards both suns: 1 for opposite directions.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import (
    Flags,
    Float64,
    ObjectPoints,
    PerPoint,
    Raster,
    Vector3,
)
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.birds_eye import level_camera
from solmap.photogrammetry.matching.cross_site.kernels import sum_heights
from solmap.photogrammetry.matching.height_bias import (
    HeightBias,
    mean_of_known,
    metres_per_line,
)
from solmap.photogrammetry.matching.records import MatchedStop
from solmap.photogrammetry.ranges import (
    CellSize,
    Few,
    Metres,
    MetresOrZero,
    Pixels,
    PixelsOrZero,
    Radians,
)
from solmap.photogrammetry.robust import robust_sigma

MOTION = 6
"""Unknowns of a rigid motion: rotation vector, shift. One more is the height bias of both stops in
lines."""

RELIEF_WAVE_M = 1.2
"""Relief is height minus its Gaussian mean of this standard deviation."""

RELIEF = ((True, 0.4), (True, 0.2))
HEIGHTS = ((False, 0.2), (False, 0.1))
"""(whether only relief is compared, standard deviation of the Gaussian in metres)."""

FOOTPRINT = 4 * np.pi
"""Number of cells, one Gaussian's standard deviation apart, with the information of one."""

LEAST_CELLS = 200
"""Fewest cells of common ground: some square metres."""

SETTLED_M = 5e-4
"""Length of the last step."""

LEAST_KNOWN = 0.15
"""Fraction of a Gaussian's weight on known cells,"""

LEAST_SHARED = 0.3
"""and on cells known at both stops."""

MOSTLY = 0.5
"""Fraction of the interpolation weight of four cells on known ones."""

RANGE_RATIO = 2.5
"""Largest ratio of ranges of ground at both stops; beyond it they see different faces."""

KERNEL = 2.0
"""Standard deviations beyond which a cell has no weight."""

CLUSTER_M = 4.0
"""Side of a block of ground whose cells are treated as correlated."""

ROW = 1000
"""Row length in which points are interpolated: OpenCV's rasters are at most 32767 wide."""


@dataclass(frozen=True, slots=True)
class SurfaceParams:
    """How surfaces are compared."""

    cell_m: CellSize = 0.05
    """Side of a cell."""
    farthest_m: Metres = 25.0
    """Farthest ground: beyond it Navcam lines are more than 30 cm apart on level ground."""
    sigma_parallax_px: Pixels = 0.1
    """Standard deviation of dense parallax."""
    bias_parallax_px: PixelsOrZero = 0.03
    """c: standard deviation of the error common to all parallaxes of both stops."""
    bias_line_px: Pixels = 1.0
    """b: prior standard deviation of the height bias, in lines."""
    shared_shift_m: MetresOrZero = 0.012
    """Standard deviation, per axis, of the horizontal displacement of all common ground under suns
    in opposite directions."""
    shared_turn: Radians = 0.0013
    """Standard deviation of the rotation of all common ground about the vertical, under the same
    suns."""
    rounds: Few = 12
    """Most rounds for each Gaussian."""

    def __post_init__(self) -> None:
        if not (self.rounds > 0 and self.farthest_m > self.cell_m):
            raise MatchingError("surfaces need at least one round, and cells below their size")


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """Heights around a stop in its level frame; row 0 is the northernmost, the rover central."""

    cell_m: float
    up: Raster
    """Metres above the rover origin; NaN where nothing was measured well."""
    mast_m: float
    """Height of the cameras above the rover origin."""
    scale_px_m: float
    """f B, and"""
    focal_px: float
    """f, of the pairs with the smallest f B."""
    sun: Vector3 | None = None
    """Mean direction towards the Sun in the axes of the LSL; None if not known."""
    smoothed: dict[float, Raster] = field(default_factory=dict, init=False)
    _surfaces: dict[tuple[float, bool], _Surface] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, stop: MatchedStop, params: SurfaceParams) -> HeightGrid:
        """From everything that the pairs of a stop measured well."""
        size = 2 * round(params.farthest_m / params.cell_m)
        total, grid = np.zeros((2, size * size)), (params.cell_m, size / 2 * params.cell_m, size)
        for pair in stop.pairs:
            camera = level_camera(stop, pair)
            total += sum_heights(pair.parallax, *camera, params.farthest_m, grid)
        weight, up = total.reshape(2, size, size)
        with np.errstate(invalid="ignore"):
            up = (up / weight).astype(np.float32)
        shapes = [pair.geometry for pair in stop.pairs]
        coarsest = min(shapes, key=lambda g: g.focal_px * g.base_m)
        level = stop.lsl_from_rover.rotation @ coarsest.rover_from_pair.translation_m
        scale_px_m = coarsest.focal_px * coarsest.base_m
        suns = [pair.sun for pair in stop.pairs if pair.sun is not None]
        sun = np.mean(suns, axis=0) if suns else None
        return cls(params.cell_m, up, -float(level[2]), scale_px_m, coarsest.focal_px, sun)

    @cached_property
    def known(self) -> Raster:
        """1 where heights are known, else 0."""
        return np.isfinite(self.up).astype(np.float32)

    @cached_property
    def filled(self) -> Raster:
        """Heights, 0 where unknown."""
        return np.nan_to_num(self.up)

    @cached_property
    def cells(self) -> ObjectPoints:
        """Positions of all known heights, row by row."""
        return self.points(self.up, 1)

    def noise_m(self, distance_m: PerPoint, parallax_px: float) -> PerPoint:
        """Height error of level ground at this distance for an error of its parallax."""
        return parallax_px * self.mast_m / self.scale_px_m * distance_m

    def from_mast(self, places: ObjectPoints) -> ObjectPoints:
        """Positions of the level frame, relative to the cameras."""
        return places + np.array([0.0, 0.0, self.mast_m])

    def too_high_m(self, sigma_m: float) -> Raster:
        """Height bias of cells per line of b, with slopes smoothed by a Gaussian."""
        half = self.up.shape[0] / 2 - 0.5
        east = ((np.arange(self.up.shape[1]) - half) * self.cell_m).astype(np.float32)
        up = self.smooth(sigma_m)
        return metres_per_line(up, -east, east, self.mast_m, self.focal_px)

    def smooth(self, sigma_m: float) -> Raster:
        """Heights smoothed by a Gaussian, NaN where it covers too little."""
        if sigma_m not in self.smoothed:
            self.smoothed[sigma_m] = mean_of_known(self.up, sigma_m / self.cell_m, LEAST_KNOWN)
        return self.smoothed[sigma_m]

    def surface(self, sigma_m: float, *, relief: bool) -> _Surface:
        """Heights smoothed by a Gaussian, or only their relief; computed once."""
        key = sigma_m, relief
        if key not in self._surfaces:
            heights = self.smooth(sigma_m)
            shape = heights - self.smooth(RELIEF_WAVE_M) if relief else heights
            south, east = np.gradient(shape)
            slopes = (-south / self.cell_m, east / self.cell_m)
            points = self.points(heights, max(1, round(sigma_m / self.cell_m)))
            self._surfaces[key] = _Surface(shape, slopes, points)
        return self._surfaces[key]

    def at(self, raster: Raster, places: ObjectPoints) -> PerPoint:
        """Values of a raster on this grid at positions of the level frame, NaN where unknown."""
        half, size = self.up.shape[0] / 2 - 0.5, -(-len(places) // ROW) * ROW
        col = np.resize(places[:, 1] / self.cell_m + half, size).astype(np.float32)
        row = np.resize(half - places[:, 0] / self.cell_m, size).astype(np.float32)
        value = cv2.remap(
            raster, col.reshape(-1, ROW), row.reshape(-1, ROW), cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"),
        )  # fmt: skip
        return value.ravel()[: len(places)].astype(np.float64)

    def points(self, heights: Raster, step: int) -> ObjectPoints:
        """Positions of known heights, of every n-th row and column."""
        row, col = np.nonzero(np.isfinite(heights[::step, ::step]))
        row, col, half = step * row, step * col, heights.shape[0] / 2 - 0.5
        north, east = (half - row) * self.cell_m, (col - half) * self.cell_m
        return np.column_stack([north, east, -heights[row, col].astype(np.float64)])


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """The ground of a stop smoothed by a Gaussian: its heights, or only their relief."""

    shape: Raster
    slopes: tuple[Raster, Raster]
    """Its derivatives by north and east."""
    points: ObjectPoints
    """Points of its heights, one Gaussian's standard deviation apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Cells of the later stop's ground compared with the earlier one's, n of them."""

    places: ObjectPoints
    """Positions in the level frame of the earlier stop, metres."""
    arms: ObjectPoints
    """Vectors from the later rover to the places, in the same axes."""
    residual_m: PerPoint
    """r, with the ground of both stops corrected for the height bias."""
    by_shift: ObjectPoints
    """Its derivative by a shift of the later stop's ground,"""
    by_line: PerPoint
    """and by the height bias in lines, metres."""
    weight: PerPoint
    steepness: float
    """Mean slope of the robust residual over its mean weight."""

    @property
    def design(self) -> Float64[np.ndarray, "n 7"]:
        """Derivative of the residuals by a motion of the later stop about its origin, and by b."""
        turned = np.cross(self.arms, self.by_shift)
        return np.column_stack([turned, self.by_shift, self.by_line])


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Pose of the later stop by surface registration."""

    pose: Pose
    """Later level frame to earlier one."""
    covariance: Float64[np.ndarray, "6 6"]
    """Covariance of rotation vector (radians), then translation (metres), in the earlier level
    frame."""
    correlation: float
    """Correlation of the common relief."""
    area_m2: float
    """Area of the common ground."""
    cells: Cells
    """Cells at which the motion was found, with weights that allow for their common errors."""
    height_bias: HeightBias
    """Height bias of both stops in lines; estimated where heights are compared."""


@dataclass(frozen=True, slots=True, eq=False)
class _Surfaces:
    """The surfaces of two stops smoothed by one Gaussian: heights, or only relief."""

    earlier: HeightGrid
    later: HeightGrid
    there: Raster
    """Surface of the earlier stop."""
    slopes: tuple[Raster, Raster]
    """Its derivatives by north and east."""
    points: ObjectPoints
    """Points of the later stop, in its level frame."""
    relief: PerPoint | None
    """Mean heights of the later stop; None: heights are compared."""
    too_high_m: tuple[Raster, Raster] | None
    """Height bias of both for every line of b; None where relief is compared."""
    sigma_m: float
    """Standard deviation of the Gaussian."""
    params: SurfaceParams

    @classmethod
    def of(
        cls, earlier: HeightGrid, later: HeightGrid, sigma_m: float, relief: bool,  # noqa: FBT001
        params: SurfaceParams,
    ) -> _Surfaces:  # fmt: skip
        """Smooth both."""
        there, here = (grid.surface(sigma_m, relief=relief) for grid in (earlier, later))
        rest = later.at(here.shape, here.points) if relief else None
        too_high = None if relief else (earlier.too_high_m(sigma_m), later.too_high_m(sigma_m))
        return cls(
            earlier, later, there.shape, there.slopes, here.points, rest, too_high, sigma_m, params
        )

    def compare(self, pose: Pose, lines: float = 0.0) -> Cells:
        """The later stop's ground, transformed by a pose, compared with the earlier one's.

        Both are corrected for a height bias of this many lines.
        """
        places = pose.apply(self.points)
        slopes = [self.earlier.at(raster, places) for raster in self.slopes]
        residual = self._residuals(pose, places)
        good = np.isfinite(residual + slopes[0] + slopes[1]) & _alike(places, self.points)
        places, residual = places[good], residual[good]
        far, near = (np.hypot(*some[:, :2].T) for some in (places, self.points[good]))
        lowered, raised, down = np.zeros((3, len(places)))
        if self.too_high_m is not None:
            raised = self.earlier.at(self.too_high_m[0], places)
            lowered = self.later.at(self.too_high_m[1], self.points[good])
            down = np.ones(len(places))
        by_shift = np.column_stack([slopes[0][good], slopes[1][good], down])
        arms, by_line = places - pose.translation_m, lowered - raised
        places[:, 2] += lines * lowered
        residual = residual + lines * by_line
        sigma_px = self.params.sigma_parallax_px
        noise = (
            np.hypot(self.earlier.noise_m(far, sigma_px), self.later.noise_m(near, sigma_px)) + 1e-3
        )
        spread = max(robust_sigma(residual / noise), 0.1) * noise
        off = np.minimum((residual / (KERNEL * spread)) ** 2, 1.0)
        kept, bent = (1 - off) ** 2, (1 - off) * (1 - 5 * off)
        weight = kept / (FOOTPRINT * spread**2)
        steepness = float(bent.sum() / max(kept.sum(), 1e-9))
        return Cells(places, arms, residual, by_shift, by_line, weight, steepness)

    def _residuals(self, pose: Pose, places: ObjectPoints) -> PerPoint:
        """Height of the earlier stop's ground above the later one's."""
        if self.relief is not None:
            return self.earlier.at(self.there, places) - self.relief
        shared = self.later.at(self._differences(pose), self.points)
        if np.isfinite(shared).sum() >= LEAST_CELLS:
            return shared
        return self.earlier.at(self.there, places) + places[:, 2]  # far cells seldom coincide

    def _differences(self, pose: Pose) -> Raster:
        """Heights of the earlier stop minus those of the later one, on the grid of the latter.

        Smoothed where both are known. Smoothed separately, ground hidden behind a crest at one stop
        would get the height of the crest, and the stops would move apart.
        """
        earlier, cells = self.earlier, self.later.cells
        places = pose.apply(cells)
        share = earlier.at(earlier.known, places)
        with np.errstate(invalid="ignore", divide="ignore"):
            off = earlier.at(earlier.filled, places) / share + places[:, 2]
            off[~(_alike(places, cells) & (share > MOSTLY))] = np.nan
        raster = np.full(self.later.up.shape, np.nan, np.float32)
        raster[self.later.known > 0] = off
        return mean_of_known(raster, self.sigma_m / self.later.cell_m, LEAST_SHARED)

    def correlation(self, pose: Pose) -> float:
        """Correlation of the relief that both stops see."""
        places = pose.apply(self.points)
        both = np.column_stack([self.earlier.at(self.there, places), np.asarray(self.relief)])
        both = both[np.isfinite(both).all(axis=1)]
        is_determined = len(both) > MOTION and bool((both.std(axis=0) > 0).all())
        return float(np.corrcoef(both.T)[0, 1]) if is_determined else 0.0


def _alike(from_one: ObjectPoints, from_other: ObjectPoints) -> Flags:
    """Whether two stops see positions from similar distances."""
    far, near = np.hypot(*from_one[:, :2].T), np.hypot(*from_other[:, :2].T)
    return (far < RANGE_RATIO * near + 1) & (near < RANGE_RATIO * far + 1)


def register(
    earlier: HeightGrid,
    later: HeightGrid,
    start: Pose,
    prior: Float64[np.ndarray, "6 6"],
    params: SurfaceParams,
    steps: tuple[tuple[bool, float], ...] = (*RELIEF, *HEIGHTS),
) -> Registration | None:
    """Register the later stop's ground to the earlier one's; None where they share too little.

    `start` is later level frame to earlier one, `prior` its covariance, of rotation vector, then
    translation.
    """
    known, moved, pose, correlation = np.eye(MOTION + 1), np.zeros(MOTION + 1), start, np.nan
    known[:MOTION, :MOTION], known[MOTION, MOTION] = np.linalg.inv(prior), params.bias_line_px**-2
    for relief, sigma_m in steps:
        surfaces = _Surfaces.of(earlier, later, sigma_m, relief, params)
        if not relief and not moved[5]:
            pose = _levelled(pose, surfaces)
        for _ in range(params.rounds):
            cells = surfaces.compare(pose, moved[MOTION])
            if len(cells.weight) < LEAST_CELLS:
                return None
            design = cells.design
            weighted = (design * cells.weight[:, None]).T
            normal = weighted @ design + known
            step = -np.linalg.solve(normal, weighted @ cells.residual_m + known @ moved)
            moved, pose = moved + step, _move(pose, step[:MOTION])
            if np.abs(step[3:MOTION]).max() < SETTLED_M:
                break
        if relief:
            correlation, moved[5] = surfaces.correlation(pose), 0.0
    cells = surfaces.compare(pose, moved[MOTION])
    if len(cells.weight) < LEAST_CELLS:
        return None
    covariance, cells = _covariance(cells, known, earlier, later, params)
    area_m2 = len(cells.weight) * max(sigma_m, earlier.cell_m) ** 2
    bias = HeightBias(float(moved[MOTION]), float(covariance[MOTION, MOTION] ** 0.5))
    return Registration(pose, covariance[:MOTION, :MOTION], correlation, area_m2, cells, bias)


def _levelled(pose: Pose, surfaces: _Surfaces) -> Pose:
    """Shifted vertically to the earlier stop's ground: relief does not determine the height."""
    residual = surfaces.compare(pose).residual_m
    down = float(np.median(residual)) if len(residual) else 0.0
    return _move(pose, np.array([0, 0, 0, 0, 0, -down]))


def _move(pose: Pose, change: Float64[np.ndarray, " 6"]) -> Pose:
    """A pose rotated by a rotation vector about the source's origin and then shifted."""
    turn = ScipyRotation.from_rotvec(change[:3])
    rotation = (turn * ScipyRotation.from_matrix(pose.rotation)).as_matrix()
    return Pose(pose.target, pose.source, rotation, pose.translation_m + change[3:])


def _covariance(
    cells: Cells,
    known: Float64[np.ndarray, "7 7"],
    earlier: HeightGrid,
    later: HeightGrid,
    params: SurfaceParams,
) -> tuple[Float64[np.ndarray, "7 7"], Cells]:
    """(covariance of motion and lines, cells with weights that include their correlation)."""
    design = cells.design
    score = design * (cells.weight * cells.residual_m)[:, None]
    square = np.floor(cells.places[:, :2] / CLUSTER_M).astype(np.int64) @ (10_000, 1)
    block = np.unique(square, return_inverse=True)[1].ravel()
    blocks = np.zeros((int(block.max()) + 1, MOTION + 1))
    np.add.at(blocks, block, score)
    weighted = (design * cells.weight[:, None]).T
    normal, squares = cells.steepness * weighted @ design, blocks.T @ blocks
    inverse = np.linalg.inv(normal + known)
    covariance = inverse @ (squares + known) @ inverse
    along = along_rays(cells.arms, later, params) - along_rays(cells.places, earlier, params)
    off = inverse @ (weighted @ (along * cells.by_shift).sum(axis=1)) * cells.steepness
    shared_motions = _shared_motions(cells, params) * _sun_difference(earlier.sun, later.sun)
    covariance = covariance + np.outer(off, off) + shared_motions @ shared_motions.T
    shared = float(np.trace(inverse @ squares)) / (MOTION + 1) / cells.steepness
    return covariance, replace(cells, weight=cells.weight / max(shared, 1.0))


def _shared_motions(cells: Cells, params: SurfaceParams) -> Float64[np.ndarray, "7 3"]:
    """Motions of all common ground alike, each of one standard deviation under opposite suns.

    Columns: shift north, shift east, rotation about the vertical through the middle of the ground.
    Rows: the unknowns, rotation vector (radians), shift (metres), height bias (lines).
    """
    arm = np.average(cells.arms, axis=0, weights=cells.weight)
    motions, up = np.zeros((MOTION + 1, 3)), np.array([0.0, 0.0, params.shared_turn])
    motions[3, 0] = motions[4, 1] = params.shared_shift_m
    motions[:3, 2], motions[3:MOTION, 2] = up, -np.cross(up, arm)
    return motions


def _sun_difference(one: Vector3 | None, other: Vector3 | None) -> float:
    """Half the length of the difference of unit vectors towards two suns; 1 if one is unknown."""
    return 1.0 if one is None or other is None else float(np.linalg.norm(one - other)) / 2


def along_rays(rays: ObjectPoints, grid: HeightGrid, params: SurfaceParams) -> ObjectPoints:
    """Displacement along a rover's rays of ground positions by the bias of parallax."""
    from_mast = grid.from_mast(rays)
    distance_m = np.linalg.norm(from_mast, axis=1)
    return params.bias_parallax_px / grid.scale_px_m * distance_m[:, None] * from_mast
