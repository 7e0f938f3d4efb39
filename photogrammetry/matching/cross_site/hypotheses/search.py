"""Hypotheses of where the later of two stops stands, stage by stage.

Telemetry is right to some per cent of the drive as a rule, and wrong altogether where wheels spin.
The gate is therefore searched first as narrow as telemetry usually deserves, and widened only where
no peak stands out (`gate.search_stages`), until all places that share ground are exhausted.

A gate holds 10^4 (first stage) to some 10^6 places (last) that know nothing of each other, so
chance comes to a z of 4 to 5.2 (`links.VerdictParams.least_z`). Wide gates are searched in views
with cells twice as wide, in an eighth of the time; the best places there are searched again in the
full views, and it is these peaks that have to stand out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from solmap.photogrammetry.matching.cross_site.birds_eye import (
    SEPARATION_M,
    BirdsEyeParams,
    BirdsEyeView,
    PlaneFit,
    SearchGate,
)
from solmap.photogrammetry.matching.cross_site.gate import PoseCovariance, SearchStage
from solmap.photogrammetry.matching.cross_site.hypotheses.correlation import (
    azimuth_step,
    correlate_views,
)


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses:
    """Where the later stop may stand, and the gate that it was found in."""

    fits: list[PlaneFit]
    """Highest peak first; none where the stops share too little ground."""
    gate: SearchGate
    prior: PoseCovariance

    @property
    def highest(self) -> float:
        """The z of the best; 0 if it does not lie in the gate, or if there is none."""
        return self.fits[0].z if self.fits and self.gate.holds(self.fits[0]) else 0.0


def find_hypotheses(
    earlier: BirdsEyeView,
    later: BirdsEyeView,
    stages: Sequence[SearchStage],
    params: BirdsEyeParams,
    least_z: float,
) -> Hypotheses:
    """The best hypotheses of the first stage that one stands out in, else of the last stage."""
    first, *wider = stages
    fits = correlate_views(earlier, later, first.gate, params.peaks, params.min_overlap_m2)
    found = Hypotheses(fits, first.gate, first.prior)
    for stage in wider:
        if found.highest >= least_z:
            break
        fits = _search_wide(earlier, later, stage.gate, params)
        found = Hypotheses(fits, stage.gate, stage.prior)
    return found


def _search_wide(
    earlier: BirdsEyeView, later: BirdsEyeView, gate: SearchGate, params: BirdsEyeParams
) -> list[PlaneFit]:
    """The best places of a wide gate."""
    coarse = (earlier.halved, later.halved)
    step = azimuth_step(coarse[0])
    fits: list[PlaneFit] = []
    for place in correlate_views(*coarse, gate, params.peaks, params.min_overlap_m2):
        near = SearchGate(place.north_m, place.east_m, SEPARATION_M / 2, step, place.azimuth)
        found = correlate_views(earlier, later, near, 1, params.min_overlap_m2)
        fits += [fit for fit in found if near.holds(fit)]
    return sorted(fits, key=lambda fit: -fit.z)
