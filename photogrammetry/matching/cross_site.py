"""Cross-site ties: the ground that two stops have both seen, found without a hand.

1. Telemetry says where the later rover stands in the earlier one, to some per cent of the drive and
   a degree or two of azimuth (Di et al. 2008, section 1 and table 1). That is the gate
   (`cross_site_gate`).
2. Bird's-eye views of both stops are correlated over the gate, and landmarks on them vote for
   places (`hypotheses`). The best are hypotheses of the horizontal pose; the drop follows from the
   elevations of the common ground and the tilt from telemetry, which gravity holds to tenths of a
   degree.
3. Under every hypothesis the sparse matches of each stop are predicted into the pairs of the other
   one and looked for there, and a robust rigid alignment counts how many agree in space
   (`cross_site_trials`).
4. The best hypothesis is tried again from its own alignment, with a window of a few cells, and so
   is its strongest rival: a wrong hypothesis, or a decoy, measures what chance can do.
5. Ties are measured again in the original images (`tie_refinement`); those that hardly share their
   ground (`shared_ground`) are handed on.
6. The link stands if its ties are many, well spread and far more than chance found; if not, the
   verdict says why. A wrong link is worse than none.
7. Where it stands, the shape of the ground ties it further (`surface_ties`): it knows the bearings
   between stops better than the looks of the ground do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.matching.alignment import Alignment
from solmap.photogrammetry.matching.birds_eye import BirdsEyeParams, PlaneFit
from solmap.photogrammetry.matching.cross_site_gate import GateParams, gate_between
from solmap.photogrammetry.matching.cross_site_trials import (
    LEAST_TO_ALIGN,
    Trial,
    TrialParams,
    Trials,
    decoys,
)
from solmap.photogrammetry.matching.hypotheses import HypothesisParams, hypotheses
from solmap.photogrammetry.matching.records import MatchedStop, Ties, joined
from solmap.photogrammetry.matching.shared_ground import (
    counted_as_one,
    spread_out,
    weighed_down,
    with_shared_errors,
)
from solmap.photogrammetry.matching.site_links import (
    SiteLink,
    SiteLinkFigures,
    distance_m,
    figures_of,
    places_of,
    unlinked,
)
from solmap.photogrammetry.matching.stop_views import StopViews
from solmap.photogrammetry.matching.surface_ties import SurfaceTieParams, tie_by_shape
from solmap.photogrammetry.matching.surface_views import SurfaceView
from solmap.photogrammetry.matching.tie_refinement import pointed



@dataclass(frozen=True, slots=True)
class VerdictParams:
    """When a link is believed."""

    least_ties: int = 20
    """The paper's example had 7, made by hand; 20 and more hold the drift (issue 4)."""
    least_z: float = 6.0
    """A gate holds some 10^5 independent places: chance comes to 4.8, and to 6 once in 5000."""
    chance_factor: float = 2.0
    """A link needs so many times the ties that a wrong hypothesis found,"""
    chance_sigmas: float = 4.0
    """and as many more as four standard deviations of a count that happens by chance."""
    least_share: float = 0.5
    """Of the conjugates measured in the narrow window, so many must agree in space."""
    least_spread_m: float = 1.0
    """Standard deviation of the ties' places across their longest direction."""

    def __post_init__(self) -> None:
        if self.least_ties < LEAST_TO_ALIGN or self.chance_factor < 1:
            raise MatchingError(
                f"a link of {self.least_ties} ties and {self.chance_factor} times chance is no link"
            )


@dataclass(frozen=True, slots=True)
class CrossSiteParams:
    """How stops are linked, and when a link is believed."""

    gate: GateParams = field(default_factory=GateParams)
    birds_eye: BirdsEyeParams = field(default_factory=BirdsEyeParams)
    hypotheses: HypothesisParams = field(default_factory=HypothesisParams)
    trials: TrialParams = field(default_factory=TrialParams)
    by_shape: SurfaceTieParams = field(default_factory=SurfaceTieParams)
    verdict: VerdictParams = field(default_factory=VerdictParams)
    apart: float = 0.75
    """Least distance of ties that are handed on, in widths of their patches: they share a quarter
    of their ground at most along either axis, and nearly count as independent."""


def tie_cross_site(
    earlier: MatchedStop | StopViews, later: MatchedStop | StopViews, params: CrossSiteParams
) -> SiteLink:
    """Link two stops by the ground that both have seen, or say why that cannot be done."""
    one, other = (
        s if isinstance(s, StopViews) else StopViews.of(s, params.birds_eye)
        for s in (earlier, later)
    )
    gate, prior = gate_between(one.stop, other.stop, params.gate)
    apart_m = distance_m(one, other)
    if apart_m - gate.reach_m > 2 * params.birds_eye.radius_m:
        return unlinked(one, other, f"{apart_m:.0f} m apart, no common ground in reach")
    found = hypotheses(one, other, gate, params.birds_eye, params.hypotheses)
    fits = [hypothesis.fit for hypothesis in found]
    if not fits:
        return unlinked(one, other, "the bird's-eye views share too little ground")
    highest = max(fit.z for fit in fits)
    if highest < params.verdict.least_z:
        return unlinked(one, other, f"no peak stands out (z = {highest:.1f})", fits[0])
    trials = Trials(one, other, prior, params.trials)
    tried = [trials.tried(fit) for fit in fits]
    best = trials.settled(_best(tried, params.trials.separation_m))
    if best.agreeing < params.verdict.least_ties:
        return _judged(trials, best, 0, params)
    wrong = decoys(gate, fits, params.trials.decoys, 2 * params.birds_eye.separation_m)
    return _judged(trials, best, _by_chance(trials, best, tried, wrong), params)


