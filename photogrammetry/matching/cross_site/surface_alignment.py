"""Least-squares matching of the ground of two stops: its heights and its brightness.

The dense parallax of a stop gives the ground around it on a level grid (`ground_grid`). A point Y
of the later stop's ground, transformed by R Y + t to the level frame of the earlier one, lies above
the ground there by

    r = z(R Y + t) - h(n, e),        dr = (dz - grad h . (dn, de)),

and differs from it in the detail of its brightness by

    r = i(n, e) - i'(Y),             dr = grad i . (dn, de).

The motion that makes both vanish is found by least squares (Gruen and Akca 2005, ISPRS J. 59,
151-174; Chen and Medioni 1992), with Tukey's biweight, from coarse to fine: heights with Gaussians
of half a metre first, of 10 cm at last; then with the brightness, whose texture is finer than
relief, if it is alike at the position found and not around it: where shading outweighs albedo,
opposite suns make it unlike. Smoothing on the ground is the same for both stops. Windows in the
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

Slopes are measured at both stops, g and g', with independent errors e and e'. The residuals are
weighted with the mean (g + g') / 2. Its square contains the variance of e and e', as if rough
errors determined a shift; the product g g' does not, so the normal matrix is

    sum w g g' = sum w ((g + g') / 2)^2 - sum w ((g - g') / 2)^2,

limited below to a tenth of its first term (errors in variables; Fuller 1987, section 1.1). With the
first term alone, iteration takes several times as many rounds, and sigmas are too small.

Ground seen at a grazing angle is measured too high (`height_bias`). Between two stops on either
side this causes a tilt of 0.05 to 0.1 degrees, and, because each stop sees its own side of the
relief at larger angles, a few centimetres of distance. The bias in lines b, the same for both
stops, is a seventh unknown, which can be separated from a tilt and from a shift:

    r + b (l_later - l_earlier) = 0,        b = 0.50 +- 0.29 lines

A tilt and a shift along the way resemble it, so that its prior counts: with b = 0 +- 1 stops of
eight path-traced worlds were 0.5 cm too close and tilted by 0.03 degrees in the mean.

Hidden ground is too high; what is seen is not, and its brightness lies where it is seen.

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

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import (
    Flags,
    Float64,
    ObjectPoints,
    PerPoint,
    Raster,
)
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.ground_grid import GroundGrid, Surface, blocks_of
from solmap.photogrammetry.matching.cross_site.kernels import height_differences
from solmap.photogrammetry.matching.cross_site.light import sun_difference
from solmap.photogrammetry.matching.cross_site.tie_weights import SHARED_PARALLAX_PX
from solmap.photogrammetry.matching.height_bias import HeightBias, mean_of_known
from solmap.photogrammetry.ranges import (
    CellSize,
    Few,
    Metres,
    MetresOrZero,
    Pixels,
    Radians,
)
from solmap.photogrammetry.robust import robust_sigma

MOTION = 6
"""Unknowns of a rigid motion: rotation vector, shift."""

LINES, PARALLAX = 6, 7
"""Unknowns that both stops share: height bias in lines, and bias of parallax in pixels."""

UNKNOWNS = 8

RELIEF = ((True, 0.4), (True, 0.2))
HEIGHTS = ((False, 0.2), (False, 0.1))
"""(whether only relief is compared, standard deviation of the Gaussian in metres)."""

FOOTPRINT = 4 * np.pi
"""Number of cells, one Gaussian's standard deviation apart, with the information of one;"""

DETAIL_FOOTPRINT = np.pi
"""of cells two apart."""

LEAST_CELLS = 200
"""Fewest cells of common ground: some square metres."""

SETTLED = np.array([5e-4, 5e-4, 5e-4, 0.02, 1e-3])
"""Largest last step of shift (metres), of height bias (lines) and of parallax bias (pixels)."""

LEAST_SHARED = 0.3
"""Fraction of a Gaussian's weight on cells known at both stops."""

MOSTLY = 0.5
"""Fraction of the interpolation weight of four cells on known ones."""

