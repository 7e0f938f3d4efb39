"""Surface-matched cross-site ties: observations from registering the surfaces of two stops.

After registration of two stops' surfaces (`surface_alignment`), every block of ground has a
remaining shift with a covariance: along the normal of every cell, so best in height, and
horizontally as well as relief and, where it is alike, brightness permit. A block becomes a tie: a
point of the earlier stop's ground, exact by definition, and its image at the later stop, with
standard deviations of sample, line and parallax from the covariance of the block's shift.
Surface-matched ties therefore constrain relative bearing, range and height, each with its own
weight, and the adjustment still estimates the pointing of pairs.

The covariances of blocks are scaled by the scatter of their shifts. Errors common to all blocks do
not average out; they are included in the covariance C of the registration. An adjustment treats
ties as independent, so their variances are chosen such that all of them together have the right
information. With a the derivative of a coordinate by the pose, a' C a is its variance by the pose;
3n coordinates of n ties determine 6 unknowns, and with the variance

    s^2 = own + (3n / 6) a' C a

of each, own being the block's, their information is that of C: the sum of a' C a / s^2 is 6, like
the trace of C^-1 C. What C leaves uncertain, usually the range between the stops, the ties leave
uncertain too, and image-matched ties determine it; azimuth and tilt, which C determines well, they
determine as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.arrays import Flags, Float64, Int32, ObjectPoints, PerPoint
from solmap.photogrammetry.cameras.epipolar import projection_partials
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.ground_grid import GroundGrid
from solmap.photogrammetry.matching.cross_site.surface_alignment import (
    HEIGHTS,
    MOTION,
    RELIEF,
    Cells,
    Registration,
    SurfaceParams,
    register,
    without_noise,
)
from solmap.photogrammetry.matching.records import MatchedPair, MatchedStop, Ties
from solmap.photogrammetry.ranges import Count, Metres
from solmap.photogrammetry.robust import robust_sigma

DEFINED_PX = 0.02
"""Standard deviation of the earlier stop's point, which defines the tie and has no error."""

LOOSE_M = 0.3
"""Prior standard deviation of a block's shift, for undetermined directions."""

COORDINATES = 3
"""Number of coordinates of a tie that depend on the pose: sample, line and parallax."""

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

CERTAIN = 4.0
"""Standard deviations by which relief must correlate better than anywhere else; wrong starts
reached 3.3 at most."""


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
    """The hypothesis with the most significant correlation of relief, after registration."""

    found: Registration
    by_chance: float
    """Most significant correlation of relief at other positions, tested in the same way; standard
    deviations of chance."""
    at_peak: bool
    """Whether it is the position of the first hypothesis, a significant peak of the search."""

    @property
    def clearness(self) -> float:
        """Standard deviations by which relief correlates better than elsewhere."""
        return significance(self.found) - self.by_chance

    @property
    def is_certain(self) -> bool:
        """Whether relief determines the position; half suffices if the search found it too."""
        return self.clearness > (CERTAIN / 2 if self.at_peak else CERTAIN)

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
) -> ShapeTrial | None:
    """Register the later stop's ground to the earlier one's from hypotheses; return the best.

    Hypotheses that end further than `apart_m` from it, and positions without hypothesis, give the
    significance by chance. None where the stops share too little ground.
    """
    prior = np.diag(np.square(HYPOTHESIS_SIGMAS))
    laid = [register(*grids, pose, prior, params, RELIEF) for pose in (*starts, *elsewhere)]
    tried = [one for one in laid[: len(starts)] if one is not None]
    if not tried:
        return None
    best = max(tried, key=significance)
    place_m = best.pose.translation_m[:2]
    others = [
        significance(one)
        for one in laid
        if one is not None and np.linalg.norm(one.pose.translation_m[:2] - place_m) > apart_m
    ]
    found = register(*grids, best.pose, prior, params, HEIGHTS)
    if found is None:
        return None
    found = replace(found, correlation=best.correlation, area_m2=best.area_m2)
    return ShapeTrial(found, max(0.0, *others) if others else 0.0, best is laid[0])


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks of ground, n of them."""

    places: ObjectPoints
    """A point of the earlier stop's ground in the middle, in its level frame."""
    arms: ObjectPoints
    """Vectors from the later rover to the points, in the same axes."""
    shift_m: ObjectPoints
    """Shift that moves the later stop's ground onto it."""
    covariance: Float64[np.ndarray, "n 3 3"]

    def select(self, rows: np.ndarray) -> Blocks:
        """A selection of the ties."""
        columns = (self.places, self.arms, self.shift_m, self.covariance)
        return Blocks(*(column[rows] for column in columns))


