"""Inter-stereo ties: points seen by several pairs of one stop (Di et al. 2008, section 3.1).

Every sparse match of a pair has a position in the rover frame; the mast's kinematics predicts its
image in the other pairs. Bland ground has few interest points: in cells without one the strongest
corner is taken, and its parallax, known from dense matching, measured by least squares. The
remaining difference is the pointing error: with 0.15 degrees per axis
and pair, the conjugate lies within 3 sqrt(2) x 0.15 degrees, 14 Navcam pixels, of its prediction.
Navcam and Pancam are matched in the geometry of the Navcam (`conjugates`: always the coarser
image). All ties of the stop are then aligned at once with the pointing of every pair free
(`alignment`), so that a tie must agree with all other ties of its pair, and pointing is consistent
around the panorama.

Least-squares matching gives the standard deviation s of a patch as a whole. Relief inside it, of
the standard deviation r in dense parallax about the plane of the patch, has a different effect in
each image: the error of the parallax of its middle is a fraction q of r, and that of its sample q r
b/B, where b is the distance between the left cameras of the two pairs (as the mast rotates) and B
the baseline. Lines are hardly affected, and their errors are smaller than s. Hence,

    s_x^2 = s^2 + (q r b/B)^2      s_y = l s      s_p^2 = s^2 + (q r)^2.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import Flags, Float64, ImagePoints
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StereoMatches, StopId
from solmap.photogrammetry.matching.alignment import AlignmentParams, align
from solmap.photogrammetry.matching.conjugates import (
    DEFINED_PX,
    ConjugateParams,
    TieView,
    find_conjugates,
    in_view,
    measure_parallax,
)
from solmap.photogrammetry.matching.parallax_planes import (
    ParallaxPlanes,
    parallax_planes,
    plane_homographies,
)
from solmap.photogrammetry.matching.records import MatchedPair, MatchedStop, Ties, join_ties
from solmap.photogrammetry.ranges import Count, Metres, WholePixels

REACH_SIGMAS = 3.0

RELIEF_SHARE = 0.5
"""q (see the module), and"""
LINE_SHARE = 0.75
"""l: fitted to the truth of one rendered stop, on its Navcam; results for other stops are in
docs/explanation/cross-site-ties.md."""


@dataclass(frozen=True, slots=True)
class InterStereoParams:
    """How the pairs of a stop are tied."""

    conjugates: ConjugateParams = field(
        default_factory=lambda: ConjugateParams(sigma_floor_px=0.02, parallax_floor_px=0.03)
    )
    """The images of one mast see the ground alike: compared with truth, least squares state the
    error of a conjugate to within a half, on smooth ground (0.03 px) and on rough (0.1 px)."""
    alignment: AlignmentParams = field(default_factory=AlignmentParams)
    candidates: Count = 150
    """Most points of a pair that are searched for in another one."""
    cell_px: WholePixels = 40
    """One candidate in every cell of this size: the most certain match or the strongest corner."""
    least_overlap: Count = 4
    """Matches that must fall into another pair before the two count as overlapping. A single tie
    fixes two of three angles; bland ground leaves ten matches or fewer in an overlap."""
    farthest_m: Metres = 100.0
    """Beyond it the range of a Navcam match is nearly unknown."""

    def __post_init__(self) -> None:
        if self.candidates < self.least_overlap or self.cell_px < 1:
            raise MatchingError("inter-stereo ties need more candidates than the least overlap")


@dataclass(frozen=True, slots=True)
class PairLink:
    """Result for two overlapping pairs of a stop."""

    first_id: str
    second_id: str
    candidates: int
    measured: int
    """Conjugates found with their parallax."""
    ties: int
    """Ties that are consistent with the geometry of the stop."""

    def __str__(self) -> str:
        return (
            f"{self.first_id} - {self.second_id}: {self.ties} ties of {self.measured} measured, "
            f"{self.candidates} searched"
        )


@dataclass(frozen=True, slots=True, eq=False)
class PairTies:
    """All inter-stereo ties of a stop."""

    stop: StopId
    ties: Ties
    links: tuple[PairLink, ...]
    """One for every two pairs that overlap."""
    pointing: dict[str, Float64[np.ndarray, " 3"]]
    """Pointing error found for each pair: a rotation vector in its frame, radians."""
    rms_px: float
    """Root mean square of the left image residuals after pointing, over the ties kept; NaN without
    ties."""

    @property
    def untied(self) -> tuple[PairLink, ...]:
        """Overlaps in which no tie was found."""
        return tuple(link for link in self.links if not link.ties)


def tie_inter_stereo(stop: MatchedStop, params: InterStereoParams) -> PairTies:
    """Tie every two pairs of a stop whose fields of view overlap."""
    views = [TieView(pair) for pair in stop.pairs]
    pair_ids = tuple(pair.pair_id for pair in stop.pairs)
    measured, searched = [], {}
    for one, other in combinations(range(len(views)), 2):
        source, target, candidates = _overlap(views[one], views[other], params)
        if len(candidates) < params.least_overlap:
            continue
        searched[source.pair.pair_id, target.pair.pair_id] = len(candidates)
        measured.append(
            _tie_pair(
                source,
                target,
                _between(source, target),
                candidates,
                _reach_px(source, target, params),
                params.conjugates,
                pair_ids,
            )
        )
    ties = join_ties(measured, pair_ids)
    return _verify(stop, ties, searched, params)


def _between(source: TieView, target: TieView) -> Pose:
    """target_from_source by the mast's kinematics."""
    return target.geometry.rover_from_pair.inverse @ source.geometry.rover_from_pair