RANGE_RATIO = 2.5
"""Largest ratio of ranges of ground at both stops; beyond it they see different faces."""

KERNEL, BRIGHTNESS_KERNEL = 2.0, 3.0
"""Standard deviations beyond which heights, and brightness, have no weight."""

LEAST_ALIKE, DISTINCT = 0.2, 1.2
"""Least correlation of detail by which brightness is used, and its least ratio to those nearby."""

NEARBY_M = 0.2
"""Distance of the positions around at which detail is correlated too. Under like suns and on albedo
it correlates by 0.23 to 0.43, 1.5 to 2.2 times as much as around; between stops of two rendered
worlds whose shading opposite suns reverse by 0.06 to 0.16, and less than around."""

LEAST_SIGNAL = 0.1
"""Least fraction of the squares of slopes that is not due to their errors."""

CLUSTER_M = 4.0
"""Side of a block of ground whose cells are treated as correlated."""


@dataclass(frozen=True, slots=True)
class SurfaceParams:
    """How surfaces are compared."""

    cell_m: CellSize = 0.05
    """Side of a cell."""
    farthest_m: Metres = 25.0
    """Farthest ground: beyond it Navcam lines are more than 30 cm apart on level ground."""
    sigma_parallax_px: Pixels = 0.1
    """Standard deviation of dense parallax."""
    shared_shift_m: MetresOrZero = 0.006
    """Standard deviation, per axis, of the horizontal displacement of all common ground under suns
    in opposite directions."""
    shared_turn: Radians = 0.0009
    """Standard deviation of the rotation of all common ground about the vertical, under the same
    suns."""
    rounds: Few = 12
    """Most rounds for each Gaussian while hypotheses are compared."""

    def __post_init__(self) -> None:
        if not (self.rounds > 0 and self.farthest_m > self.cell_m):
            raise MatchingError("surfaces need at least one round, and cells below their size")


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """n cells of the later stop's ground compared with the earlier one's."""

    places: ObjectPoints
    """Positions in the level frame of the earlier stop, metres."""
    arms: ObjectPoints
    """Vectors from the later rover to the places, in the same axes."""
    residual: PerPoint
    """r, metres or units of detail, with the ground of both stops corrected for the height bias."""
    by_shift: ObjectPoints
    """Its derivative by a shift of the later stop's ground, mean of both stops,"""
    disagreement: ObjectPoints
    """and half their difference."""
    by_line: PerPoint
    """Its derivative by the height bias in lines."""
    drift: ObjectPoints
    """Shift of the later stop's ground against the earlier one's by a bias of parallax, m/px; 0
    where it is not an unknown."""
    weight: PerPoint
    steepness: float = 1.0
    """Mean slope of the robust residual over its mean weight."""

    @property
    def design(self) -> Float64[np.ndarray, "n 8"]:
        """Derivative of the residuals by the unknowns, the motion being about the later stop."""
        return self._columns(self.by_shift, self.by_line)

    def normal(self) -> Float64[np.ndarray, "8 8"]:
        """Weighted squares of the design without the errors of slopes."""
        return without_noise(*((d * self.weight[:, None]).T @ d for d in (self.design, self.noise)))

    @property
    def noise(self) -> Float64[np.ndarray, "n 8"]:
        """Half the difference of the derivatives between both stops."""
        return self._columns(self.disagreement, np.zeros(len(self.weight)))

    def scores_of(self, shift: ObjectPoints) -> Float64[np.ndarray, " 8"]:
        """Weighted sum of the residuals by shifts of the ground, without the errors of slopes."""
        true, wrong = (
            rows.T @ (self.weight * (shift * slopes).sum(axis=1))
            for rows, slopes in ((self.design, self.by_shift), (self.noise, self.disagreement))
        )
        return true - wrong

    def _columns(self, by_shift: ObjectPoints, by_line: PerPoint) -> Float64[np.ndarray, "n 8"]:
        turned, drift = np.cross(self.arms, by_shift), (self.drift * by_shift).sum(axis=1)
        return np.column_stack([turned, by_shift, by_line, drift])

    def weighted(self, noise: PerPoint, kernel: float, footprint: float) -> Cells:
        """With the weights of Tukey's biweight, for standard deviations proportional to `noise`.

        Residuals beyond `kernel` of them have no weight; `footprint` cells have the information of
        one.
        """
        spread = max(robust_sigma(self.residual / noise), 0.1) * noise
        off = np.minimum((self.residual / (kernel * spread)) ** 2, 1.0)
        kept, bent = (1 - off) ** 2, (1 - off) * (1 - 5 * off)
        steepness = float(bent.sum() / max(kept.sum(), 1e-9))
        return replace(self, weight=kept / (footprint * spread**2), steepness=steepness)


