"""Ties between single images of one stop: frames of a panorama that have no stereo partner.

Every two that overlap are searched for conjugates (`search`); those consistent with the geometry of
the two cameras (`two_views`) become ties. A tie has two left image points and no parallax (NaN):
the adjustment determines the depth of its tie point from the centimetres between the images. A
stereo pair beside a single image gives the depth itself: its matches are searched at their
predicted positions, and the tie has the pair's parallax.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from solmap.photogrammetry.arrays import ImagePoints, PerPoint
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.conjugates import Conjugates, View
from solmap.photogrammetry.matching.records import MatchedPair, Ties, join_ties
from solmap.photogrammetry.matching.single.search import (
    LEAST_BASE_M,
    MonoParams,
    SingleView,
    check_pair,
    matches_in_view,
    search_all_depths,
    search_near_depth,
    search_predicted,
    select_candidates,
)
from solmap.photogrammetry.matching.single.two_views import TwoViews

NAN = float("nan")


@dataclass(frozen=True, slots=True)
class MonoLink:
    """Result for two single images that overlap."""

    first_id: str
    second_id: str
    candidates: int
    measured: int
    ties: int
    label_px: float
    """Median distance from the epipolar lines of the labels; NaN without ties."""
    left_px: float
    """Median absolute distance after the rotation between the two cameras."""
    turn_deg: float
    """Angle of that rotation."""


@dataclass(frozen=True, slots=True, eq=False)
class MonoTies:
    """All ties between single images of a stop."""

    stop: StopId
    ties: Ties
    links: tuple[MonoLink, ...]
    """One for every two images that overlap."""
    misfit: PerPoint
    """Misfit of every tie: its distance from the epipolar line as a fraction of the limit."""


@dataclass(frozen=True, slots=True, eq=False)
class LinkedImages:
    """Ties between two images, the result of the search, and the fit of each tie."""

    ties: Ties
    link: MonoLink
    misfit: PerPoint


def tie_single_images(
    stop: StopId,
    views: Sequence[SingleView],
    params: MonoParams,
    pairs: Sequence[MatchedPair] = (),
) -> MonoTies:
    """Tie every two overlapping single images of a stop, and each with the overlapping pairs."""
    ids = (*(pair.pair_id for pair in pairs), *(view.image_id for view in views))
    found = [tie_two(one, other, ids, params) for one, other in combinations(views, 2)]
    found += [tie_to_pair(pair, view, ids, params) for pair in pairs for view in views]
    made = [both for both in found if both is not None]
    return MonoTies(
        stop,
        join_ties([both.ties for both in made], ids),
        tuple(both.link for both in made),
        np.concatenate([np.zeros(0), *(both.misfit for both in made)]),
    )


def tie_two(
    one: SingleView, other: SingleView, ids: tuple[str, ...], params: MonoParams
) -> LinkedImages | None:
    """Ties of two single images, and the result of the search; None where they do not overlap."""
    two_views = TwoViews(one.geometry, other.geometry)
    if two_views.base_m < LEAST_BASE_M:
        return None
    points = select_candidates(one, other, two_views, params)
    if len(points) < params.least_ties:
        return None
    first = search_all_depths(one, other, two_views, points[: params.first_points], params)
    found = (
        _no_conjugates(points)
        if first is None
        else search_near_depth(one, other, two_views, points, *first, params)
    )
    nothing = np.full(len(points), np.nan)
    measured = MeasuredPoints(
        one.image_id, points, nothing, np.full(len(points), params.conjugates.sigma_floor_px)
    )
    return _evaluate(two_views, measured, other, found, ids, params)


def tie_to_pair(
    pair: MatchedPair, view: SingleView, ids: tuple[str, ...], params: MonoParams
) -> LinkedImages | None:
    """Ties of a stereo pair with a single image beside it; None where they do not overlap."""
    two_views = TwoViews(pair.geometry, view.geometry)
    if two_views.base_m < LEAST_BASE_M:
        return None
    rows = matches_in_view(pair, view, two_views, params)
    if len(rows) < params.least_ties:
        return None
    left, parallax = pair.matches.left[rows], pair.matches.parallax_px[rows]
    source = SingleView(pair.pair_id, two_views.one, View.of(pair.left, pair.left_mask))
    found = search_predicted(source, view, two_views, left, parallax, params)
    sigma = np.maximum(pair.matches.sigma_px[rows], params.conjugates.sigma_floor_px)
    measured = MeasuredPoints(pair.pair_id, left, parallax, sigma)
    return _evaluate(two_views, measured, view, found, ids, params)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoints:
    """Points of the first image of a link, with their parallax where a pair measured it."""

    name: str
    left: ImagePoints
    parallax_px: PerPoint
    sigma_px: PerPoint


def _evaluate(
    two_views: TwoViews,
    first: MeasuredPoints,
    other: SingleView,
    found: Conjugates,
    ids: tuple[str, ...],
    params: MonoParams,
) -> LinkedImages:
    """The conjugates that agree with the geometry, as ties, and the result of the search."""
    names, kept = (first.name, other.image_id), found.found
    searched, measured = len(first.left), int(kept.sum())
    link = MonoLink(*names, searched, measured, 0, NAN, NAN, NAN)
    none = LinkedImages(Ties.none(ids), link, np.zeros(0))
    if measured < params.least_ties:
        return none
    checked = check_pair(two_views, first.left[kept], found.points[kept], params)
    good = checked.agrees & (checked.along_px >= params.least_parallax_px)
    if good.sum() < params.least_ties:
        return none
    figures = (
        float(np.median(checked.across_px[good])),
        float(np.median(np.abs(checked.left_px[good]))),
        float(np.rad2deg(np.linalg.norm(checked.turn))),
    )
    rows = np.flatnonzero(kept)[good]
    link = MonoLink(*names, searched, measured, len(rows), *figures)
    floor_px = params.conjugates.parallax_floor_px
    ties = _assemble(first, names, found, rows, ids, floor_px)
    return LinkedImages(ties, link, checked.misfit[good])


def _no_conjugates(points: ImagePoints) -> Conjugates:
    """No conjugates."""
    nan, none = np.full(len(points), np.nan), np.zeros(len(points), dtype=bool)
    return Conjugates(
        none, np.zeros_like(points), nan, nan.copy(), np.full((len(points), 2, 2), np.nan)
    )


def _assemble(
    first: MeasuredPoints,
    names: tuple[str, str],
    found: Conjugates,
    rows: np.ndarray,
    ids: tuple[str, ...],
    floor_px: float,
) -> Ties:
    """A selection of conjugates as columns of ties."""
    one, other = (np.full(len(rows), ids.index(name), np.int32) for name in names)
    parallax, unknown = first.parallax_px[rows], np.full(len(rows), np.nan)
    stereo = np.isfinite(parallax)
    return Ties(
        ids,
        one,
        other,
        first.left[rows],
        found.points[rows],
        parallax,
        unknown,
        first.sigma_px[rows],
        found.sigma_px[rows],
        np.where(stereo, np.maximum(first.sigma_px[rows], floor_px), np.nan),
        unknown.copy(),
        first.sigma_px[rows].copy(),
        found.sigma_px[rows].copy(),
    )
