"""A traverse at mission scale whose truth is known: slip by terrain, gaps, orbital control.

There are no images, only what would have been measured in them (`networks`). A rover drives
`distance_m` in equal parts with panoramas between. Wheels slip by terrain: stretches of
`terrain_stops` drives have a slip of their own between `least_slip` and `most_slip` (log-uniform:
bedrock more often than sand), single drives half as much to half as much again; what wheels count
is always too far. On top come the random errors of `networks` with a slip of `least_slip`.

Gaps are drives over which images tie nothing (on the way out of Eagle Crater there were no images
at all): what lies on both sides hangs together by telemetry, or by the orbital image that shows
every `control_every`th stop to `control_sigma_m`. The place of that image is unknown
(`ControlFrame.claimed`), or certain where the image is the map itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.control import ControlFrame
from solmap.photogrammetry.adjustment.records import Network
from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.synthetic.control import SimulatedControl, simulate_control
from solmap.photogrammetry.synthetic.networks import (
    NetworkTruth,
    TelemetryErrors,
    numbered_pair,
    numbered_stop,
    simulate_network,
)


@dataclass(frozen=True, slots=True)
class MissionPlan:
    """What a mission is like; the defaults are the network that issue and paper speak of."""

    stops: int = 500
    distance_m: float = 7000.0
    pairs_per_stop: int = 10
    cross_ties: int = 20
    """Between each stop and the next."""
    far_cross_ties: int = 6
    """Between each stop and the one after the next."""
    inter_ties: int = 100
    intra_ties: int = 174
    least_slip: float = 0.01
    most_slip: float = 0.2
    terrain_stops: int = 20
    """Drives over which the ground, and the slip with it, stays the same."""
    gaps: int = 10
    """Places where images tie nothing..."""
    gap_drives: int = 2
    """...over so many drives."""
    fine_every: int = 10
    """The sun is sighted at every so many stops; 0: never."""
    control_every: int = 10
    """Every so many stops is found in the orbital image, the first and the last too, and those at
    both ends of drives without ties, which only it can join; 0: none."""
    control_sigma_m: float = 0.25
    """A pixel of HiRISE."""

    def __post_init__(self) -> None:
        needed = self.gaps * (self.gap_drives + 2) + 2
        if self.gaps and self.stops < needed:
            raise PhotogrammetryError(
                f"{self.gaps} gaps of {self.gap_drives} drives need {needed} stops, not "
                f"{self.stops}: plan fewer gaps"
            )


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedMission:
    """A mission and all that is true of it."""

    network: Network
    truth: NetworkTruth
    slips: Float64[np.ndarray, " drives"]
    """Share of each drive by which wheels turned too far."""
    untied: frozenset[int]
    """Drives that images do not bridge, by the number of the stop that they end at."""
    control: SimulatedControl | None

    @property
    def along_m(self) -> Float64[np.ndarray, " stops"]:
        """True distance driven up to every stop."""
        places = np.array([pose.translation_m for pose in self.truth.lsl_from_rover])
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])


@dataclass(frozen=True, slots=True)
class Names:
    """How stops and pairs of a simulated mission are called."""

    stop: Callable[[int], StopId] = numbered_stop
    pair: Callable[[int, int], str] = numbered_pair


def simulate_mission(
    rng: np.random.Generator,
    plan: MissionPlan,
    frame: ControlFrame | None = None,
    names: Names | None = None,
) -> SimulatedMission:
    """A mission by plan; `frame` is what is known of the place of its orbital image."""
    names = names or Names()
    slips, untied = _slips(rng, plan), _gaps(rng, plan)
    network, truth = simulate_network(
        rng,
        stops=plan.stops,
        pairs_per_stop=plan.pairs_per_stop,
        cross_ties=plan.cross_ties,
        far_cross_ties=plan.far_cross_ties,
        inter_ties=plan.inter_ties,
        intra_ties=plan.intra_ties,
        spacing_m=plan.distance_m / max(plan.stops - 1, 1),
        errors=TelemetryErrors(slip=plan.least_slip, drive_slips=tuple(slips.tolist())),
        fine_every=plan.fine_every,
        untied=untied,
        stop_name=names.stop,
        pair_name=names.pair,
    )
    control = None
    if plan.control_every:
        ends = {stop for drive in untied for stop in (drive - 1, drive)}
        shown = sorted({*range(0, plan.stops, plan.control_every), plan.stops - 1, *ends})
        control = simulate_control(
            rng, network, truth, shown, frame=frame, sigma_m=plan.control_sigma_m
        )
    return SimulatedMission(network, truth, slips, untied, control)


def _slips(rng: np.random.Generator, plan: MissionPlan) -> Float64[np.ndarray, " drives"]:
    """Slip of every drive, by terrain."""
    drives = plan.stops - 1
    grounds = -(-drives // plan.terrain_stops)
    typical = np.exp(rng.uniform(np.log(plan.least_slip), np.log(plan.most_slip), grounds))
    each = np.repeat(typical, plan.terrain_stops)[:drives] * rng.uniform(0.5, 1.5, drives)
    return np.clip(each, plan.least_slip, plan.most_slip)


def _gaps(rng: np.random.Generator, plan: MissionPlan) -> frozenset[int]:
    """Drives without ties: gaps shared out over the traverse, one somewhere in each part of it."""
    if not plan.gaps:
        return frozenset()
    bounds = np.linspace(2, plan.stops - 1, plan.gaps + 1).astype(int)
    untied: set[int] = set()
    for low, high in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        first = int(rng.integers(low, max(high - plan.gap_drives, low + 1)))
        untied.update(range(first, first + plan.gap_drives))
    return frozenset(untied)