def without_noise(
    squares: Float64[np.ndarray, "*n k k"], noise: Float64[np.ndarray, "*n k k"]
) -> Float64[np.ndarray, "*n k k"]:
    """The difference of matrices, at least a tenth of the first in every direction."""
    size = np.sqrt(np.maximum(np.diagonal(squares, axis1=-2, axis2=-1), 1e-12))
    scale = size[..., :, None] * size[..., None, :]
    root = np.linalg.cholesky(squares / scale + 1e-10 * np.eye(squares.shape[-1]))
    inverse = np.linalg.inv(root)
    share, axes = np.linalg.eigh(inverse @ (noise / scale) @ inverse.mT)
    half = root @ (axes * np.sqrt(np.maximum(1 - share, LEAST_SIGNAL))[..., None, :])
    return half @ half.mT * scale


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
    """Cells whose heights were compared."""
    height_bias: HeightBias
    """Height bias of both stops in lines; estimated where heights are compared,"""
    expected_bias: HeightBias
    """and its prior: the mean of both stops'."""


@dataclass(frozen=True, slots=True, eq=False)
class _Heights:
    """Heights of two stops smoothed by one Gaussian, or only their relief."""

    earlier: GroundGrid
    later: GroundGrid
    there: Surface
    here: Surface
    too_high_m: tuple[Raster, Raster] | None
    """Height bias of both for every line of b; None where relief is compared."""
    sigma_m: float
    """Standard deviation of the Gaussian."""
    params: SurfaceParams

    @classmethod
    def of(
        cls, earlier: GroundGrid, later: GroundGrid, sigma_m: float, relief: bool,  # noqa: FBT001
        params: SurfaceParams,
    ) -> _Heights:  # fmt: skip
        """Smooth both."""
        there, here = (grid.surface(sigma_m, relief=relief) for grid in (earlier, later))
        too_high = None if relief else (earlier.too_high_m(sigma_m), later.too_high_m(sigma_m))
        return cls(earlier, later, there, here, too_high, sigma_m, params)

    def compare(self, pose: Pose, shared: tuple[float, float] = (0.0, 0.0)) -> Cells:
        """The later stop's ground, transformed by a pose, compared with the earlier one's.

        Corrected for the first of the shared unknowns.
        """
        points, places = self.here.points, pose.apply(self.here.points)
        there, here = _slopes(self.earlier, self.there, self.here, places, pose)
        residual = self._residuals(pose, places)
        good = np.isfinite(residual + there.sum(axis=1) + here.sum(axis=1))
        good &= _alike(places, points)
        points, places, residual = points[good], places[good], residual[good]
        lowered, raised, down = np.zeros((3, len(places)))
        if self.too_high_m is not None:
            raised = self.earlier.at(self.too_high_m[0], places)
            lowered = self.later.at(self.too_high_m[1], points)
            down = np.ones(len(places))
        by_line, lines = lowered - raised, shared[0]
        sigma_px = self.params.sigma_parallax_px
        noise = np.hypot(
            self.earlier.noise_m(np.hypot(*places[:, :2].T), sigma_px),
            self.later.noise_m(np.hypot(*points[:, :2].T), sigma_px),
        )
        places[:, 2] += lines * lowered
        return Cells(
            places,
            places - pose.translation_m,
            residual + lines * by_line,
            np.column_stack([(there + here)[good] / 2, down]),
            np.column_stack([(there - here)[good] / 2, 0 * down]),
            by_line,
            np.zeros_like(places),
            np.ones(len(places)),
        ).weighted(noise + 1e-3, KERNEL, FOOTPRINT)

    def _residuals(self, pose: Pose, places: ObjectPoints) -> PerPoint:
        """Height of the earlier stop's ground above the later one's."""
        if self.too_high_m is None:
            return self.earlier.at(self.there.shape, places) - self.here.values
        shared = self.later.at(self._differences(pose), self.here.points)
        if np.isfinite(shared).sum() >= LEAST_CELLS:
            return shared
        # far cells seldom coincide
        return self.earlier.at(self.there.shape, places) + places[:, 2]

    def _differences(self, pose: Pose) -> Raster:
        """Heights of the earlier stop minus those of the later one, on the grid of the latter.

        Smoothed where both are known. Smoothed separately, ground hidden behind a crest at one stop
        would get the height of the crest, and the stops would move apart.
        """
        raster = height_differences(
            self.earlier.up, self.later.up, pose.rotation, pose.translation_m,
            (self.later.cell_m, MOSTLY, RANGE_RATIO),
        )  # fmt: skip
        return mean_of_known(raster, self.sigma_m / self.later.cell_m, LEAST_SHARED)

    def correlation(self, pose: Pose) -> float:
        """Correlation of the relief that both stops see."""
        there = self.earlier.at(self.there.shape, pose.apply(self.here.points))
        return _correlation(there, self.here.values)


