"""Cross-site ties: the ground that two stops have both seen, found without a hand.

1. Telemetry says where the later rover stands in the earlier one, to some per cent of the drive and
   a degree or two of azimuth (Di et al. 2008, section 1 and table 1). That is the gate.
2. Bird's-eye views of both stops are correlated over the gate (`birds_eye`). The highest peaks are
   hypotheses of the horizontal pose; the drop follows from the elevations of the common ground and
   the tilt from telemetry, which gravity holds to tenths of a degree.
3. Under every hypothesis the sparse matches of each stop are predicted into the pairs of the other
   one and looked for there, patch by patch over the local surface, in the original epipolar images
   (`conjugates`), and a robust rigid alignment counts how many agree in space (`alignment`). The
   hypotheses that are wrong measure what chance can do, and so do decoys: places inside the
   gate where no peak was, tried in exactly the same way.
4. The best hypothesis is tried again from its own alignment, with a window of a few pixels.
5. The link stands if its ties are many, well spread and far more than chance found; if not, the
   verdict says why. A wrong link is worse than none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from photogrammetry.arrays import Float64, ObjectPoints
from photogrammetry.errors import MatchingError
from photogrammetry.frames import Pose, rotation_of_roll_pitch_yaw
from photogrammetry.imagery import StopId
from photogrammetry.matching.alignment import Alignment, AlignmentParams, align
from photogrammetry.matching.birds_eye import (
    BirdsEyeParams,
    BirdsEyeView,
    PlaneFit,
    SearchGate,
    birds_eye_view,
    search,
)
from photogrammetry.matching.conjugates import ConjugateParams
from photogrammetry.matching.cross_site_candidates import Candidates, Gap, tie_candidates
from photogrammetry.matching.ground_patches import GroundSurface, GroundView
from photogrammetry.matching.records import MatchedStop
from photogrammetry.matching.tie_views import TieView
from photogrammetry.matching.ties import Ties

LEAST_TO_ALIGN = 6
"""Ties for the six unknowns of a pose with some redundancy."""


@dataclass(frozen=True, slots=True)
class CrossSiteParams:
    """How stops are linked, and when a link is believed."""

    birds_eye: BirdsEyeParams = field(default_factory=BirdsEyeParams)
    conjugates: ConjugateParams = field(default_factory=ConjugateParams)
    alignment: AlignmentParams = field(default_factory=AlignmentParams)
    candidates: Candidates = field(default_factory=Candidates)
    surface_cell_m: float = 0.08
    """Of the elevations that patches are drawn over."""
    slip_sigma: float = 0.08
    """Of the distance between the stops: 3 sigma cover the 4-20 % that wheels slip."""
    position_sigma_m: float = 0.3
    azimuth_sigma: float = 0.026
    """Radians (1.5 degrees): drift of the heading over a drive."""
    tilt_sigma: float = 0.0052
    """Radians (0.3 degrees): roll and pitch from gravity."""
    gate_sigmas: float = 3.0
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
    decoys: int = 2
    shared: float = 2.0
    """Ties that count as one in the covariance: a patch of 17 cells, 1.4 m at 10 m, shares half of
    its ground with the next one, 0.75 m away."""

    def __post_init__(self) -> None:
        if self.least_ties < LEAST_TO_ALIGN or self.chance_factor < 1:
            raise MatchingError(
                f"a link of {self.least_ties} ties and {self.chance_factor} times chance is no link"
            )


@dataclass(frozen=True, slots=True)
class SiteLinkFigures:
    """What speaks for and against a link."""

    distance_m: float
    """Between the stops by telemetry."""
    peak_z: float
    overlap_m2: float
    measured: int
    """Conjugates found with their parallax in the last round."""
    ties: int
    by_chance: int
    """Ties that the strongest wrong hypothesis or decoy came to in the same way."""
    rms_px: float
    sigma0: float
    spread_m: float
    moved_m: tuple[float, float, float]
    """North, east, down by which the link differs from telemetry."""
    turned: float
    """Azimuth by which the link differs from telemetry, radians."""


@dataclass(frozen=True, slots=True, eq=False)
class SiteLink:
    """Whether two stops are linked, by what, and how they stand to each other."""

    earlier: StopId
    later: StopId
    linked: bool
    reason: str
    ties: Ties
    """First the earlier stop's pair, second the later one's; none unless linked."""
    earlier_from_later: Pose
    """Rover to rover: as found if linked, else as telemetry has it."""
    covariance: Float64[np.ndarray, "6 6"]
    """Of rotation vector (radians), then translation (metres), in the earlier rover's axes."""
    figures: SiteLinkFigures
    fit: PlaneFit | None
    """The best peak of the bird's-eye search, kept for pictures."""

    @property
    def verdict(self) -> str:
        """`linked` or `not linked`."""
        return "linked" if self.linked else "not linked"

    def __str__(self) -> str:
        return f"{self.earlier} - {self.later}: {self.verdict}, {self.reason}"


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A hypothesis after it was tried in the images."""

    fit: PlaneFit
    ties: Ties
    alignment: Alignment | None

    @property
    def agreeing(self) -> int:
        return int(self.alignment.agrees.sum()) if self.alignment else 0


@dataclass(frozen=True, slots=True, eq=False)
class StopViews:
    """A stop made ready for linking; worth keeping when it is linked more than once."""

    stop: MatchedStop
    birds_eye: BirdsEyeView
    views: tuple[GroundView, ...]

    @classmethod
    def of(cls, stop: MatchedStop, params: CrossSiteParams) -> StopViews:
        """Draw the stop from above and fit the surfaces around its matches."""
        fine = replace(params.birds_eye, cell_m=params.surface_cell_m)
        surface = GroundSurface.of(birds_eye_view(stop, fine))
        level = stop.lsl_from_rover.rotation
        return cls(
            stop,
            birds_eye_view(stop, params.birds_eye),
            tuple(
                GroundView.of(TieView.of(pair, params.conjugates.half_px), surface, level)
                for pair in stop.pairs
            ),
        )


def tie_cross_site(
    earlier: MatchedStop | StopViews, later: MatchedStop | StopViews, params: CrossSiteParams
) -> SiteLink:
    """Link two stops by the ground that both have seen, or say why that cannot be done."""
    one, other = (
        s if isinstance(s, StopViews) else StopViews.of(s, params) for s in (earlier, later)
    )
    gate, prior = _gate(one.stop, other.stop, params)
    distance_m = float(np.hypot(gate.north_m, gate.east_m))
    if distance_m - gate.reach_m > 2 * params.birds_eye.radius_m:
        return _unlinked(one, other, f"{distance_m:.0f} m apart, no common ground in reach", [])
    fits = search(one.birds_eye, other.birds_eye, gate, params.birds_eye)
    if not fits:
        return _unlinked(one, other, "the bird's-eye views share too little ground", [])
    if fits[0].z < params.least_z:
        return _unlinked(one, other, f"no peak stands out (z = {fits[0].z:.1f})", fits)
    tried = [_try(one, other, fit, prior, params) for fit in (*fits, *_decoys(gate, fits, params))]
    best = max(tried[: len(fits)], key=lambda trial: trial.agreeing)
    if best.alignment is None or best.agreeing < LEAST_TO_ALIGN:
        return _unlinked(one, other, f"only {best.agreeing} conjugates agree in space", fits)
    rival = max(
        (t for t in tried if _elsewhere(t, best, params)), key=lambda t: t.agreeing, default=None
    )
    best = next(t for t in tried if t.alignment and not _elsewhere(t, best, params))
    settled = _settled(one, other, best, prior, params)
    by_chance = _settled(one, other, rival, prior, params).agreeing if rival else 0
    return _judged(one, other, settled, by_chance, params)


def _elsewhere(trial: _Trial, best: _Trial, params: CrossSiteParams) -> bool:
    """Whether a trial ended at another place than the best one: neighbours may find the same."""
    if trial.alignment is None or best.alignment is None:
        return False
    apart = (
        trial.alignment.first_from_second.translation_m
        - best.alignment.first_from_second.translation_m
    )
    return bool(np.linalg.norm(apart) > params.birds_eye.separation_m / 2)


def _gate(
    earlier: MatchedStop, later: MatchedStop, params: CrossSiteParams
) -> tuple[SearchGate, Float64[np.ndarray, "6 6"]]:
    """Where the later rover can stand, and the prior covariance of the pose between both.

    Along a traverse errors add up, so what is uncertain between two stops is the growth of the
    covariance from one to the other; and never less than a drive of this length leaves.
    """
    step = later.lsl_from_rover.translation_m - earlier.lsl_from_rover.translation_m
    distance_m = float(np.hypot(step[0], step[1]))
    growth = np.maximum(np.diag(later.covariance) - np.diag(earlier.covariance), 0.0)
    position = params.slip_sigma * distance_m + params.position_sigma_m
    least = np.array([params.tilt_sigma] * 2 + [params.azimuth_sigma] + [position] * 3) ** 2
    variance = np.maximum(growth, least)
    gate = SearchGate(
        float(step[0]),
        float(step[1]),
        params.gate_sigmas * float(np.sqrt(variance[3:5].max())),
        params.gate_sigmas * float(np.sqrt(variance[2])),
    )
    rotation = earlier.lsl_from_rover.rotation
    axes = np.zeros((6, 6))
    axes[:3, :3] = axes[3:, 3:] = rotation.T
    return gate, axes @ np.diag(variance) @ axes.T


def _decoys(gate: SearchGate, fits: Sequence[PlaneFit], params: CrossSiteParams) -> list[PlaneFit]:
    """Places on the rim of a circle around the best fit, far from every peak of the search."""
    best, radius = fits[0], max(4 * params.birds_eye.separation_m, 0.5 * gate.reach_m)
    around = []
    for angle in np.linspace(0.6, 0.6 + 2 * np.pi, 8 * params.decoys, endpoint=False):
        north = best.north_m + radius * float(np.cos(angle))
        east = best.east_m + radius * float(np.sin(angle))
        clear = min(np.hypot(f.north_m - north, f.east_m - east) for f in fits)
        if clear > 2 * params.birds_eye.separation_m:
            around.append(PlaneFit(best.azimuth, north, east, best.down_m, 0.0, best.overlap_m2))
    step = max(len(around) // max(params.decoys, 1), 1)
    return around[::step][: params.decoys]


def _pose_of(earlier: MatchedStop, later: MatchedStop, fit: PlaneFit) -> Pose:
    """earlier_from_later with the tilt of telemetry and the rest of a bird's-eye fit."""
    level_from_earlier = earlier.lsl_from_rover.rotation
    turn = rotation_of_roll_pitch_yaw(0.0, 0.0, fit.azimuth)
    place = np.array([fit.north_m, fit.east_m, fit.down_m])
    return Pose(
        earlier.stop.frame,
        later.stop.frame,
        level_from_earlier.T @ turn @ later.lsl_from_rover.rotation,
        level_from_earlier.T @ place,
    )