def find_blocks(cells: Sequence[Cells], params: SurfaceTieParams) -> Blocks:
    """The blocks with the most certain shifts, from the cells at the solution.

    The first cells are those of heights.
    """
    heights, places = cells[0], np.vstack([some.places for some in cells])[:, :2]
    square = np.floor(places / params.block_m).astype(np.int64) @ (10_000, 1)
    block = np.unique(square, return_inverse=True)[1].ravel()
    blocks, of_heights = int(block.max()) + 1, block[: len(heights.weight)]
    squares, noise, right = (np.zeros((blocks, 3, n)) for n in (3, 3, 1))
    weight, g, d, r = (
        np.concatenate([getattr(some, name) for some in cells])
        for name in ("weight", "by_shift", "disagreement", "residual")
    )
    for total, one, other in ((squares, g, g), (noise, d, d), (right, -g, r[:, None])):
        np.add.at(total, block, (one * weight[:, None])[:, :, None] * other[:, None, :])
    kept = np.bincount(of_heights[heights.weight > 0], minlength=blocks)
    used = kept >= params.least_cells
    if not used.any():
        return Blocks(*(np.zeros((0, 3)),) * 3, np.zeros((0, 3, 3)))
    squares, right = squares[used] + 1e-6 * np.eye(3), right[used]
    scatter = robust_sigma(np.linalg.solve(np.linalg.cholesky(squares), right)) ** 2
    signal = without_noise(squares, noise[used])
    passed = signal @ np.linalg.inv(squares) / scatter
    covariance = np.linalg.inv(passed @ signal + np.eye(3) / LOOSE_M**2)
    shift = (covariance @ passed @ right)[:, :, 0]
    best = np.argsort(np.linalg.det(covariance), kind="stable")[: params.most]
    middle = _middles(heights, of_heights, blocks)[used][best]
    ground = heights.places[middle]
    ground[:, 2] -= heights.residual[middle]
    return Blocks(ground, heights.arms[middle], shift[best], covariance[best])


def _middles(cells: Cells, block: np.ndarray, blocks: int) -> Int32[np.ndarray, " blocks"]:
    """The cell nearest to the middle of those of each block; any where there is none."""
    places = cells.places[:, :2]
    count = np.maximum(np.bincount(block, minlength=blocks), 1)
    middle = np.column_stack([np.bincount(block, axis, blocks) / count for axis in places.T])
    order = np.lexsort((np.linalg.norm(places - middle[block], axis=1), block))
    first = np.zeros(blocks, np.int32)
    blocks_with, rows = np.unique(block[order], return_index=True)
    first[blocks_with] = order[rows]
    return first


def tie_by_surface(
    stops: tuple[MatchedStop, MatchedStop],
    found: Registration,
    params: SurfaceTieParams,
) -> Ties:
    """Surface-matched ties between the pairs of two registered stops."""
    pair_ids = tuple(pair.pair_id for stop in stops for pair in stop.pairs)
    blocks = find_blocks(found.cells, params)
    there = found.pose.inverse.apply(blocks.places - blocks.shift_m)
    rovers = [
        places @ stop.lsl_from_rover.rotation
        for stop, places in zip(stops, (blocks.places, there), strict=True)
    ]
    seen = [_best_view(stop, places) for stop, places in zip(stops, rovers, strict=True)]
    rows = np.flatnonzero((seen[0].pair >= 0) & (seen[1].pair >= 0))
    if len(rows) < params.least:
        return Ties.none(pair_ids)
    first, second = (some.select(rows) for some in seen)
    level_from_rover = stops[1].lsl_from_rover.rotation
    turn = found.pose.rotation @ level_from_rover  # later rover to the earlier level frame
    by_shift = second.by_place @ turn.T
    by_pose = np.concatenate([np.cross(blocks.arms[rows, None], by_shift), by_shift], axis=2)
    own = np.diagonal(by_shift @ blocks.covariance[rows] @ by_shift.mT, axis1=1, axis2=2)
    shared = np.diagonal(by_pose @ found.covariance @ by_pose.mT, axis1=1, axis2=2)
    sigma = np.sqrt(own + len(rows) * COORDINATES / MOTION * shared)
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