@dataclass(frozen=True, slots=True, eq=False)
class _Brightness:
    """Detail of the brightness of the ground of two stops."""

    earlier: GroundGrid
    later: GroundGrid
    there: Surface
    here: Surface

    @classmethod
    def of(cls, earlier: GroundGrid, later: GroundGrid, sigma_m: float) -> _Brightness:
        """At heights smoothed by a Gaussian."""
        there, here = (grid.brightness_surface(sigma_m) for grid in (earlier, later))
        return cls(earlier, later, there, here)

    def correlations(self, pose: Pose) -> tuple[float, float]:
        """Correlation of detail at a pose, and the highest around it."""
        angles = np.arange(0, 2 * np.pi, np.pi / 4)
        around = NEARBY_M * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
        limit, values = BRIGHTNESS_KERNEL, self.here.values
        here, *others = (
            _correlation(*(np.clip(some, -limit, limit) for some in (there, values)))
            for there in (
                self.earlier.at(self.there.shape, pose.apply(self.here.points) + step_m)
                for step_m in (np.zeros(3), *around)
            )
        )
        return here, max(others)

    def is_alike(self, pose: Pose) -> bool:
        """Whether detail correlates at a pose, and better than around it."""
        here, around = self.correlations(pose)
        return here > max(LEAST_ALIKE, DISTINCT * around)

    def compare(self, pose: Pose, shared: tuple[float, float]) -> Cells:
        """The later stop's ground, transformed by a pose, compared with the earlier one's.

        Corrected for the second of the shared unknowns. What is seen lies where it is seen: hidden
        ground alone is too high.
        """
        places = pose.apply(self.here.points)
        drift = _drift(self.earlier, self.later, pose, places)
        seen = places + shared[1] * drift
        there, here = _slopes(self.earlier, self.there, self.here, seen, pose)
        residual = self.earlier.at(self.there.shape, seen) - self.here.values
        good = np.isfinite(residual + there.sum(axis=1) + here.sum(axis=1))
        good &= _alike(places, self.here.points)
        level = np.zeros(int(good.sum()))
        return Cells(
            places[good],
            places[good] - pose.translation_m,
            residual[good],
            np.column_stack([(there + here)[good] / 2, level]),
            np.column_stack([(there - here)[good] / 2, level]),
            level,
            drift[good],
            level + 1,
        ).weighted(level + 1, BRIGHTNESS_KERNEL, DETAIL_FOOTPRINT)