def _try(
    one: StopViews,
    other: StopViews,
    fit: PlaneFit,
    prior: Float64[np.ndarray, "6 6"],
    params: CrossSiteParams,
) -> _Trial:
    """Look for conjugates under a hypothesis and align by them."""
    pose = _pose_of(one.stop, other.stop, fit)
    gap = params.candidates.first_gap
    ties = _candidates(one, other, pose, gap, params)
    return _Trial(fit, ties, _aligned(one, other, ties, pose, prior, params))


def _candidates(
    one: StopViews, other: StopViews, pose: Pose, gap: Gap, params: CrossSiteParams
) -> Ties:
    """Conjugates under a pose of rover to rover."""
    level = Pose(
        pose.target,
        pose.source,
        one.stop.lsl_from_rover.rotation @ pose.rotation @ other.stop.lsl_from_rover.rotation.T,
        one.stop.lsl_from_rover.rotation @ pose.translation_m,
    )
    return tie_candidates(one.views, other.views, level, gap, params.candidates, params.conjugates)


def _aligned(
    one: StopViews,
    other: StopViews,
    ties: Ties,
    pose: Pose,
    prior: Float64[np.ndarray, "6 6"],
    params: CrossSiteParams,
) -> Alignment | None:
    """The robust alignment by some ties, None if there are hardly any."""
    if len(ties) < LEAST_TO_ALIGN:
        return None
    geometries = {v.view.pair.pair_id: v.view.geometry for v in (*one.views, *other.views)}
    return align(ties, geometries, pose, prior, params.alignment)


