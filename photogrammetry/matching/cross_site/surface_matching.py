"""Surface-matched cross-site ties: the registration of two stops as observations.

The registration of two stops' surfaces (`surface_alignment`) gives the pose of the later stop with
a covariance C. An adjustment that also estimates the pointing of every pair needs it as image
coordinates: the middle of a block of ground becomes a tie, a point of the earlier stop's ground,
exact by definition, and its image at the later stop under the registered pose.

With the derivatives a_i of their 3n coordinates by the pose, ties of variances s_i^2 determine it
with the covariance (sum a_i a_i' / s_i^2)^-1. Adjustments treat coordinates as independent, so the
variances are chosen such that these together determine each of them as well as C does:

    a_i' (sum a_j a_j' / s_j^2)^-1 a_i = a_i' C a_i

by repeated multiplication of s_i^2 with the ratio of the right side to the left (the multiplicative
algorithm of optimal design, Silvey, Titterington and Torsney 1978), from s_i^2 = (3n / 6)
a_i' C a_i, which gives the ties the information of 6 unknowns. What C leaves
uncertain, usually the range between the stops, the ties leave uncertain too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.arrays import Flags, Float64, Int32, ObjectPoints, PerPoint
from solmap.photogrammetry.cameras.epipolar import projection_partials
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.ground_grid import GroundGrid, blocks_of
from solmap.photogrammetry.matching.cross_site.surface_alignment import (
    HEIGHTS,
    MOTION,
    RELIEF,
    Cells,
    Registration,
    SurfaceParams,
    register,
)
from solmap.photogrammetry.matching.records import MatchedPair, MatchedStop, Ties
from solmap.photogrammetry.ranges import Count, Metres

DEFINED_PX = 0.02
"""Standard deviation of the earlier stop's point, which defines the tie and has no error."""

WEIGHT_ROUNDS = 8
"""Repetitions: on ten links of five worlds standard deviations of range, of a shift across, of
azimuth and of tilt along become 0.94 to 1.07 of C's on average (0.6 to 1.5 before the first). Those
of height and of tilt across stay three times C's: 2 mm and 0.01 degrees, less than pointing
leaves."""

LEAST_KNOWN = 1e-6
"""Fraction of C's information added to the ties', for directions that no tie determines."""

MARGIN_PX = 16
"""Points nearer to the border of a pair are left to the neighbouring pair."""

VISIBLE = 0.05
"""Largest relative difference between parallax and prediction: beyond it the point is occluded."""


HYPOTHESIS_SIGMAS = (0.0052, 0.0052, 0.0175, 0.3, 0.3, 0.3)
"""Standard deviations of a hypothesis: tilt by gravity (radians), azimuth, position (metres)."""

RELIEF_M = 0.33
"""Correlation length of relief: an area has N = area / (4 pi r^2) independent samples, and chance
correlation is N^-1/2. This was confirmed in 195 registrations from wrong starts between stops of
four worlds, with 30 square metres and with 800 (RMS 1.0 N^-1/2). Correlations of different areas
are therefore compared in these standard deviations."""

REPEATS = 6
"""How often a hypothesis in doubt is registered again: up to 0.3 m of its way each time."""

ROUNDS_TO_REST = 100
"""Most rounds for each Gaussian of the best hypothesis: with 12, one was still 0.44 m off."""

CERTAIN = 4.0
"""Standard deviations by which relief must correlate, and correlate better than anywhere else;
wrong starts reached 3.3 at most, and a link with 3.6 was 31 cm off, six of its own."""


