"""Hypotheses of where the later stop stands, tried in the images.

Under a hypothesis, candidates (`cross_site_candidates`) are matched on the ground
(`ground_matching`), and a robust rigid alignment counts how many agree in space (`alignment`).
Hypotheses that are wrong measure what chance can do, and so do decoys: places inside the gate
where no peak was, tried in exactly the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.arrays import PerPoint
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.alignment import Alignment, AlignmentParams, align
from solmap.photogrammetry.matching.birds_eye import PlaneFit, SearchGate
from solmap.photogrammetry.matching.cross_site_candidates import Candidates, Gap, plans_between
from solmap.photogrammetry.matching.cross_site_gate import PoseCovariance, between_levels, pose_of
from solmap.photogrammetry.matching.ground_matching import GroundMatchingParams, match_ground
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.matching.stop_views import StopViews
from solmap.photogrammetry.matching.tie_refinement import RefinementParams, refined

LEAST_TO_ALIGN = 6
"""Ties for the six unknowns of a pose with some redundancy."""


@dataclass(frozen=True, slots=True)
class TrialParams:
    """How hypotheses are tried."""

    candidates: Candidates = field(default_factory=Candidates)
    ground: GroundMatchingParams = field(default_factory=GroundMatchingParams)
    alignment: AlignmentParams = field(default_factory=AlignmentParams)
    refinement: RefinementParams = field(default_factory=RefinementParams)
    decoys: int = 2
    separation_m: float = 0.75
    """Trials that end this near to each other found the same place."""

    def __post_init__(self) -> None:
        if self.decoys < 0 or self.separation_m <= 0:
            raise MatchingError(
                f"trials need 0 or more decoys and a separation above zero, not {self.decoys} and "
                f"{self.separation_m} m"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A hypothesis after it was tried in the images."""

    fit: PlaneFit
    ties: Ties
    width_m: PerPoint
    """Of the patches of ground that the ties were matched by."""
    alignment: Alignment | None

    @property
    def agreeing(self) -> int:
        """Ties that agree in space."""
        return int(self.alignment.agrees.sum()) if self.alignment else 0

    def elsewhere(self, other: Trial, separation_m: float) -> bool:
        """Whether two trials ended at different places: neighbours may find the same."""
        if self.alignment is None or other.alignment is None:
            return False
        here, there = (a.first_from_second.translation_m for a in (self.alignment, other.alignment))
        return bool(np.linalg.norm(here - there) > separation_m)


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """Two stops between which hypotheses are tried."""

    one: StopViews
    other: StopViews
    prior: PoseCovariance
    params: TrialParams

    def tried(self, fit: PlaneFit) -> Trial:
        """Look for some conjugates under a hypothesis and align by them."""
        candidates = self.params.candidates
        pose = pose_of(self.one.stop, self.other.stop, fit)
        dense_sigma_px = candidates.parallax_sigma_px
        return self._trial(fit, pose, candidates.first_gap, candidates, dense_sigma_px)

    def settled(self, trial: Trial) -> Trial:
        """Match all there is from the trial's own alignment, in the window that leaves open."""
        if trial.alignment is None:
            return trial
        candidates = replace(self.params.candidates, most=self.params.candidates.most_at_last)
        pose = trial.alignment.first_from_second
        return self._trial(trial.fit, pose, candidates.last_gap, candidates, None)

    def refined(self, trial: Trial) -> Trial:
        """Measure the ties that agree again, in the original images, and align by them."""
        if trial.alignment is None:
            return trial
        agrees = trial.alignment.agrees
        views = {v.view.pair.pair_id: v.view for v in (*self.one.views, *self.other.views)}
        ties = refined(
            trial.ties.taking(agrees),
            views,
            trial.alignment,
            self.params.refinement,
            self.params.ground.parallax,
        )
        alignment = self.aligned(ties, trial.alignment.first_from_second)
        return Trial(trial.fit, ties, trial.width_m[agrees], alignment)

    def _trial(
        self,
        fit: PlaneFit,
        pose: Pose,
        gap: Gap,
        candidates: Candidates,
        dense_sigma_px: float | None,
    ) -> Trial:
        """Conjugates under a pose of rover to rover, and the alignment by them."""
        level = between_levels(self.one.stop, self.other.stop, pose)
        forth, back = plans_between(self.one.views, self.other.views, level, gap, candidates)
        pair_ids = (*self.one.pair_ids, *self.other.pair_ids)
        found = match_ground(forth, back, self.params.ground, pair_ids, dense_sigma_px)
        return Trial(fit, found.ties, found.width_m, self.aligned(found.ties, pose))

    def aligned(self, ties: Ties, pose: Pose) -> Alignment | None:
        """The robust alignment by some ties, None if there are hardly any."""
        if len(ties) < LEAST_TO_ALIGN:
            return None
        views = (*self.one.views, *self.other.views)
        geometries = {v.view.pair.pair_id: v.view.geometry for v in views}
        return align(ties, geometries, pose, self.prior, self.params.alignment)


def decoys(
    gate: SearchGate, fits: Sequence[PlaneFit], number: int, clear_m: float
) -> list[PlaneFit]:
    """Places on the rim of a circle around the best fit, far from every peak of the search."""
    best, radius = fits[0], max(2 * clear_m, 0.5 * gate.reach_m)
    around = []
    for angle in np.linspace(0.6, 0.6 + 2 * np.pi, 8 * number, endpoint=False):
        north = best.north_m + radius * float(np.cos(angle))
        east = best.east_m + radius * float(np.sin(angle))
        if min(np.hypot(f.north_m - north, f.east_m - east) for f in fits) > clear_m:
            around.append(PlaneFit(best.azimuth, north, east, best.down_m, 0.0, best.overlap_m2))
    step = max(len(around) // max(number, 1), 1)
    return around[::step][:number]