def _correlation(there: PerPoint, here: PerPoint) -> float:
    """Correlation of known values; 0 if there are too few, or all alike."""
    both = np.column_stack([there, here])
    both = both[np.isfinite(both).all(axis=1)]
    is_determined = len(both) > MOTION and bool((both.std(axis=0) > 0).all())
    return float(np.corrcoef(both.T)[0, 1]) if is_determined else 0.0


def _drift(
    earlier: GroundGrid, later: GroundGrid, pose: Pose, places: ObjectPoints
) -> ObjectPoints:
    """Shift of the later stop's ground against the earlier one's by a bias of parallax, m/px."""
    return later.along_rays(places - pose.translation_m) - earlier.along_rays(places)


def _slopes(
    earlier: GroundGrid, there: Surface, here: Surface, places: ObjectPoints, pose: Pose
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]]:
    """Slopes at points of the later stop, by the earlier stop and by the later one."""
    return earlier.both_at(there.slopes, places), here.point_slopes @ pose.rotation[:2, :2].T


def _alike(from_one: ObjectPoints, from_other: ObjectPoints) -> Flags:
    """Whether two stops see positions from similar distances."""
    far, near = np.hypot(*from_one[:, :2].T), np.hypot(*from_other[:, :2].T)
    return (far < RANGE_RATIO * near + 1) & (near < RANGE_RATIO * far + 1)


def register(
    earlier: GroundGrid,
    later: GroundGrid,
    start: Pose,
    prior: Float64[np.ndarray, "6 6"],
    params: SurfaceParams,
    steps: tuple[tuple[bool, float], ...] = (*RELIEF, *HEIGHTS),
) -> Registration | None:
    """Register the later stop's ground to the earlier one's; None where they share too little.

    `start` is later level frame to earlier one, `prior` its covariance, of rotation vector
    (radians), then translation (metres).
    """
    usual = HeightBias.mean([earlier.expected_bias, later.expected_bias])
    known, expected = np.eye(UNKNOWNS), np.zeros(UNKNOWNS)
    known[:MOTION, :MOTION] = np.linalg.inv(prior)
    known[LINES, LINES], expected[LINES] = usual.sigma**-2, usual.lines
    known[PARALLAX, PARALLAX] = SHARED_PARALLAX_PX**-2
    moved, pose, correlation = np.zeros(UNKNOWNS), start, np.nan
    for relief, sigma_m in steps:
        heights = _Heights.of(earlier, later, sigma_m, relief, params)
        if not relief and not moved[5]:
            pose = _levelled(pose, heights)
        found = _iterate([heights], (pose, moved), (expected, known), params.rounds)
        if found is None:
            return None
        pose, moved, cells = found
        if relief:
            correlation, moved[5] = heights.correlation(pose), 0.0
    if not relief:
        brightness = _Brightness.of(earlier, later, sigma_m)
        found = _iterate([heights, brightness], (pose, moved), (expected, known), params.rounds)
        if found is not None and brightness.is_alike(found[0]):
            pose, moved, cells = found
    drift = SHARED_PARALLAX_PX * _drift(earlier, later, pose, cells[0].places)
    sun = sun_difference(earlier.sun, later.sun)
    shared_motions = _shared_motions(cells[0], params) * sun
    covariance = _covariance(cells, known, drift, shared_motions)
    area_m2 = len(cells[0].weight) * max(sigma_m, earlier.cell_m) ** 2
    bias = HeightBias(float(moved[LINES]), float(covariance[LINES, LINES] ** 0.5))
    of_pose = covariance[:MOTION, :MOTION]
    return Registration(pose, of_pose, correlation, area_m2, cells[0], bias, usual)


