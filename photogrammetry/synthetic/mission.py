"""A traverse at mission scale with known truth: slip by terrain, gaps, orbital control.

There are no images, only simulated measurements (`networks`). A rover drives `distance_m` in equal
parts with panoramas between. Wheels slip by terrain: stretches of `terrain_stops` drives have their
own slip between `LEAST_SLIP` and `MOST_SLIP` (log-uniform: bedrock more often than sand), single
drives 0.5 to 1.5 times that; odometry always overestimates. Added to this are the random errors of
`networks` with a slip of `LEAST_SLIP`.

Gaps are drives without tie points (on the way out of Eagle Crater there were no images at all):
both sides are connected only by telemetry, or by the orbital image that gives every
`control_every`th stop to `CONTROL_SIGMA_M`. The position of that image is unknown
(`ControlFrame.from_sigmas`), or certain where the image is the map itself.

The orbital image is shifted, rotated and scaled within the errors of its georeference
(`ControlFrame.covariance`), and every position in it has the stated error of its registration.

The images of the mission are labels without pixels. Stops are drives of one site, so that telemetry
needs no chain of sites; each stop has a panorama of Navcam pairs per sol, and its first exposure
names the pair in the network. The label's cameras are those of the mast (`rig`), rotated like the
network's pairs; their axes differ from those of the simulated pairs by a degree or two, so
footprints are realistic and tie points are simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.model.network import (
    FRAME_UNKNOWNS,
    ControlFrame,
    Network,
    StopControl,
)
from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.frames import Pose, site_frame
from solmap.photogrammetry.imagery import Eye, StopId
from solmap.photogrammetry.synthetic.edr import Exposure
from solmap.photogrammetry.synthetic.networks import (
    ELEVATION_DEG,
    NetworkTruth,
    TelemetryErrors,
    numbered_pair,
    numbered_stop,
    simulate_network,
)
from solmap.photogrammetry.synthetic.rig import CAMERAS, Instrument, Pointing
from solmap.photogrammetry.synthetic.traverse import solar_longitude, sun_at

CROSS_TIES, FAR_CROSS_TIES = 20, 6
"""Cross-site ties between consecutive stops, and between stops two apart."""
LEAST_SLIP, MOST_SLIP = 0.01, 0.2
GAP_DRIVES = 2
"""Number of drives of a gap."""
FINE_EVERY = 10
"""Interval in stops of sun sightings."""
CONTROL_SIGMA_M = 0.25
"""Standard deviation of control: a pixel of HiRISE."""
MISSION = "MER2"
SITE, DRIVES = 0, 2
"""The site of all stops, and the increment of their drive counter."""
MOST_STOPS = 500
"""Most stops: beyond a drive counter of 1295 file names cannot distinguish them."""
FIRST_CLOCK, SOL_S, PAIR_S = 126_000_000, 88_775, 60
HOUR = 12.0
SEQUENCE = "P0703"


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedControl:
    """An orbital image, the stops in it, and its true position."""

    frame: ControlFrame
    control: tuple[StopControl, ...]
    place: Float64[np.ndarray, " 5"]
    """True position of the image."""


def simulate_control(  # noqa: PLR0913 - one keyword for each thing that a test may vary
    rng: np.random.Generator,
    network: Network,
    truth: NetworkTruth,
    stops: Sequence[int],
    *,
    frame: ControlFrame | None = None,
    sigma_m: float = 0.1,
    sigma_up_m: float | None = None,
    sigma_azimuth_deg: float | None = None,
    noise: float = 1.0,
) -> SimulatedControl:
    """Positions of some stops of a network in an orbital image.

    Args:
        rng: source of all randomness.
        network: simulated network.
        truth: true poses of its stops.
        stops: numbers of the stops in the image.
        frame: prior of the image's position; its true position is drawn from it.
        sigma_m: standard deviation of each coordinate of a position.
        sigma_up_m: standard deviation of heights; None: there are none.
        sigma_azimuth_deg: standard deviation of azimuths; None: there are none.
        noise: multiplies the errors of positions, not those of the image's own position.
    """
    centres = np.array([pose.translation_m for pose in truth.lsl_from_rover])
    north, east = centres[:, :2].mean(axis=0).tolist()
    frame = frame or ControlFrame.from_sigmas("orbit", (east, north), shift_m=10.0)
    place = frame.place.copy()
    free = np.array(frame.is_free)
    root = np.linalg.cholesky(frame.covariance[np.ix_(free, free)])
    place[free] += root @ rng.normal(size=int(free.sum()))
    sigma = [sigma_m, sigma_m]
    sigma += [sigma_up_m] if sigma_up_m else []
    sigma += [float(np.radians(sigma_azimuth_deg))] if sigma_azimuth_deg else []
    control = []
    for k in stops:
        seen = _place_in_image(truth.lsl_from_rover[k], frame, place)
        given = [0, 1, *([2] if sigma_up_m else []), *([3] if sigma_azimuth_deg else [])]
        seen[given] += rng.normal(0, np.array(sigma) * noise)
        control.append(
            StopControl(
                network.stop_ids[k],
                frame.name,
                float(seen[0]),
                float(seen[1]),
                np.diag(np.square(sigma)),
                float(seen[2]) if sigma_up_m else None,
                float(np.degrees(seen[3])) if sigma_azimuth_deg else None,
            )
        )
    return SimulatedControl(frame, tuple(control), place)


def _place_in_image(
    pose: Pose, frame: ControlFrame, place: np.ndarray
) -> Float64[np.ndarray, " 4"]:
    """East, north, up and azimuth of a rover in the image."""
    shift, (b, a) = place[:3], place[3:FRAME_UNKNOWNS]
    centre = np.array(frame.centre_m)
    north, east, down = pose.translation_m.tolist()
    similarity = np.array([[1 + a, -b], [b, 1 + a]])
    u = centre + np.linalg.solve(similarity, np.array([east, north]) - centre - shift[:2])
    azimuth = np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]) + np.arctan2(b, 1 + a)
    return np.array([*u, -down - shift[2], azimuth])


@dataclass(frozen=True, slots=True)
class MissionPlan:
    """Parameters of a mission; the defaults are the network of the paper."""

    stops: int = 500
    distance_m: float = 7000.0
    pairs_per_stop: int = 10
    inter_ties: int = 100
    intra_ties: int = 174
    terrain_stops: int = 20
    """Number of drives over which the ground, and with it the slip, stays the same."""
    gaps: int = 10
    """Number of gaps of `GAP_DRIVES` drives without tie points."""
    control_every: int = 10
    """Interval of stops found in the orbital image; always included are the first, the last, and
    both ends of drives without ties, which only the image can join. 0: none."""

    def __post_init__(self) -> None:
        needed = self.gaps * (GAP_DRIVES + 2) + 2
        if self.gaps and self.stops < needed:
            raise PhotogrammetryError(
                f"{self.gaps} gaps of {GAP_DRIVES} drives need {needed} stops, not "
                f"{self.stops}: plan fewer gaps"
            )


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedMission:
    """A simulated mission with its truth."""

    network: Network
    truth: NetworkTruth
    slips: Float64[np.ndarray, " drives"]
    """Slip of each drive, as a fraction."""
    untied: frozenset[int]
    """Drives without ties, by the number of the stop at which they end."""
    control: SimulatedControl | None

    @property
    def along_m(self) -> Float64[np.ndarray, " stops"]:
        """True distance driven up to every stop."""
        places = np.array([pose.translation_m for pose in self.truth.lsl_from_rover])
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])


@dataclass(frozen=True, slots=True)
class Names:
    """Names of stops and pairs of a simulated mission."""

    stop: Callable[[int], StopId] = numbered_stop
    pair: Callable[[int, int], str] = numbered_pair


def simulate_mission(
    rng: np.random.Generator,
    plan: MissionPlan,
    frame: ControlFrame | None = None,
    names: Names | None = None,
) -> SimulatedMission:
    """Simulate a mission by a plan; `frame` is the prior of the position of its orbital image."""
    names = names or Names()
    slips, untied = _slips(rng, plan), _gaps(rng, plan)
    network, truth = simulate_network(
        rng,
        stops=plan.stops,
        pairs_per_stop=plan.pairs_per_stop,
        cross_ties=CROSS_TIES,
        far_cross_ties=FAR_CROSS_TIES,
        inter_ties=plan.inter_ties,
        intra_ties=plan.intra_ties,
        spacing_m=plan.distance_m / max(plan.stops - 1, 1),
        errors=TelemetryErrors(slip=LEAST_SLIP, drive_slips=tuple(slips.tolist())),
        fine_every=FINE_EVERY,
        untied=untied,
        stop_name=names.stop,
        pair_name=names.pair,
    )
    control = None
    if plan.control_every:
        ends = {stop for drive in untied for stop in (drive - 1, drive)}
        shown = sorted({*range(0, plan.stops, plan.control_every), plan.stops - 1, *ends})
        control = simulate_control(rng, network, truth, shown, frame=frame, sigma_m=CONTROL_SIGMA_M)
    return SimulatedMission(network, truth, slips, untied, control)


def _slips(rng: np.random.Generator, plan: MissionPlan) -> Float64[np.ndarray, " drives"]:
    """Slip of every drive, by terrain."""
    drives = plan.stops - 1
    grounds = -(-drives // plan.terrain_stops)
    typical = np.exp(rng.uniform(np.log(LEAST_SLIP), np.log(MOST_SLIP), grounds))
    each = np.repeat(typical, plan.terrain_stops)[:drives] * rng.uniform(0.5, 1.5, drives)
    return np.clip(each, LEAST_SLIP, MOST_SLIP)


def _gaps(rng: np.random.Generator, plan: MissionPlan) -> frozenset[int]:
    """Drives without ties: gaps distributed over the traverse, one in each part of it."""
    if not plan.gaps:
        return frozenset()
    bounds = np.linspace(2, plan.stops - 1, plan.gaps + 1).astype(int)
    untied: set[int] = set()
    for low, high in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        first = int(rng.integers(low, max(high - GAP_DRIVES, low + 1)))
        untied.update(range(first, first + GAP_DRIVES))
    return frozenset(untied)


def mission_names(plan: MissionPlan) -> Names:
    """Names of stops and pairs as in the archive: pairs have the names of their left images.

    Raises:
        PhotogrammetryError: more stops than file names can distinguish.
    """
    if plan.stops > MOST_STOPS:
        raise PhotogrammetryError(
            f"file names of {MISSION} can distinguish {MOST_STOPS} stops of a site, not "
            f"{plan.stops}"
        )
    return Names(_stop, lambda stop, pair: _exposure(stop, pair, plan, Eye.LEFT).product_id)


def exposures(mission: SimulatedMission, plan: MissionPlan) -> Iterator[tuple[Exposure, Exposure]]:
    """Left and right exposure of every pair, with the attitude and position by telemetry."""
    for stop, prior in enumerate(mission.network.stops):
        telemetry = prior.lsl_from_rover
        pose = Pose(site_frame(SITE), telemetry.source, telemetry.rotation, telemetry.translation_m)
        for pair in range(plan.pairs_per_stop):
            yield (
                _exposure(stop, pair, plan, Eye.LEFT, pose),
                _exposure(stop, pair, plan, Eye.RIGHT, pose),
            )


def _stop(k: int) -> StopId:
    return StopId(MISSION, SITE, DRIVES * k)


def _exposure(
    stop: int, pair: int, plan: MissionPlan, eye: Eye, site_from_rover: Pose | None = None
) -> Exposure:
    name, sol = _stop(stop), stop + 1
    pointing = Pointing(2 * np.pi * pair / plan.pairs_per_stop, float(np.radians(ELEVATION_DEG)))
    return Exposure(
        stop=name,
        sol=sol,
        local_solar_hour=HOUR + pair * PAIR_S / 3600,
        solar_longitude=solar_longitude(sol),
        sun=sun_at(sol, HOUR),
        site_from_rover=site_from_rover or Pose.identity(site_frame(SITE), name.frame),
        instrument=Instrument.NAVCAM,
        eye=eye,
        pointing=pointing,
        camera=CAMERAS[Instrument.NAVCAM, eye].in_mast.transform(pointing.rover_from_mast(name)),
        clock=FIRST_CLOCK + SOL_S * sol + PAIR_S * pair,
        pma=pair + 1,
        sequence=SEQUENCE,
    )