def _best(tried: list[Trial], separation_m: float) -> Trial:
    """The trial that most agree with; of those that ended there too, the one of the best peak."""
    most = max(tried, key=lambda trial: trial.agreeing)
    same = (t for t in tried if t.alignment and not t.elsewhere(most, separation_m))
    return next(same, most)


def _by_chance(trials: Trials, best: Trial, tried: list[Trial], wrong: Sequence[PlaneFit]) -> int:
    """Ties that the strongest trial of another place comes to when it is settled as well.

    A trial may start elsewhere and still settle at the place of the best: that is no other place.
    Where no hypothesis is another place, decoys show what chance can do.
    """
    separation_m = trials.params.separation_m
    others = [trial for trial in tried if trial.elsewhere(best, separation_m)]
    others.sort(key=lambda trial: trial.agreeing, reverse=True)
    for rival in chain(others, map(trials.tried, wrong)):
        settled = trials.settled(rival)
        if settled.elsewhere(best, separation_m):
            return settled.agreeing
    return 0


def _judged(trials: Trials, trial: Trial, by_chance: int, params: CrossSiteParams) -> SiteLink:
    """The link of a settled trial, or why it is none."""
    one, other = trials.one, trials.other
    fine = trials.refined(trial)
    if trial.alignment is None or fine.alignment is None:
        return unlinked(one, other, "the conjugates could not be aligned", trial.fit)
    figures = figures_of(one, other, fine.fit, fine.ties, fine.alignment)
    figures = replace(figures, measured=len(trial.ties), by_chance=by_chance)
    linked, reason = verdict(figures, params.verdict)
    if not linked:
        return unlinked(one, other, reason, trial.fit, figures)
    agrees = fine.alignment.agrees
    ties, width_m = fine.ties.taking(agrees), fine.width_m[agrees]
    places = (places_of(one, ties) @ one.stop.lsl_from_rover.rotation.T)[:, :2]
    weighed = weighed_down(ties, counted_as_one(places, width_m))
    final = trials.aligned(weighed, fine.alignment.first_from_second) or fine.alignment
    some = spread_out(places, width_m, params.apart, params.verdict.least_ties)
    by_looks = with_shared_errors(
        weighed_down(ties.taking(some), counted_as_one(places[some], width_m[some])),
        {v.view.pair.pair_id: v.view.geometry for v in (*one.views, *other.views)},
    )
    by_shape = _by_shape(one, other, final, params.by_shape)
    figures = replace(figures, handed_on=int(some.sum()), by_shape=len(by_shape))
    if len(by_shape):
        reason += f", {len(by_shape)} more by the shape of the ground"
    return SiteLink(
        one.id,
        other.id,
        linked,
        reason,
        joined([by_looks, by_shape], by_looks.pair_ids),
        final.first_from_second,
        final.covariance,
        figures,
        trial.fit,
    )


def _by_shape(
    one: StopViews, other: StopViews, alignment: Alignment, params: SurfaceTieParams
) -> Ties:
    """Ties by the shape of the ground, from where ties by looks have placed the stops."""
    if not params.enabled:
        return Ties.none((*one.pair_ids, *other.pair_ids))
    level = Pose(LSL, one.id.frame, one.stop.lsl_from_rover.rotation, np.zeros(3))
    frames = (level, level @ alignment.first_from_second)
    earlier, later = (
        {
            view.pair.pair_id: SurfaceView.of(
                view.geometry,
                view.pair.parallax,
                frame @ pointed(view, alignment),
                params.surface.half_px,
            )
            for view in (ground.view for ground in stop.views)
        }
        for stop, frame in zip((one, other), frames, strict=True)
    )
    return tie_by_shape(earlier, later, params)


def verdict(figures: SiteLinkFigures, params: VerdictParams) -> tuple[bool, str]:
    """(linked, reason)."""
    share = figures.ties / max(figures.measured, 1)
    if figures.ties < params.least_ties:
        return False, f"{figures.ties} ties, {params.least_ties} are needed"
    chance = figures.by_chance + params.chance_sigmas * figures.by_chance**0.5
    if figures.ties < max(chance, params.chance_factor * figures.by_chance):
        return False, f"{figures.ties} ties, where a wrong place gets {figures.by_chance} by chance"
    if share < params.least_share:
        return False, f"only {share:.0%} of {figures.measured} conjugates agree in space"
    if figures.spread_m < params.least_spread_m:
        return False, f"the ties lie on a line, {figures.spread_m:.1f} m wide"
    return True, (
        f"{figures.ties} ties of {figures.measured} conjugates, rms {figures.rms_px:.2f} px, "
        f"{figures.by_chance} by chance"
    )