def _reach_px(source: TieView, target: TieView, params: InterStereoParams) -> int:
    """Displacement of a conjugate by pointing errors, in pixels of the coarser image."""
    focal = min(source.geometry.focal_px, target.geometry.focal_px)
    spread = np.sqrt(2.0) * params.alignment.pointing_sigma
    return int(np.ceil(REACH_SIGMAS * spread * focal))


def _overlap(
    one: TieView, other: TieView, params: InterStereoParams
) -> tuple[TieView, TieView, StereoMatches]:
    """(source, target, candidates): the source has the finer scale, or more matches."""
    there = _visible(one, other, one.pair.matches, params)
    back = _visible(other, one, other.pair.matches, params)
    if one.geometry.focal_px != other.geometry.focal_px:
        forth = one.geometry.focal_px > other.geometry.focal_px
    else:
        forth = int(there.sum()) >= int(back.sum())
    source, target, seen = (one, other, there) if forth else (other, one, back)
    sparse = _select_candidates(source, np.flatnonzero(seen), params)
    return source, target, _add_corners(source, target, sparse, params)


def _add_corners(
    source: TieView, target: TieView, sparse: StereoMatches, params: InterStereoParams
) -> StereoMatches:
    """Sparse matches of the source, and in cells without one the corner of its dense parallax."""
    corners = source.corners(params.cell_px)
    corners = corners[
        ~np.isin(_cells(corners, params.cell_px), _cells(sparse.left, params.cell_px))
    ]
    col, row = corners.astype(np.int64).T
    dense = source.pair.parallax[row, col].astype(np.float64)
    seen = StereoMatches(sparse.pair_id, corners, dense, np.ones(len(corners)))
    points = corners[_visible(source, target, seen, params)]
    points = points[_spread(len(points), params.candidates - len(sparse))]
    parallax, sigma = measure_parallax(source, points, params.conjugates)
    good = np.isfinite(parallax)
    return StereoMatches(
        sparse.pair_id,
        np.vstack([sparse.left, points[good]]),
        np.concatenate([sparse.parallax_px, parallax[good]]),
        np.concatenate([sparse.sigma_px, sigma[good]]),
    )


def _visible(
    source: TieView, target: TieView, matches: StereoMatches, params: InterStereoParams
) -> Flags:
    """Which matches of the source, on a plane, lie in the target's image."""
    scale = source.geometry.focal_px * source.geometry.base_m
    rows = matches.parallax_px > scale / params.farthest_m
    seen, half_px = np.zeros(len(matches), dtype=bool), params.conjugates.half_px
    if not rows.any():
        return seen
    points = source.geometry.triangulate(matches.left[rows], matches.parallax_px[rows])
    left, _ = target.geometry.project(_between(source, target).apply(points))
    seen[np.flatnonzero(rows)] = in_view(target, left, half_px)
    seen[seen] = parallax_planes(source.pair.parallax, matches.left[seen], half_px).found
    return seen


def _select_candidates(
    source: TieView, rows: np.ndarray, params: InterStereoParams
) -> StereoMatches:
    """The most certain sparse match of every cell; with too many cells, spread over the image."""
    matches = source.pair.matches
    order = rows[np.argsort(matches.sigma_px[rows], kind="stable")]
    cells = _cells(matches.left[order], params.cell_px)
    _, first = np.unique(cells, return_index=True)
    chosen = order[first][_spread(len(first), params.candidates)]
    return _select(matches, chosen)


def _select(matches: StereoMatches, rows: np.ndarray) -> StereoMatches:
    """Some of the matches."""
    columns = (matches.left, matches.parallax_px, matches.sigma_px)
    return StereoMatches(matches.pair_id, *(column[rows] for column in columns))