@dataclass(frozen=True, slots=True)
class SurfaceTieParams:
    """Selection of blocks of ground for ties."""

    enabled: bool = True
    """Whether surfaces are matched."""
    surface: SurfaceParams = field(default_factory=SurfaceParams)
    block_m: Metres = 1.5
    """Side of a block."""
    least_cells: Count = 30
    """Fewest common cells of a block."""
    least: Count = 8
    """Fewest blocks; with fewer there are no surface-matched ties."""
    most: Count = 80
    """Most blocks used as ties, the most certain first."""

    def __post_init__(self) -> None:
        if not (self.block_m > 0 and self.least_cells > 0 and self.most >= self.least > 0):
            raise MatchingError(
                "surface-matched ties need blocks above zero in size, cells and number"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ShapeTrial:
    """A position that relief determines, after registration."""

    found: Registration
    by_chance: float
    """Most significant correlation of relief at other positions, tested in the same way; standard
    deviations of chance."""

    def __str__(self) -> str:
        return (
            f"relief correlates by {self.found.correlation:.2f}, {significance(self.found):.1f} "
            f"sigma, elsewhere by {self.by_chance:.1f}"
        )


def significance(found: Registration) -> float:
    """Correlation of relief in standard deviations of chance correlation."""
    return found.correlation * float(np.sqrt(found.area_m2 / (4 * np.pi * RELIEF_M**2)))


def try_shapes(
    grids: tuple[GroundGrid, GroundGrid],
    starts: Sequence[Pose],
    elsewhere: Sequence[Pose],
    apart_m: float,
    params: SurfaceParams,
    *,
    first_needs: float = CERTAIN / 2,
) -> ShapeTrial | None:
    """Register the later stop's ground to the earlier one's from hypotheses.

    The one with the most significant correlation of relief is returned where that is at least
    `CERTAIN` and exceeds the significance by chance by as much, or by `first_needs` at the position
    of the first hypothesis, a significant peak of the search; None otherwise. By chance are
    hypotheses that end further than `apart_m` from it, and positions without hypothesis. Those that
    cast doubt on it are registered again from where they end, because the slope of its own relief
    correlates too.
    """
    prior = np.diag(np.square(HYPOTHESIS_SIGMAS))

    def laid_at(pose: Pose) -> Registration | None:
        return register(*grids, pose, prior, params, RELIEF)

    laid = [laid_at(pose) for pose in (*starts, *elsewhere)]
    tried = [one for one in laid[: len(starts)] if one is not None]
    if not tried:
        return None
    best = max(tried, key=significance)
    if significance(best) < CERTAIN:
        return None
    doubtful = significance(best) - (first_needs if best is laid[0] else CERTAIN)
    by_chance = 0.0
    for one in laid:
        if one is not None:
            by_chance = max(by_chance, _by_chance(one, best, doubtful, apart_m, laid_at))
        if doubtful <= by_chance:
            return None
    to_rest = replace(params, rounds=ROUNDS_TO_REST)
    found = register(*grids, best.pose, prior, to_rest, HEIGHTS)
    if found is None:
        return None
    found = replace(found, correlation=best.correlation, area_m2=best.area_m2)
    return ShapeTrial(found, by_chance)


def _by_chance(
    rival: Registration,
    best: Registration,
    doubtful: float,
    apart_m: float,
    laid_at: Callable[[Pose], Registration | None],
) -> float:
    """Significance of a rival of the best registration at rest; 0 if that is the same position."""
    for _ in range(REPEATS):
        if _distance_m(rival, best) <= apart_m or significance(rival) < doubtful:
            break
        again = laid_at(rival.pose)
        if again is None:
            break
        rival = again
    return significance(rival) if _distance_m(rival, best) > apart_m else 0.0


def _distance_m(one: Registration, other: Registration) -> float:
    """Distance of two positions of the later stop in plan, metres."""
    return float(np.linalg.norm((one.pose.translation_m - other.pose.translation_m)[:2]))


def find_blocks(cells: Cells, params: SurfaceTieParams) -> ObjectPoints:
    """A point of the earlier stop's ground in the middle of each block, in its level frame.

    The blocks with the largest weights.
    """
    block = blocks_of(cells.places, params.block_m)
    used = np.bincount(block[cells.weight > 0], minlength=block.max() + 1) >= params.least_cells
    certain = np.argsort(-np.bincount(block, cells.weight), kind="stable")
    middle = _middles(cells, block)[certain[used[certain]][: params.most]]
    ground = cells.places[middle]
    ground[:, 2] -= cells.residual[middle]
    return ground


def _middles(cells: Cells, block: np.ndarray) -> Int32[np.ndarray, " blocks"]:
    """The cell nearest to the middle of those of each block."""
    places = cells.places[:, :2]
    count = np.bincount(block)
    middle = np.column_stack([np.bincount(block, axis) / count for axis in places.T])
    order = np.lexsort((np.linalg.norm(places - middle[block], axis=1), block))
    return order[np.unique(block[order], return_index=True)[1]].astype(np.int32)


def tie_by_surface(
    stops: tuple[MatchedStop, MatchedStop],
    found: Registration,
    params: SurfaceTieParams,
) -> Ties:
    """Surface-matched ties between the pairs of two registered stops."""
    places = find_blocks(found.cells, params)
    return tie_by_pose(stops, places, found.pose, found.covariance, params.least)


def tie_by_pose(
    stops: tuple[MatchedStop, MatchedStop],
    places: ObjectPoints,
    pose: Pose,
    covariance: Float64[np.ndarray, "6 6"],
    least: int,
) -> Ties:
    """Ties that determine the pose of the later stop as its covariance does.

    Args:
        stops: The earlier and the later one.
        places: Points of the earlier stop's ground in its level frame, metres.
        pose: Later level frame to earlier one.
        covariance: Of rotation vector (radians), then translation (metres), in the earlier level
            frame.
        least: Fewest places that both stops must see.

    Returns:
        One tie for each place that both stops see; none where these are fewer than `least`.
    """
    pair_ids = tuple(pair.pair_id for stop in stops for pair in stop.pairs)
    rovers = [
        points @ stop.lsl_from_rover.rotation
        for stop, points in zip(stops, (places, pose.inverse.apply(places)), strict=True)
    ]
    seen = [_best_view(stop, points) for stop, points in zip(stops, rovers, strict=True)]
    rows = np.flatnonzero((seen[0].pair >= 0) & (seen[1].pair >= 0))
    if len(rows) < least:
        return Ties.none(pair_ids)
    first, second = (some.select(rows) for some in seen)
    level_from_rover = stops[1].lsl_from_rover.rotation
    turn = pose.rotation @ level_from_rover  # later rover to the earlier level frame
    by_shift = second.by_place @ turn.T
    arms = places[rows] - pose.translation_m
    by_pose = np.concatenate([np.cross(arms[:, None], by_shift), by_shift], axis=2)
    sigma = _sigmas(by_pose, covariance)
    defined = np.full(len(rows), DEFINED_PX)
    return Ties(
        pair_ids,
        first.pair,
        second.pair + np.int32(len(stops[0].pairs)),
        first.left,
        second.left,
        first.parallax_px,
        second.parallax_px,
        defined,
        sigma[:, 0],
        defined,
        sigma[:, 2],
        defined,
        sigma[:, 1],
        surface_matched=np.ones(len(rows), dtype=bool),
    )


def _sigmas(
    by_pose: Float64[np.ndarray, "n 3 6"], covariance: Float64[np.ndarray, "6 6"]
) -> Float64[np.ndarray, "n 3"]:
    """Standard deviations, in pixels, by which independent coordinates determine the pose as C.

    `by_pose` are the derivatives of (sample, line, parallax) by the pose, C its covariance.
    """
    a, faint = by_pose.reshape(-1, MOTION), LEAST_KNOWN * np.linalg.inv(covariance)
    by_motion = np.einsum("ij,jk,ik->i", a, covariance, a)
    variance = len(a) / MOTION * by_motion
    for _ in range(WEIGHT_ROUNDS):
        reached = np.linalg.inv(a.T @ (a / variance[:, None]) + faint)
        variance *= by_motion / np.einsum("ij,jk,ik->i", a, reached, a)
    return np.sqrt(variance).reshape(by_pose.shape[:2])


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Images of n points in the pairs of a stop."""

    pair: Int32[np.ndarray, " n"]
    """The pair in which it is nearest to the middle; -1 if in none."""
    left: Float64[np.ndarray, "n 2"]
    parallax_px: PerPoint
    by_place: Float64[np.ndarray, "n 3 3"]
    """Derivative of (sample, line, parallax) by the position in the rover frame."""

    def select(self, rows: np.ndarray) -> _Seen:
        """A selection of the ties."""
        columns = (self.pair, self.left, self.parallax_px, self.by_place)
        return _Seen(*(column[rows] for column in columns))


def _best_view(stop: MatchedStop, places: ObjectPoints) -> _Seen:
    """The pairs of a stop that show points of the rover frame best."""
    n = len(places)
    best, off = (
        _Seen(np.full(n, -1, np.int32), np.zeros((n, 2)), np.zeros(n), np.zeros((n, 3, 3))),
        np.full(n, np.inf),
    )
    for k, pair in enumerate(stop.pairs):
        g, pose = pair.geometry, pair.geometry.rover_from_pair
        in_pair = (places - pose.translation_m) @ pose.rotation
        left, parallax = g.project(in_pair)
        aside = np.abs(in_pair[:, 0] / in_pair[:, 2])
        better = _shows(pair, left, parallax) & (aside < off)
        off[better] = aside[better]
        best.pair[better], best.left[better] = k, left[better]
        best.parallax_px[better] = parallax[better]
        partials = projection_partials(in_pair[better], g.focal_px, g.base_m)
        best.by_place[better] = partials @ pose.rotation.T
    return best


def _shows(pair: MatchedPair, left: Float64[np.ndarray, "n 2"], parallax_px: PerPoint) -> Flags:
    """Whether dense parallax at image points agrees with the predicted one."""
    inside = pair.geometry.shows(left - MARGIN_PX) & pair.geometry.shows(left + MARGIN_PX)
    col, row = np.rint(np.where(inside[:, None], left, 0.0)).astype(np.int64).T
    with np.errstate(invalid="ignore"):
        off = np.abs(pair.parallax[row, col] - parallax_px)
        return inside & (off < np.maximum(VISIBLE * parallax_px, 1.0))
