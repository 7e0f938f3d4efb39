"""The result of linking two stops: the decision, its reason, its figures and the ties."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, ObjectPoints
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.alignment import Alignment
from solmap.photogrammetry.matching.cross_site.birds_eye import PlaneFit
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.ranges import Count, FactorFromOne, FactorOrZero, MetresOrZero, Share

LEAST_TO_ALIGN = 6
"""Fewest ties that determine the six unknowns of a pose with some redundancy."""


SIGNIFICANT_Z = 6.5
"""Significance of a peak that is hardly random (`LinkTestParams.least_z`)."""


@dataclass(frozen=True, slots=True)
class LinkTestParams:
    """Criteria for accepting a link."""

    least_ties: Count = 20
    """Fewest ties of a link if its peak could be random."""
    few_ties: Count = 8
    """Fewest ties at a peak that cannot be random: both then give the same position independently.
    The paper's example had 7 manual ones."""
    clear_z: FactorOrZero = 8.0
    """Peak that cannot be random: stops with common ground have 8 and more, those without, and
    wrong positions, 6.2 at most."""
    least_z: FactorOrZero = SIGNIFICANT_Z
    """Least significance of a peak: the widest gate has about 10^6 independent positions, whose
    largest random z is 5.2; in one of 67 searches of stops without common ground it was 6.2."""
    chance_factor: FactorFromOne = 2.0
    """Least ratio of a link's ties to those of a wrong hypothesis."""
    chance_sigmas: FactorOrZero = 4.0
    """Standard deviations of a random count by which the ties must exceed that ratio."""
    least_share: Share = 0.5
    """Least fraction of the conjugates of the final search that agree in space."""
    least_spread_m: MetresOrZero = 1.0
    """Standard deviation of the ties' positions across their longest direction."""

    def __post_init__(self) -> None:
        if min(self.least_ties, self.few_ties) < LEAST_TO_ALIGN or self.chance_factor < 1:
            raise MatchingError(
                f"a link needs more than {self.least_ties} ties, or {self.few_ties} at a clear "
                f"peak, and {self.chance_factor} times those by chance"
            )

    def needed(self, peak_z: float) -> int:
        """Fewest ties of a link at a peak of this height."""
        return self.few_ties if peak_z >= self.clear_z else self.least_ties


@dataclass(frozen=True, slots=True)
class SiteLinkFigures:
    """Figures on which the decision about a link is based."""

    distance_m: float
    """Distance between the stops by telemetry."""
    peak_z: float = 0.0
    """Significance of the peak of the search where the ties are; 0 if they are elsewhere."""
    overlap_m2: float = 0.0
    measured: int = 0
    """Conjugates with parallax in the last round."""
    ties: int = 0
    """Conjugates that agree in space."""
    handed_on: int = 0
    """Number of these that are ties of the link, which are nearly independent."""
    by_shape: int = 0
    """Further, surface-matched ties of the link."""
    height_bias_lines: float = float("nan")
    """Bias of heights at both stops (`height_bias`),"""
    height_bias_sigma: float = float("nan")
    """its standard deviation,"""
    expected_bias_lines: float = float("nan")
    """its prior by the relief of the ground,"""
    expected_bias_sigma: float = float("nan")
    """and the standard deviation of that."""
    by_chance: int = 0
    """Ties of the best wrong hypothesis or decoy, found in the same way."""
    rms_px: float = float("nan")
    sigma0: float = float("nan")
    spread_m: float = 0.0
    moved_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Difference between the link and telemetry, north, east, down."""
    turned: float = 0.0
    """Azimuth difference between the link and telemetry, radians."""


@dataclass(frozen=True, slots=True, eq=False)
class SiteLink:
    """Whether two stops are linked, by which ties, and their relative pose."""

    earlier: StopId
    later: StopId
    linked: bool
    reason: str
    ties: Ties
    """First the earlier stop's pair, second the later one's; none unless linked."""
    earlier_from_later: Pose
    """Rover to rover: by the link if accepted, else by telemetry."""
    covariance: Float64[np.ndarray, "6 6"]
    """Covariance of rotation vector (radians), then translation (metres), in the earlier rover's
    axes."""
    figures: SiteLinkFigures
    fit: PlaneFit | None
    """The best peak of the bird's-eye search, kept for figures."""

    @property
    def state(self) -> str:
        """`linked` or `not linked`."""
        return "linked" if self.linked else "not linked"

    def __str__(self) -> str:
        return f"{self.earlier} - {self.later}: {self.state}, {self.reason}"


