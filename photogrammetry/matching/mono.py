"""Ties between single images of one stop: frames of a panorama that have no stereo partner.

Every two that overlap are searched for conjugates (`swing_search`); what agrees with the geometry
of the two cameras (`mast_swing`) becomes a tie. It holds two left image points and no parallax
(NaN): the depth of its tie point comes from the centimetres between the images, in the adjustment.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from photogrammetry.arrays import ImagePoints
from photogrammetry.imagery import StopId
from photogrammetry.matching.conjugates import Conjugates
from photogrammetry.matching.mast_swing import Swing, SwingVerdict
from photogrammetry.matching.swing_search import (
    MonoParams,
    SingleView,
    candidates,
    guided,
    scouted,
    verified,
)
from photogrammetry.matching.ties import Ties, joined


@dataclass(frozen=True, slots=True)
class MonoLink:
    """What came of two single images that overlap."""

    first_id: str
    second_id: str
    candidates: int
    measured: int
    ties: int
    label_px: float
    """Median distance from the epipolar lines of the labels; NaN without ties."""
    left_px: float
    """Median absolute distance after the turn between the two cameras."""
    turn_deg: float
    """How large that turn is."""


@dataclass(frozen=True, slots=True, eq=False)
class MonoTies:
    """All ties between single images of a stop."""

    stop: StopId
    ties: Ties
    links: tuple[MonoLink, ...]
    """One for every two images that overlap."""


def tie_single_images(
    stop: StopId, views: tuple[SingleView, ...] | list[SingleView], params: MonoParams
) -> MonoTies:
    """Tie every two single images of a stop whose fields of view overlap."""
    ids = tuple(view.image_id for view in views)
    ties, links = [], []
    for one, other in combinations(views, 2):
        found = tie_two(one, other, ids, params)
        if found is not None:
            ties.append(found[0])
            links.append(found[1])
    return MonoTies(stop, joined(ties, ids), tuple(links))


def tie_two(
    one: SingleView, other: SingleView, ids: tuple[str, ...], params: MonoParams
) -> tuple[Ties, MonoLink] | None:
    """Ties of two single images, and what came of it; None where they do not overlap."""
    swing = Swing(one.geometry, other.geometry)
    points = candidates(one, other, swing, params)
    if len(points) < params.least_ties:
        return None
    found = _nothing(points)
    verdict = None
    scouts = scouted(one, other, swing, points[: params.scouts], params)
    if scouts is not None:
        near, turn = scouts
        found = guided(one, other, swing, points, near, turn, params)
        kept = found.found
        if kept.sum() >= params.least_ties:
            verdict = verified(swing, points[kept], found.points[kept], params)
    return _assembled((one, other), ids, points, found, verdict, params)


def _nothing(points: ImagePoints) -> Conjugates:
    """No conjugate of any point."""
    nan, none = np.full(len(points), np.nan), np.zeros(len(points), dtype=bool)
    return Conjugates(none, np.zeros_like(points), nan, nan.copy())


def _assembled(
    both: tuple[SingleView, SingleView],
    ids: tuple[str, ...],
    points: ImagePoints,
    found: Conjugates,
    verdict: SwingVerdict | None,
    params: MonoParams,
) -> tuple[Ties, MonoLink]:
    """The ties that agree, as columns, and what came of the search."""
    names = both[0].image_id, both[1].image_id
    measured = int(found.found.sum())
    good = np.zeros(0, dtype=bool)
    if verdict is not None:
        good = verdict.agrees & (verdict.along_px >= params.least_parallax_px)
    if verdict is None or good.sum() < params.least_ties:
        nan = float("nan")
        return Ties.none(ids), MonoLink(*names, len(points), measured, 0, nan, nan, nan)
    label, left = verdict.across_px[good], np.abs(verdict.left_px[good])
    good = np.flatnonzero(found.found)[good]
    n = len(good)
    index = [np.full(n, ids.index(name), np.int32) for name in names]
    nothing = np.full(n, np.nan)
    floor = np.full(n, params.conjugates.sigma_floor_px)
    ties = Ties(
        ids, *index, points[good], found.points[good], nothing, nothing.copy(),
        floor, found.sigma_px[good], nothing.copy(), nothing.copy(),
    )  # fmt: skip
    figures = (
        float(np.median(label)),
        float(np.median(left)),
        float(np.rad2deg(np.linalg.norm(verdict.turn))),
    )
    return ties, MonoLink(*names, len(points), measured, n, *figures)