def _iterate(
    compared: Sequence[_Heights | _Brightness],
    start: tuple[Pose, Float64[np.ndarray, " 8"]],
    prior: tuple[Float64[np.ndarray, " 8"], Float64[np.ndarray, "8 8"]],
    rounds: int,
) -> tuple[Pose, Float64[np.ndarray, " 8"], tuple[Cells, ...]] | None:
    """(pose, unknowns, cells) of least squares; None where too little is common.

    `prior` has the expected unknowns and the inverse of their covariance. Each step against the one
    before halves the fraction of a step that is made, each along it doubles it: where few cells are
    compared, those within the kernel change from round to round, and full steps would oscillate.
    """
    (pose, moved), (expected, known) = start, prior
    last, fraction = np.zeros(len(SETTLED)), 1.0
    for _ in range(rounds):
        cells = _compare(compared, pose, moved)
        if cells is None:
            return None
        normal, right = known.copy(), known @ (moved - expected)
        for some in cells:
            normal += some.normal()
            right += some.design.T @ (some.weight * some.residual)
        step = -np.linalg.solve(normal, right)
        now = step[3:] / SETTLED
        fraction = fraction / 2 if now @ last < 0 else min(1.0, 2 * fraction)
        step, last = fraction * step, now
        moved, pose = moved + step, _move(pose, step[:MOTION])
        if (np.abs(fraction * now) < 1).all():
            break
    cells = _compare(compared, pose, moved)
    return None if cells is None else (pose, moved, cells)


def _compare(
    compared: Sequence[_Heights | _Brightness], pose: Pose, moved: Float64[np.ndarray, " 8"]
) -> tuple[Cells, ...] | None:
    """The cells of all comparisons with enough of them; None if the first has too few."""
    shared = float(moved[LINES]), float(moved[PARALLAX])
    cells = [some.compare(pose, shared) for some in compared]
    if len(cells[0].weight) < LEAST_CELLS:
        return None
    return tuple(some for some in cells if len(some.weight) >= LEAST_CELLS)


def _levelled(pose: Pose, heights: _Heights) -> Pose:
    """Shifted vertically to the earlier stop's ground: relief does not determine the height."""
    residual = heights.compare(pose).residual
    down = float(np.median(residual)) if len(residual) else 0.0
    return _move(pose, np.array([0, 0, 0, 0, 0, -down]))


def _move(pose: Pose, change: Float64[np.ndarray, " 6"]) -> Pose:
    """A pose rotated by a rotation vector about the source's origin and then shifted."""
    turn = ScipyRotation.from_rotvec(change[:3])
    rotation = (turn * ScipyRotation.from_matrix(pose.rotation)).as_matrix()
    return Pose(pose.target, pose.source, rotation, pose.translation_m + change[3:])


def _covariance(
    cells: tuple[Cells, ...],
    known: Float64[np.ndarray, "8 8"],
    drift: ObjectPoints,
    shared_motions: Float64[np.ndarray, "8 m"],
) -> Float64[np.ndarray, "8 8"]:
    """Covariance of all unknowns.

    Common to all cells are the drift of those of heights, and motions of all ground.
    """
    block = blocks_of(np.vstack([some.places for some in cells]), CLUSTER_M)
    blocks, normal = np.zeros((int(block.max()) + 1, UNKNOWNS)), known.copy()
    for some, own in zip(cells, _split(block, cells), strict=True):
        np.add.at(blocks, own, some.design * (some.weight * some.residual)[:, None])
        normal += some.steepness * some.normal()
    inverse = np.linalg.inv(normal)
    off = cells[0].steepness * inverse @ cells[0].scores_of(drift)
    common = np.column_stack([off, shared_motions])
    return inverse @ (blocks.T @ blocks + known) @ inverse + common @ common.T


def _split(values: np.ndarray, cells: tuple[Cells, ...]) -> list[np.ndarray]:
    """Values of all cells together, by kind."""
    return np.split(values, np.cumsum([len(some.weight) for some in cells])[:-1])


def _shared_motions(cells: Cells, params: SurfaceParams) -> Float64[np.ndarray, "8 3"]:
    """Motions of all common ground alike, each of one standard deviation under opposite suns.

    Columns: shift north, shift east, rotation about the vertical through the middle of the ground.
    Rows: the unknowns.
    """
    arm = np.average(cells.arms, axis=0, weights=cells.weight)
    motions, up = np.zeros((UNKNOWNS, 3)), np.array([0.0, 0.0, params.shared_turn])
    motions[3, 0] = motions[4, 1] = params.shared_shift_m
    motions[:3, 2], motions[3:MOTION, 2] = up, -np.cross(up, arm)
    return motions
