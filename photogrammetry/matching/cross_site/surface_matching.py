"""Surface-matched cross-site ties: what the shape of the ground says of two stops.

When the ground of two stops is laid onto each other (`surface_alignment`), every block of it says
on its own by how much it would still move, and how well it knows that: along the normal of every
cell, so height best, and place as well as relief tells it. A block becomes a tie: a point of the
earlier stop's ground, which lies there by definition, and where the later stop sees it, with
standard deviations of sample, line and parallax from the covariance of the block's shift. So ties
by shape tell bearing, range and height of the stops to each other, each as well as it is known, and
the pointing of pairs stays the adjustment's to find.

How much blocks know is scaled by how much they differ from each other. What they share no number
of them averages out; the covariance C of the registration has it. An adjustment takes ties for
independent, so their variances are chosen for all of them together to tell what is known. With a
the derivative of a coordinate by the pose, a' C a is its variance by the pose; 3n coordinates of
n ties tell 6 unknowns, and with the variance

    s^2 = own + (3n / 6) a' C a

of each, own being the block's, they tell as much: the sum of a' C a / s^2 is 6, as the trace of
C^-1 C is. So what C leaves open, as a rule the range between the stops, is left open by the ties as
well, and image-matched ties decide it; what it knows well, azimuth and tilt, they tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.arrays import Flags, Float64, Int32, ObjectPoints, PerPoint
from solmap.photogrammetry.cameras.epipolar import projection_partials
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.surface_alignment import (
    HEIGHTS,
    MOTION,
    RELIEF,
    Cells,
    HeightGrid,
    Registration,
    SurfaceParams,
    register,
)
from solmap.photogrammetry.matching.records import MatchedPair, MatchedStop, Ties
from solmap.photogrammetry.ranges import Count, Metres
from solmap.photogrammetry.robust import robust_sigma

DEFINED_PX = 0.02
"""A point of the earlier stop is where it is by definition."""

LOOSE_M = 0.3
"""Standard deviation of a block's shift before: what is not told stays about where it is."""

COORDINATES = 3
"""Of a tie that tell of the pose: sample, line and parallax."""

MARGIN_PX = 16
"""Points nearer to the border of a pair are left to the pair beside it."""

VISIBLE = 0.05
"""Parallax at a point may differ from the predicted one by this share: else something hides it."""


HYPOTHESIS_SIGMAS = (0.0052, 0.0052, 0.0175, 0.3, 0.3, 0.3)
"""Standard deviations of a hypothesis: tilt by gravity (radians), azimuth, place (metres)."""

RELIEF_M = 0.33
"""Relief is the same over so much: some area has N = area / (4 pi r^2) independent places, and
chance correlates by N^-1/2. It did in 195 registrations from wrong starts between stops of four
worlds, with 30 square metres and with 800 (RMS 1.0 N^-1/2)."""

CERTAIN = 4.0
"""Standard deviations by which relief must correlate better than anywhere else; wrong starts came
to 3.3 at most."""