def _settled(
    one: StopViews,
    other: StopViews,
    trial: _Trial,
    prior: Float64[np.ndarray, "6 6"],
    params: CrossSiteParams,
) -> _Trial:
    """Match again from the trial's own alignment, within a window of what that leaves open."""
    if trial.alignment is None:
        return trial
    pose = trial.alignment.first_from_second
    last = replace(params.candidates, most=params.candidates.most_at_last)
    ties = _candidates(
        one, other, pose, params.candidates.last_gap, replace(params, candidates=last)
    )
    return _Trial(trial.fit, ties, _aligned(one, other, ties, pose, prior, params))


def _judged(
    one: StopViews, other: StopViews, trial: _Trial, by_chance: int, params: CrossSiteParams
) -> SiteLink:
    """The link of a settled trial, or why it is none."""
    if trial.alignment is None:
        return _unlinked(one, other, "the conjugates could not be aligned", [trial.fit])
    figures = _figures(one, other, trial, trial.alignment, by_chance)
    linked, reason = _verdict(figures, params)
    if not linked:
        return _unlinked(one, other, reason, [trial.fit], figures)
    return SiteLink(
        one.stop.stop,
        other.stop.stop,
        linked,
        reason,
        trial.ties.taking(trial.alignment.agrees),
        trial.alignment.first_from_second,
        params.shared * trial.alignment.covariance,
        figures,
        trial.fit,
    )


