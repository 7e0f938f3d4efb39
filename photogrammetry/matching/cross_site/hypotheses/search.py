"""Find hypotheses of the later stop's pose, stage by stage.

Telemetry is usually accurate to some per cent of the drive, but fails where wheels spin. A gate of
its usual uncertainty is therefore searched first, and widened only where no peak is significant
(`gate.search_stages`), until all positions with common ground are covered.

A gate contains 10^4 (first stage) to about 10^6 independent positions (last), so the largest random
z is 4 to 5.2 (`links.LinkTestParams.least_z`). Wide gates are searched in views with cells of twice
the size, in an eighth of the time; the best positions are searched again in the full views, and
those peaks have to be significant.
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
    """Possible poses of the later stop, and the gate in which they were found."""

    fits: list[PlaneFit]
    """Highest peak first; empty where the stops share too little ground."""
    gate: SearchGate
    prior: PoseCovariance

    @property
    def highest(self) -> float:
        """The z of the best; 0 if it lies outside the gate, or if there is none."""
        return self.fits[0].z if self.fits and self.gate.holds(self.fits[0]) else 0.0


def find_hypotheses(
    earlier: BirdsEyeView,
    later: BirdsEyeView,
    stages: Sequence[SearchStage],
    params: BirdsEyeParams,
    least_z: float,
) -> Hypotheses:
    """The best hypotheses of the first stage with a significant one, else of the last stage."""
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
    """The best positions of a wide gate."""
    coarse = (earlier.halved, later.halved)
    step = azimuth_step(coarse[0])
    fits: list[PlaneFit] = []
    for place in correlate_views(*coarse, gate, params.peaks, params.min_overlap_m2):
        near = SearchGate(place.north_m, place.east_m, SEPARATION_M / 2, step, place.azimuth)
        found = correlate_views(earlier, later, near, 1, params.min_overlap_m2)
        fits += [fit for fit in found if near.holds(fit)]
    return sorted(fits, key=lambda fit: -fit.z)
