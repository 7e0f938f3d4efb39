"""Link two stops: automatic cross-site ties on their common ground.

1. Telemetry gives the position of the later rover in the frame of the earlier one, usually to some
   per cent of the drive and a degree or two of azimuth (Di et al. 2008, section 1 and table 1).
   That is the search gate (`gate`), widened by stages for slipping wheels.
2. Bird's-eye views of both stops, heights first, are correlated over the gate until a peak is
   significant (`hypotheses`). The best peaks are hypotheses of the horizontal pose; the height
   difference follows from the elevations of the common ground, the tilt from telemetry, which is
   accurate to tenths of a degree by gravity.
3. Under every hypothesis the surface of the later stop is registered to that of the earlier one
   (`surface_alignment`), by heights and by brightness. Where relief correlates far better than
   anywhere else, surfaces decide: blocks of ground become surface-matched ties
   (`surface_matching`), which determine bearing, range and height, and image-matched ties (5.) are
   added if their pose agrees. Under opposite suns lit faces and shadows are interchanged, and
   image-matched ties may be decimetres off.
4. Where relief is too low to decide, the sparse matches of each stop are predicted into the pairs
   of the other one (`candidates`) and matched there on the ground (`image_matching`), and a robust
   rigid alignment counts how many agree in space (`alignment`). The best hypothesis is tested again
   from its own alignment, with a window of a few cells, and so is the second best: a wrong
   hypothesis, or a decoy, shows how many ties agree by chance. Decoys are positions inside the gate
   without a peak, tested in exactly the same way.
5. Ties are measured again in the original images (`image_matching`); nearly independent ones are
   returned, with standard deviations that include their correlation (`tie_weights`).
6. The link is accepted if its ties are many, well spread and far more than by chance. If not, or if
   they determine the position less well, a peak of the search that cannot be random is the link,
   accurate to decimetres (`peak`). Otherwise the reason is returned (`links`). A wrong link is
   worse than none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import Flags
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.alignment import Alignment, AlignmentParams, align
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    SEPARATION_M,
    BirdsEyeParams,
    PlaneFit,
    SearchGate,
)
from solmap.photogrammetry.matching.cross_site.candidates import (
    FIRST_GAP_M,
    LAST_GAP_M,
    CandidateParams,
    plan_searches,
)
from solmap.photogrammetry.matching.cross_site.gate import (
    GateParams,
    PoseCovariance,
    level_pose,
    pose_from_fit,
    search_stages,
)
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.hypotheses.search import (
    find_hypotheses,
)
from solmap.photogrammetry.matching.cross_site.image_matching import (
    GroundMatchingParams,
    GroundTies,
    match_ground,
    refine_ties,
)
from solmap.photogrammetry.matching.cross_site.light import mean_sun, sun_difference
from solmap.photogrammetry.matching.cross_site.links import (
    LEAST_TO_ALIGN,
    SIGNIFICANT_Z,
    LinkTestParams,
    SiteLink,
    distance_m,
    evaluate_link,
    link_figures,
    refused_link,
    tie_places,
)
from solmap.photogrammetry.matching.cross_site.peak import common_ground, peak_covariance
from solmap.photogrammetry.matching.cross_site.surface_alignment import RELIEF
from solmap.photogrammetry.matching.cross_site.surface_matching import (
    CERTAIN,
    SurfaceTieParams,
    tie_by_pose,
    tie_by_surface,
    try_shapes,
)
from solmap.photogrammetry.matching.cross_site.tie_weights import (
    add_shared_errors,
    inflate_sigmas,
    overlap_counts,
    select_spread,
)
from solmap.photogrammetry.matching.records import MatchedStop, Ties, join_ties
from solmap.photogrammetry.ranges import FactorOrZero, FewOrZero, Metres

AGREES = 16.8
"""99 % point of chi-square with 6 degrees of freedom."""


@dataclass(frozen=True, slots=True)
class TrialParams:
    """How hypotheses are tested."""

    candidates: CandidateParams = field(default_factory=CandidateParams)
    ground: GroundMatchingParams = field(default_factory=GroundMatchingParams)
    alignment: AlignmentParams = field(default_factory=AlignmentParams)
    decoys: FewOrZero = 2
    """Number of wrong positions that are tested too, to count ties by chance."""
    separation_m: Metres = 0.75
    """Distance below which two tests ended at the same position."""

    def __post_init__(self) -> None:
        if self.decoys < 0 or self.separation_m <= 0:
            raise MatchingError(
                f"trials need 0 or more decoys and a separation above zero, not {self.decoys} and "
                f"{self.separation_m} m"
            )


@dataclass(frozen=True, slots=True)
class CrossSiteParams:
    """How stops are linked, and when a link is accepted."""

    gate: GateParams = field(default_factory=GateParams)
    birds_eye: BirdsEyeParams = field(default_factory=BirdsEyeParams)
    trials: TrialParams = field(default_factory=TrialParams)
    surface_matching: SurfaceTieParams = field(default_factory=SurfaceTieParams)
    link_test: LinkTestParams = field(default_factory=LinkTestParams)
    apart: FactorOrZero = 0.75
    """Least distance of returned ties, in widths of their patches: they share at most a quarter of
    their ground along either axis, and are nearly independent."""


def prepare_stop(stop: MatchedStop, params: CrossSiteParams) -> StopViews:
    """A stop with everything that all its links need."""
    views = StopViews.of(stop, params.birds_eye)
    if params.surface_matching.enabled:
        heights = views.heights(params.surface_matching.surface)
        for relief, sigma_m in RELIEF:
            heights.surface(sigma_m, relief=relief)
    return views


def tie_cross_site(
    earlier: MatchedStop | StopViews, later: MatchedStop | StopViews, params: CrossSiteParams
) -> SiteLink:
    """Link two stops by their common ground, or give the reason why not."""
    one, other = (
        s if isinstance(s, StopViews) else prepare_stop(s, params) for s in (earlier, later)
    )
    stages = search_stages(one.stop, other.stop, params.gate, params.birds_eye.radius_m)
    if not stages:
        apart_m = distance_m(one, other)
        return refused_link(one, other, f"{apart_m:.0f} m apart, no common ground in reach")
    views, least_z = (one.birds_eye, other.birds_eye), params.link_test.least_z
    found = find_hypotheses(*views, stages, params.birds_eye, least_z)
    fits, gate = found.fits, found.gate
    if not fits:
        return refused_link(one, other, "the bird's-eye views share too little ground")
    if found.highest < least_z:
        return refused_link(one, other, f"no significant peak (z = {found.highest:.1f})", fits[0])
    trials = Trials(one, other, found.prior, params.trials)
    wrong = decoys(gate, fits, params.trials.decoys, 2 * SEPARATION_M)
    if params.surface_matching.enabled:
        link = _link_by_surfaces(trials, fits, wrong, params)
        if link is not None:
            return link
    tried = [trials.try_fit(fit) for fit in fits]
    is_clear = found.highest >= params.link_test.clear_z
    best = tried[0] if is_clear else _best(tried, params.trials.separation_m)
    best = trials.settle(best)
    is_enough = best.agreeing >= params.link_test.needed(trials.peak_of(best))
    by_chance = _count_by_chance(trials, best, tried, wrong) if is_enough else 0
    link = _evaluate(trials, best, by_chance, params)
    is_single = all(fit.z < least_z for fit in fits[1:])
    if not (is_clear and is_single):
        return link
    by_peak = _link_by_peak(trials, fits[0], link.reason, params)
    return min(link, by_peak, key=lambda some: _plan_sigma_m(one, some))


def _plan_sigma_m(earlier: StopViews, link: SiteLink) -> float:
    """Standard deviation of the position in plan, metres; infinite without a link."""
    to_plan = earlier.stop.lsl_from_rover.rotation[:2]
    plan = to_plan @ link.covariance[3:, 3:] @ to_plan.T
    return float(np.trace(plan)) ** 0.5 if link.linked else np.inf


def _link_by_peak(
    trials: Trials, fit: PlaneFit, by_images: str, params: CrossSiteParams
) -> SiteLink:
    """The link of a peak that cannot be random.

    `by_images` describes the link by images, or states why there is none; the reason repeats it.
    """
    one, other = trials.one, trials.other
    stops, surfaces = (one.stop, other.stop), params.surface_matching
    pose = pose_from_fit(*stops, fit)
    level = level_pose(*stops, pose)
    places = common_ground(one.birds_eye, other.birds_eye, fit, surfaces.block_m)
    places = places[:: max(1, math.ceil(len(places) / surfaces.most))]
    covariance = peak_covariance(level, places, sun_difference(*map(mean_sun, stops)))
    ties = tie_by_pose(stops, places, level, covariance, surfaces.least)
    if not len(ties):
        return refused_link(one, other, by_images, fit)
    axes = np.kron(np.eye(2), one.stop.lsl_from_rover.rotation.T)
    reason = f"by a peak of {fit.z:.1f} sigma alone (images: {by_images})"
    link = _linked(trials, fit, pose, axes @ covariance @ axes.T, ties, reason)
    return replace(link, figures=replace(link.figures, by_shape=len(ties)))


def _linked(
    trials: Trials,
    fit: PlaneFit,
    pose: Pose,
    covariance: PoseCovariance,
    ties: Ties,
    reason: str,
) -> SiteLink:
    """A link by a pose of rover to rover and ties that determine it."""
    one, other = trials.one, trials.other
    every, off2 = np.ones(len(ties), dtype=bool), np.zeros(len(ties))
    final = Alignment(pose, covariance, {}, off2, every, sigma0=1.0, rms_px=0.0)
    figures = link_figures(one, other, fit, ties, final)
    return SiteLink(
        one.id,
        other.id,
        linked=True,
        reason=reason,
        ties=ties,
        earlier_from_later=pose,
        covariance=covariance,
        figures=figures,
        fit=fit,
    )


def _link_by_surfaces(
    trials: Trials, fits: Sequence[PlaneFit], wrong: Sequence[PlaneFit], params: CrossSiteParams
) -> SiteLink | None:
    """The link of stops whose surfaces agree beyond doubt; None otherwise."""
    one, other, surfaces = trials.one, trials.other, params.surface_matching
    stops = (one.stop, other.stop)
    first, second = (views.heights(surfaces.surface) for views in (one, other))
    starts, elsewhere = (
        [level_pose(*stops, pose_from_fit(*stops, fit)) for fit in some] for some in (fits, wrong)
    )
    needed = CERTAIN / 2 if fits[0].z >= SIGNIFICANT_Z else CERTAIN
    shape = try_shapes(
        (first, second), starts, elsewhere, SEPARATION_M, surfaces.surface, first_needs=needed
    )
    if shape is None:
        return None
    found = shape.found
    ties = tie_by_surface(stops, found, surfaces)
    if not len(ties):
        return None
    turn = one.stop.lsl_from_rover.rotation.T
    pose = Pose(
        one.id.frame,
        other.id.frame,
        turn @ found.pose.rotation @ other.stop.lsl_from_rover.rotation,
        turn @ found.pose.translation_m,
    )
    axes = np.kron(np.eye(2), turn)
    covariance = axes @ (found.covariance + _pointing(stops, found.pose, params)) @ axes.T
    apart = [np.linalg.norm(p.translation_m - found.pose.translation_m) for p in starts]
    fit = fits[int(np.argmin(apart))]
    trial = trials.settle_at(fit, pose)
    fine = trials.refine(trial)
    reason, images = f"{shape}, {len(ties)} blocks", Ties.none(ties.pair_ids)
    if fine.agreeing >= LEAST_TO_ALIGN and fine.alignment is not None:
        images, aligned = _thin(trials, fine, fine.alignment, params)
        off, off_m = _differ(aligned, pose, covariance)
        reason += f"; {len(images)} image-matched ties "
        if off > AGREES:
            reason += f"rejected: {off_m:.2f} m and {off**0.5:.1f} sigma away"
            images = Ties.none(ties.pair_ids)
        else:
            reason += "agree"
    used = join_ties([images, ties], ties.pair_ids)
    link = _linked(trials, fit, pose, covariance, used, reason)
    figures = replace(
        link.figures,
        measured=len(trial.ties) + len(ties),
        handed_on=len(images),
        by_shape=len(ties),
        rms_px=fine.alignment.rms_px if fine.alignment else 0.0,
        height_bias_lines=found.height_bias.lines,
        height_bias_sigma=found.height_bias.sigma,
        expected_bias_lines=found.expected_bias.lines,
        expected_bias_sigma=found.expected_bias.sigma,
    )
    return replace(link, figures=figures)


def _pointing(
    stops: tuple[MatchedStop, MatchedStop], pose: Pose, params: CrossSiteParams
) -> PoseCovariance:
    """Covariance of the pose between both stops by their mean pointing errors."""
    sigma = params.trials.alignment.pointing_sigma
    t = pose.translation_m
    cross = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    earlier, later = np.vstack([np.eye(3), -cross]), np.vstack([np.eye(3), np.zeros((3, 3))])
    parts = zip((earlier, later), stops, strict=True)
    return np.sum([sigma**2 / len(stop.pairs) * by @ by.T for by, stop in parts], axis=0)


def _differ(one: Alignment, pose: Pose, covariance: PoseCovariance) -> tuple[float, float]:
    """(squared Mahalanobis length, metres) of the difference between an alignment and a pose."""
    found = one.first_from_second
    turn = ScipyRotation.from_matrix(found.rotation @ pose.rotation.T).as_rotvec()
    off = np.concatenate([turn, found.translation_m - pose.translation_m])
    length2 = float(off @ np.linalg.solve(one.covariance + covariance, off))
    return length2, float(np.linalg.norm(off[3:]))


def _best(tried: list[Trial], separation_m: float) -> Trial:
    """The test with most agreeing ties; of those at the same position, the one of the best peak."""
    most = max(tried, key=lambda trial: trial.agreeing)
    same = (t for t in tried if t.alignment and not t.differs_from(most, separation_m))
    return next(same, most)


def _count_by_chance(
    trials: Trials, best: Trial, tried: list[Trial], wrong: Sequence[PlaneFit]
) -> int:
    """Number of ties of the best test of another position, after its final search.

    A test may start elsewhere and still end at the position of the best; it then does not count as
    another. Where no hypothesis is at another position, decoys are used.
    """
    separation_m = trials.params.separation_m
    others = [trial for trial in tried if trial.differs_from(best, separation_m)]
    others.sort(key=lambda trial: trial.agreeing, reverse=True)
    for rival in chain(others, map(trials.try_fit, wrong)):
        settled = trials.settle(rival)
        if settled.differs_from(best, separation_m):
            return settled.agreeing
    return 0


def _evaluate(trials: Trials, trial: Trial, by_chance: int, params: CrossSiteParams) -> SiteLink:
    """The link of a final test, or the reason why there is none."""
    one, other = trials.one, trials.other
    fine = trials.refine(trial)
    if trial.alignment is None or fine.alignment is None:
        return refused_link(one, other, "the conjugates could not be aligned", trial.fit)
    figures = link_figures(one, other, fine.fit, fine.ties, fine.alignment)
    peak_z = trials.peak_of(trial)
    figures = replace(figures, measured=len(trial.ties), by_chance=by_chance, peak_z=peak_z)
    linked, reason = evaluate_link(figures, params.link_test)
    if not linked:
        return refused_link(one, other, reason, trial.fit, figures)
    ties, final = _thin(trials, fine, fine.alignment, params)
    figures = replace(figures, handed_on=len(ties))
    return SiteLink(
        one.id,
        other.id,
        linked,
        reason,
        ties,
        final.first_from_second,
        final.covariance,
        figures,
        trial.fit,
    )


def _thin(
    trials: Trials, fine: Trial, alignment: Alignment, params: CrossSiteParams
) -> tuple[Ties, Alignment]:
    """(image-matched ties to return, the alignment by all that agree)."""
    one, other = trials.one, trials.other
    found = fine.found.select(alignment.agrees)
    places = (tie_places(one, found.ties) @ one.stop.lsl_from_rover.rotation.T)[:, :2]
    geometries = {v.view.pair.pair_id: v.view.geometry for v in (*one.views, *other.views)}

    def weighed(rows: Flags) -> Ties:
        ground = found.select(rows)
        alone = inflate_sigmas(ground.ties, overlap_counts(places[rows], ground.width_m))
        return add_shared_errors(alone, geometries, ground.by_light_px)

    every = np.ones(len(found), dtype=bool)
    final = trials.align(weighed(every), alignment.first_from_second) or alignment
    some = select_spread(places, found.width_m, params.apart, params.link_test.least_ties)
    return weighed(some), final


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A hypothesis after its test in the images."""

    fit: PlaneFit
    found: GroundTies
    alignment: Alignment | None

    @property
    def ties(self) -> Ties:
        """All ties that were found."""
        return self.found.ties

    @property
    def agreeing(self) -> int:
        """Ties that agree in space."""
        return int(self.alignment.agrees.sum()) if self.alignment else 0

    def differs_from(self, other: Trial, separation_m: float) -> bool:
        """Whether two tests ended at different positions: neighbours may find the same."""
        if self.alignment is None or other.alignment is None:
            return False
        here, there = (a.first_from_second.translation_m for a in (self.alignment, other.alignment))
        return bool(np.linalg.norm(here - there) > separation_m)


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """Two stops between which hypotheses are tested."""

    one: StopViews
    other: StopViews
    prior: PoseCovariance
    params: TrialParams

    def peak_of(self, trial: Trial) -> float:
        """The peak of the hypothesis whose position a test confirmed; 0 if it ended elsewhere."""
        if trial.alignment is None:
            return 0.0
        pose = trial.alignment.first_from_second
        level = level_pose(self.one.stop, self.other.stop, pose).translation_m
        off_m = np.hypot(level[0] - trial.fit.north_m, level[1] - trial.fit.east_m)
        return trial.fit.z if off_m <= self.params.separation_m else 0.0

    def try_fit(self, fit: PlaneFit) -> Trial:
        """Search for some conjugates under a hypothesis and align by them."""
        candidates = self.params.candidates
        pose = pose_from_fit(self.one.stop, self.other.stop, fit)
        dense_sigma_px = candidates.parallax_sigma_px
        return self._trial(fit, pose, FIRST_GAP_M, candidates, dense_sigma_px)

    def settle(self, trial: Trial) -> Trial:
        """Match all candidates from the test's own alignment, in the window of its uncertainty."""
        if trial.alignment is None:
            return trial
        return self.settle_at(trial.fit, trial.alignment.first_from_second)

    def settle_at(self, fit: PlaneFit, pose: Pose) -> Trial:
        """Match all candidates from a pose, in the window of an alignment's uncertainty."""
        candidates = replace(self.params.candidates, most=self.params.candidates.most_at_last)
        return self._trial(fit, pose, LAST_GAP_M, candidates, None)

    def refine(self, trial: Trial) -> Trial:
        """Measure the agreeing ties again, in the original images, and align by them."""
        if trial.alignment is None:
            return trial
        agrees = trial.alignment.agrees
        views = {v.view.pair.pair_id: v.view for v in (*self.one.views, *self.other.views)}
        ties = refine_ties(
            trial.ties.select(agrees),
            views,
            trial.alignment,
            self.params.ground.parallax,
        )
        alignment = self.align(ties, trial.alignment.first_from_second)
        return Trial(trial.fit, replace(trial.found.select(agrees), ties=ties), alignment)

    def _trial(
        self,
        fit: PlaneFit,
        pose: Pose,
        gap_m: float,
        candidates: CandidateParams,
        dense_sigma_px: float | None,
    ) -> Trial:
        """Conjugates under a rover-to-rover pose, and the alignment by them."""
        level = level_pose(self.one.stop, self.other.stop, pose)
        forth, back = plan_searches(self.one.views, self.other.views, level, gap_m, candidates)
        pair_ids = (*self.one.pair_ids, *self.other.pair_ids)
        found = match_ground(forth, back, self.params.ground, pair_ids, dense_sigma_px)
        return Trial(fit, found, self.align(found.ties, pose))

    def align(self, ties: Ties, pose: Pose) -> Alignment | None:
        """The robust alignment by some ties, None if there are too few."""
        if len(ties) < LEAST_TO_ALIGN:
            return None
        views = (*self.one.views, *self.other.views)
        geometries = {v.view.pair.pair_id: v.view.geometry for v in views}
        return align(ties, geometries, pose, self.prior, self.params.alignment)


def decoys(
    gate: SearchGate, fits: Sequence[PlaneFit], number: int, clear_m: float
) -> list[PlaneFit]:
    """Positions on the rim of a circle around the best fit, far from every peak of the search."""
    best, radius = fits[0], max(2 * clear_m, 0.5 * gate.reach_m)
    around = []
    for angle in np.linspace(0.6, 0.6 + 2 * np.pi, 8 * number, endpoint=False):
        north = best.north_m + radius * float(np.cos(angle))
        east = best.east_m + radius * float(np.sin(angle))
        if min(np.hypot(f.north_m - north, f.east_m - east) for f in fits) > clear_m:
            around.append(PlaneFit(best.azimuth, north, east, best.down_m, 0.0, best.overlap_m2))
    step = max(len(around) // max(number, 1), 1)
    return around[::step][:number]