def evaluate_link(figures: SiteLinkFigures, params: LinkTestParams) -> tuple[bool, str]:
    """(linked, reason)."""
    share = figures.ties / max(figures.measured, 1)
    needed = params.needed(figures.peak_z)
    if figures.ties < needed:
        return False, f"{figures.ties} ties, {needed} are needed"
    chance = figures.by_chance + params.chance_sigmas * figures.by_chance**0.5
    if figures.ties < max(chance, params.chance_factor * figures.by_chance):
        return (
            False,
            f"{figures.ties} ties, where a wrong position gets {figures.by_chance} by chance",
        )
    if share < params.least_share:
        return False, f"only {share:.0%} of {figures.measured} conjugates agree in space"
    if figures.spread_m < params.least_spread_m:
        return False, f"the ties lie on a line, {figures.spread_m:.1f} m wide"
    return True, (
        f"{figures.ties} ties of {figures.measured} conjugates, rms {figures.rms_px:.2f} px, "
        f"{figures.by_chance} by chance"
    )


def refused_link(
    one: StopViews,
    other: StopViews,
    reason: str,
    fit: PlaneFit | None = None,
    figures: SiteLinkFigures | None = None,
) -> SiteLink:
    """The result `not linked`: no ties, and the pose of telemetry."""
    if figures is None:
        z, overlap_m2 = (fit.z, fit.overlap_m2) if fit else (0.0, 0.0)
        figures = SiteLinkFigures(distance_m(one, other), peak_z=z, overlap_m2=overlap_m2)
    return SiteLink(
        one.id,
        other.id,
        linked=False,
        reason=reason,
        ties=Ties.none((*one.pair_ids, *other.pair_ids)),
        earlier_from_later=one.stop.lsl_from_rover.inverse @ other.stop.lsl_from_rover,
        covariance=np.full((6, 6), np.nan),
        figures=figures,
        fit=fit,
    )


def distance_m(one: StopViews, other: StopViews) -> float:
    """Horizontal distance between two stops by telemetry."""
    step = other.stop.lsl_from_rover.translation_m - one.stop.lsl_from_rover.translation_m
    return float(np.hypot(step[0], step[1]))


def link_figures(
    one: StopViews,
    other: StopViews,
    fit: PlaneFit,
    ties: Ties,
    alignment: Alignment,
) -> SiteLinkFigures:
    """The figures of an alignment by some ties."""
    level = one.stop.lsl_from_rover.rotation
    telemetry = other.stop.lsl_from_rover
    found = alignment.first_from_second
    step = telemetry.translation_m - one.stop.lsl_from_rover.translation_m
    moved = level @ found.translation_m - step
    turn = level @ found.rotation @ telemetry.rotation.T
    kept = ties.select(alignment.agrees)
    return SiteLinkFigures(
        distance_m=distance_m(one, other),
        peak_z=fit.z,
        overlap_m2=fit.overlap_m2,
        measured=len(ties),
        ties=len(kept),
        rms_px=alignment.rms_px,
        sigma0=alignment.sigma0,
        spread_m=spread_m(tie_places(one, kept) @ level.T),
        moved_m=(float(moved[0]), float(moved[1]), float(moved[2])),
        turned=float(np.arctan2(turn[1, 0], turn[0, 0])),
    )


def tie_places(one: StopViews, ties: Ties) -> ObjectPoints:
    """Positions of the ties in the frame of the earlier rover."""
    places = np.full((len(ties), 3), np.nan)
    for view in (v.view for v in one.views):
        rows = ties.first == ties.pair_ids.index(view.pair.pair_id)
        points = view.geometry.triangulate(ties.first_left[rows], ties.first_parallax_px[rows])
        places[rows] = view.geometry.rover_from_pair.apply(points)
    return places


def spread_m(places: ObjectPoints) -> float:
    """Standard deviation of horizontal positions across their longest direction, metres."""
    if len(places) < 3:  # noqa: PLR2004 - two points have no width
        return 0.0
    smallest = np.linalg.eigvalsh(np.cov(places[:, :2].T))[0]
    return float(np.sqrt(max(smallest, 0.0)))