def _verdict(figures: SiteLinkFigures, params: CrossSiteParams) -> tuple[bool, str]:
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


def _figures(
    one: StopViews,
    other: StopViews,
    trial: _Trial,
    alignment: Alignment,
    by_chance: int,
) -> SiteLinkFigures:
    """The figures of an alignment."""
    level = one.stop.lsl_from_rover.rotation
    telemetry = other.stop.lsl_from_rover.translation_m - one.stop.lsl_from_rover.translation_m
    found = alignment.first_from_second
    moved = level @ found.translation_m - telemetry
    turn = level @ found.rotation @ other.stop.lsl_from_rover.rotation.T
    kept = trial.ties.taking(alignment.agrees)
    return SiteLinkFigures(
        distance_m=float(np.hypot(telemetry[0], telemetry[1])),
        peak_z=trial.fit.z,
        overlap_m2=trial.fit.overlap_m2,
        measured=len(trial.ties),
        ties=len(kept),
        by_chance=by_chance,
        rms_px=alignment.rms_px,
        sigma0=alignment.sigma0,
        spread_m=_spread_m(_places(one, kept) @ level.T),
        moved_m=(float(moved[0]), float(moved[1]), float(moved[2])),
        turned=float(np.arctan2(turn[1, 0], turn[0, 0])),
    )


def _places(one: StopViews, ties: Ties) -> ObjectPoints:
    """Where the ties lie, in the frame of the earlier rover."""
    places = np.full((len(ties), 3), np.nan)
    for view in (v.view for v in one.views):
        rows = ties.first == ties.pair_ids.index(view.pair.pair_id)
        points = view.geometry.triangulate(ties.first_left[rows], ties.first_parallax_px[rows])
        places[rows] = view.geometry.rover_from_pair.apply(points)
    return places


def _spread_m(places: ObjectPoints) -> float:
    """Standard deviation of horizontal places across their longest direction, metres."""
    if len(places) < 3:  # noqa: PLR2004 - two points have no width
        return 0.0
    smallest = np.linalg.eigvalsh(np.cov(places[:, :2].T))[0]
    return float(np.sqrt(max(smallest, 0.0)))


def _unlinked(
    one: StopViews,
    other: StopViews,
    reason: str,
    fits: Sequence[PlaneFit],
    figures: SiteLinkFigures | None = None,
) -> SiteLink:
    """The verdict `not linked`: no ties, and the pose of telemetry."""
    pose = one.stop.lsl_from_rover.inverse @ other.stop.lsl_from_rover
    step = other.stop.lsl_from_rover.translation_m - one.stop.lsl_from_rover.translation_m
    pair_ids = tuple(v.view.pair.pair_id for v in (*one.views, *other.views))
    nothing = SiteLinkFigures(
        distance_m=float(np.hypot(step[0], step[1])),
        peak_z=fits[0].z if fits else 0.0,
        overlap_m2=fits[0].overlap_m2 if fits else 0.0,
        measured=0,
        ties=0,
        by_chance=0,
        rms_px=float("nan"),
        sigma0=float("nan"),
        spread_m=0.0,
        moved_m=(0.0, 0.0, 0.0),
        turned=0.0,
    )
    return SiteLink(
        one.stop.stop,
        other.stop.stop,
        linked=False,
        reason=reason,
        ties=Ties.none(pair_ids),
        earlier_from_later=pose,
        covariance=np.full((6, 6), np.nan),
        figures=figures or nothing,
        fit=fits[0] if fits else None,
    )
