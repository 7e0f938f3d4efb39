"""Hypotheses of where the later of two stops stands, from several independent ways.

    correlation   bird's-eye views, grey and relief, over all shifts and azimuths (`correlation`)
    features      described in the bird's-eye views and matched one by one (`features`)
    rocks         as landmarks, by the constellations that they form (`rocks`)

Every way gives peaks with a z of its own. What chance does to a way in this gate, on this ground,
its lower peaks show, since all but one of them are wrong. The evidence of a peak is therefore

    e = max(z / median(z of the way's lower peaks) - 1, 0),

0 for what looks like the rest. Peaks of different ways that are the same place and azimuth make one
hypothesis, and their evidence adds up: where ways agree they rank first. Rocks take the longest to
find and are asked only if the first two ways do not agree on a clear winner.

The more hypotheses are tried, the better the best of the wrong ones does by chance. As all that are
tried and fail count as chance in the verdict (`links`), that raises its bar by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    BirdsEyeParams,
    BirdsEyeView,
    PlaneFit,
    SearchGate,
    place_on,
)
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.hypotheses.correlation import correlate_views
from solmap.photogrammetry.matching.cross_site.hypotheses.features import (
    FeatureParams,
    find_features,
    match_features,
)
from solmap.photogrammetry.matching.cross_site.hypotheses.rocks import (
    RockParams,
    find_rocks,
    match_rocks,
)
from solmap.photogrammetry.matching.cross_site.hypotheses.voting import VotedPlace
from solmap.photogrammetry.ranges import Few

CORRELATION, FEATURES, ROCKS = "correlation", "features", "rocks"


LEAST_LEVEL = 3.0
"""z that chance is never taken to stay below: one place in 700 reaches it."""


SAME_M = 0.75
"""Peaks of two ways nearer than this,"""


SAME_AZIMUTH = 0.026
"""and not turned against each other by more than this, are one (radians: 1.5 degrees)."""


CLEAR = 1.5
"""Evidence of two agreeing ways, over that of the next hypothesis, at which no third is asked:
each stands out almost twice as far as chance."""


@dataclass(frozen=True, slots=True)
class HypothesisParams:
    """How hypotheses are found, and how many are handed on."""

    wide_baseline: FeatureParams = field(default_factory=FeatureParams)
    rocks: RockParams = field(default_factory=RockParams)
    most: Few = 4
    """Hypotheses handed on."""

    def __post_init__(self) -> None:
        if self.most < 1:
            raise MatchingError(f"hypotheses need 1 or more to be tried, not {self.most}")


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """Where the later stop may stand, and what speaks for it."""

    fit: PlaneFit
    """Of the way that speaks for it most."""
    evidence: float
    found_by: tuple[str, ...]
    """The ways that found it, most evidence first."""


@dataclass(frozen=True, slots=True, eq=False)
class Peak:
    """A peak of one way."""

    fit: PlaneFit
    way: str
    evidence: float


def find_hypotheses(
    one: StopViews,
    other: StopViews,
    gate: SearchGate,
    birds_eye: BirdsEyeParams,
    params: HypothesisParams,
) -> list[Hypothesis]:
    """The best hypotheses of where the later stop stands on the earlier one, best first."""
    peaks: list[Peak] = []
    for way, find in FINDERS.items():
        if not _is_clear(merge_peaks(peaks)):
            found = rank_peaks(way, find(one, other, gate, birds_eye, params))
            peaks += [p for p in found if p.fit.overlap_m2 > birds_eye.min_overlap_m2]
    return merge_peaks(peaks)[: params.most]


def merge_peaks(peaks: Sequence[Peak]) -> list[Hypothesis]:
    """Peaks that are the same place put together, most evidence first."""
    groups: list[list[Peak]] = []
    for peak in sorted(peaks, key=lambda p: (-p.evidence, -p.fit.z)):
        for group in groups:
            known = {member.way for member in group}
            if peak.way not in known and _same(group[0].fit, peak.fit):
                group.append(peak)
                break
        else:
            groups.append([peak])
    found = [
        Hypothesis(
            replace(group[0].fit, z=max(p.fit.z for p in group)),
            sum(p.evidence for p in group),
            tuple(p.way for p in group),
        )
        for group in groups
    ]
    return sorted(found, key=lambda h: (-h.evidence, -h.fit.z))


def _same(a: PlaneFit, b: PlaneFit) -> bool:
    apart_m = np.hypot(a.north_m - b.north_m, a.east_m - b.east_m)
    return bool(apart_m < SAME_M and abs(a.azimuth - b.azimuth) < SAME_AZIMUTH)


def _is_clear(found: Sequence[Hypothesis]) -> bool:
    """Whether two ways agree on a hypothesis, and no other comes near it."""
    if not found or len(found[0].found_by) < 2:  # noqa: PLR2004 - two ways
        return False
    next_best = found[1].evidence if len(found) > 1 else 0.0
    return found[0].evidence - next_best > CLEAR


def rank_peaks(way: str, fits: Sequence[PlaneFit]) -> list[Peak]:
    """The peaks of a way, each with its evidence against the lower ones."""
    lower = [fit.z for fit in fits[1:]]
    level = max(float(np.median(lower)) if lower else 0.0, LEAST_LEVEL)
    return [Peak(fit, way, max(fit.z / level - 1, 0.0)) for fit in fits]


def by_correlation(
    one: StopViews,
    other: StopViews,
    gate: SearchGate,
    birds_eye: BirdsEyeParams,
    _params: HypothesisParams,
) -> list[PlaneFit]:
    """Peaks of the correlation of both views."""
    return correlate_views(one.birds_eye, other.birds_eye, gate, birds_eye)


def by_features(
    one: StopViews,
    other: StopViews,
    gate: SearchGate,
    birds_eye: BirdsEyeParams,
    params: HypothesisParams,
) -> list[PlaneFit]:
    """Places that matched features vote for."""
    wide = params.wide_baseline
    first, second = (find_features(stop.birds_eye, birds_eye, wide) for stop in (one, other))
    elected = match_features(first, second, gate, birds_eye.peaks, wide)
    return [_fit_at(place, one.birds_eye, other.birds_eye) for place in elected]


def by_rocks(
    one: StopViews,
    other: StopViews,
    gate: SearchGate,
    birds_eye: BirdsEyeParams,
    params: HypothesisParams,
) -> list[PlaneFit]:
    """Places that rocks vote for."""
    first, second = (find_rocks(stop.stop, stop.birds_eye, params.rocks) for stop in (one, other))
    elected = match_rocks(first, second, gate, birds_eye.peaks, params.rocks)
    return [_fit_at(place, one.birds_eye, other.birds_eye) for place in elected]


Finder = Callable[
    [StopViews, StopViews, SearchGate, BirdsEyeParams, HypothesisParams], list[PlaneFit]
]
FINDERS: dict[str, Finder] = {CORRELATION: by_correlation, FEATURES: by_features, ROCKS: by_rocks}
"""In the order in which they are asked."""


def _fit_at(place: VotedPlace, earlier: BirdsEyeView, later: BirdsEyeView) -> PlaneFit:
    """An elected place with the drop and the area of the ground that both views share there."""
    where = (place.azimuth, place.north_m, place.east_m)
    over = place_on(later.elevation, later.cell_m, *where)
    drop = (over - earlier.elevation)[np.isfinite(over) & np.isfinite(earlier.elevation)]
    down_m = float(np.median(drop)) if len(drop) else 0.0
    return PlaneFit(*where, down_m, place.z, len(drop) * earlier.cell_m**2)