@dataclass(frozen=True, slots=True)
class SurfaceTieParams:
    """Which blocks of ground become ties."""

    enabled: bool = True
    surface: SurfaceParams = field(default_factory=SurfaceParams)
    block_m: Metres = 1.5
    """Side of a block."""
    least_cells: Count = 30
    least: Count = 8
    """With fewer blocks there are no surface-matched ties."""
    most: Count = 80
    """Blocks that become ties, the most certain."""

    def __post_init__(self) -> None:
        if not (self.block_m > 0 and self.least_cells > 0 and self.most >= self.least > 0):
            raise MatchingError(
                "surface-matched ties need blocks above zero in size, cells and number"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ShapeTrial:
    """The hypothesis that the shape of the ground speaks for, laid onto the ground."""

    found: Registration
    by_chance: float
    """Greatest correlation of relief at other places, tried in the same way."""
    at_peak: bool
    """Whether it is the place of the first hypothesis, a peak that stands out by itself."""

    @property
    def clearness(self) -> float:
        """Standard deviations by which relief correlates better than elsewhere."""
        places = self.found.area_m2 / (4 * np.pi * RELIEF_M**2)
        return (self.found.correlation - self.by_chance) * float(np.sqrt(places))

    @property
    def is_certain(self) -> bool:
        """Whether the shape tells the place; half as much will do where the search told it too."""
        return self.clearness > (CERTAIN / 2 if self.at_peak else CERTAIN)

    def __str__(self) -> str:
        return (
            f"relief correlates by {self.found.correlation:.2f}, elsewhere by {self.by_chance:.2f}"
        )


def try_shapes(
    grids: tuple[HeightGrid, HeightGrid],
    starts: Sequence[Pose],
    elsewhere: Sequence[Pose],
    apart_m: float,
    params: SurfaceParams,
) -> ShapeTrial | None:
    """Lay the later stop's ground onto the earlier one's from hypotheses; the best of them.

    Hypotheses that end further than `apart_m` from it, and places where no hypothesis is, show what
    chance can do. None where the stops share next to no ground.
    """
    prior = np.diag(np.square(HYPOTHESIS_SIGMAS))
    laid = [register(*grids, pose, prior, params, RELIEF) for pose in (*starts, *elsewhere)]
    tried = [one for one in laid[: len(starts)] if one is not None]
    if not tried:
        return None
    best = max(tried, key=lambda one: one.correlation)
    place_m = best.pose.translation_m[:2]
    others = [
        one.correlation
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
    """From the later rover to it, in the same axes."""
    shift_m: ObjectPoints
    """What lays the later stop's ground onto it."""
    covariance: Float64[np.ndarray, "n 3 3"]

    def select(self, rows: np.ndarray) -> Blocks:
        """Some of them."""
        columns = (self.places, self.arms, self.shift_m, self.covariance)
        return Blocks(*(column[rows] for column in columns))


def find_blocks(cells: Cells, params: SurfaceTieParams) -> Blocks:
    """The blocks that know their place best, from the cells where the motion was found."""
    square = np.floor(cells.places[:, :2] / params.block_m).astype(np.int64) @ (10_000, 1)
    block = np.unique(square, return_inverse=True)[1].ravel()
    blocks = int(block.max()) + 1
    g, weighted = cells.by_shift, cells.by_shift * cells.weight[:, None]
    normal, right = np.zeros((blocks, 3, 3)), np.zeros((blocks, 3))
    np.add.at(normal, block, weighted[:, :, None] * g[:, None, :])
    np.add.at(right, block, -weighted * cells.residual_m[:, None])
    used = np.bincount(block[cells.weight > 0], minlength=blocks) >= params.least_cells
    if not used.any():
        return Blocks(*(np.zeros((0, 3)),) * 3, np.zeros((0, 3, 3)))
    root = np.linalg.cholesky(normal[used] + 1e-6 * np.eye(3))
    scatter = robust_sigma(np.linalg.solve(root, right[used][:, :, None])) ** 2
    covariance = np.linalg.inv(normal / scatter + np.eye(3) / LOOSE_M**2)
    shift = (covariance @ right[:, :, None])[:, :, 0] / scatter
    middle = _middles(cells, block, blocks)
    size = np.where(used, np.linalg.det(covariance), np.inf)
    order = np.argsort(size, kind="stable")[: params.most]
    best = order[np.isfinite(size[order])]
    places = cells.places.copy()
    places[:, 2] -= cells.residual_m
    return Blocks(places[middle], cells.arms[middle], shift, covariance).select(best)


def _middles(cells: Cells, block: np.ndarray, blocks: int) -> Int32[np.ndarray, " blocks"]:
    """The cell nearest to the middle of those of each block."""
    places = cells.places[:, :2]
    count = np.bincount(block, minlength=blocks)
    middle = np.column_stack([np.bincount(block, axis, blocks) / count for axis in places.T])
    order = np.lexsort((np.linalg.norm(places - middle[block], axis=1), block))
    return order[np.unique(block[order], return_index=True)[1]].astype(np.int32)


def tie_by_surface(
    stops: tuple[MatchedStop, MatchedStop],
    found: Registration,
    params: SurfaceTieParams,
) -> Ties:
    """Surface-matched ties between the pairs of two stops, laid onto each other."""
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
        by_shape=np.ones(len(rows), dtype=bool),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Where the pairs of a stop see n places."""

    pair: Int32[np.ndarray, " n"]
    """The pair that shows it nearest to its middle; -1 if none does."""
    left: Float64[np.ndarray, "n 2"]
    parallax_px: PerPoint
    by_place: Float64[np.ndarray, "n 3 3"]
    """Derivative of (sample, line, parallax) by the place in the rover frame."""

    def select(self, rows: np.ndarray) -> _Seen:
        """Some of them."""
        columns = (self.pair, self.left, self.parallax_px, self.by_place)
        return _Seen(*(column[rows] for column in columns))


def _best_view(stop: MatchedStop, places: ObjectPoints) -> _Seen:
    """The pairs of a stop that show places of the rover frame best."""
    n = len(places)
    best, off = (
        _Seen(np.full(n, -1, np.int32), np.zeros((n, 2)), np.zeros(n), np.zeros((n, 3, 3))),
        np.full(n, np.inf),
    )
    for k, pair in enumerate(stop.pairs):
        g, pose = pair.images.geometry, pair.images.geometry.rover_from_pair
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
    """Whether dense parallax at image points is the predicted one."""
    inside = pair.images.geometry.shows(left - MARGIN_PX) & pair.images.geometry.shows(
        left + MARGIN_PX
    )
    col, row = np.rint(np.where(inside[:, None], left, 0.0)).astype(np.int64).T
    with np.errstate(invalid="ignore"):
        off = np.abs(pair.parallax[row, col] - parallax_px)
        return inside & (off < np.maximum(VISIBLE * parallax_px, 1.0))