def _spread(count: int, most: int) -> np.ndarray:
    """At most so many of some numbers, at equal steps."""
    return np.linspace(0, max(count - 1, 0), max(min(count, most), 0)).astype(np.int64)


def _cells(points: ImagePoints, cell_px: int) -> np.ndarray:
    """A number for the cell that every point falls into."""
    col, row = np.floor_divide(points, cell_px).astype(np.int64).T
    return row * 100_000 + col


def _tie_pair(  # noqa: PLR0913, PLR0917 - two views, what joins them, which matches, and how
    source: TieView,
    target: TieView,
    target_from_source: Pose,
    matches: StereoMatches,
    reach: int,
    params: ConjugateParams,
    pair_ids: tuple[str, ...],
) -> Ties:
    """Ties between matches of the source pair and their conjugates in the target."""
    planes = parallax_planes(source.pair.parallax, matches.left, params.half_px)
    planes = ParallaxPlanes(matches.parallax_px, planes.gradient, planes.residual_px)
    good = np.isfinite(planes.gradient).all(axis=1)
    matches, planes, points = _select(matches, good), planes.select(good), matches.left[good]
    maps = plane_homographies(source.geometry, target.geometry, target_from_source, points, planes)
    found = find_conjugates(source.left, target.left, points, maps, reach, params)
    parallax, sigma_parallax = measure_parallax(target, found.points[found.found], params)
    residual_px, floor_px = planes.residual_px[found.found], params.parallax_floor_px
    matches = _select(matches, found.found)
    own_px = matches.parallax_px
    relief_px = RELIEF_SHARE * residual_px * parallax / own_px
    sigma = found.sigma_px[found.found]
    apart = np.linalg.norm(_between(source, target).translation_m) / target.geometry.base_m
    indices = [
        np.full(len(matches), pair_ids.index(v.pair.pair_id), np.int32) for v in (source, target)
    ]
    ties = Ties(
        pair_ids,
        indices[0],
        indices[1],
        matches.left,
        found.points[found.found],
        own_px,
        parallax,
        np.full(len(matches), DEFINED_PX),
        np.hypot(sigma, relief_px * apart),
        np.maximum(matches.sigma_px, floor_px),
        np.hypot(sigma_parallax, relief_px),
        np.full(len(matches), DEFINED_PX),
        LINE_SHARE * sigma,
    )
    return ties.select(np.isfinite(parallax))


def _verify(
    stop: MatchedStop,
    ties: Ties,
    searched: dict[tuple[str, str], int],
    params: InterStereoParams,
) -> PairTies:
    """Keep the ties that agree with the geometry of the whole stop."""
    counted = ties.counts()
    if len(ties):
        geometries = {pair.pair_id: pair.geometry for pair in stop.pairs}
        rest = Pose.identity(stop.stop.frame, stop.stop.frame)
        sets = {pair.pair_id: pair.instrument for pair in stop.pairs}
        alignment = align(ties, geometries, rest, None, params.alignment, sets)
        kept = ties.select(alignment.agrees)
        pointing, rms_px = alignment.pointing, alignment.rms_px
    else:
        kept, pointing, rms_px = ties, {}, float("nan")
    agreeing = kept.counts()
    links = tuple(
        PairLink(
            first, second, n, counted.get((first, second), 0), agreeing.get((first, second), 0)
        )
        for (first, second), n in searched.items()
    )
    return PairTies(stop.stop, kept, links, pointing, rms_px)


def point_pairs(stop: MatchedStop, ties: Ties, params: AlignmentParams) -> MatchedStop:
    """The stop with pair pointings corrected by its inter-stereo ties: one rigid panorama.

    The common rotation, which ties do not determine, stays that of the labels.
    """
    if not len(ties):
        return stop
    geometries = {pair.pair_id: pair.geometry for pair in stop.pairs}
    rest = Pose.identity(stop.stop.frame, stop.stop.frame)
    pointing = align(ties, geometries, rest, None, params).pointing
    return replace(
        stop, pairs=tuple(_turned(pair, pointing.get(pair.pair_id)) for pair in stop.pairs)
    )


def _turned(pair: MatchedPair, pointing: Float64[np.ndarray, " 3"] | None) -> MatchedPair:
    """A pair with its pointing corrected by a rotation vector of its own frame."""
    if pointing is None:
        return pair
    turn = ScipyRotation.from_rotvec(pointing).as_matrix()
    return replace(pair, geometry=pair.geometry.turn(turn))
