"""Which stops to link, and the search gate of the later stop by telemetry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose, rotation_of_roll_pitch_yaw
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    SEPARATION_M,
    PlaneFit,
    SearchGate,
)
from solmap.photogrammetry.matching.records import MatchedStop
from solmap.photogrammetry.ranges import Factor, FewOrZero, Metres, MetresOrZero, Radians, Share

PoseCovariance = Float64[np.ndarray, "6 6"]
"""Covariance of rotation vector (radians), then translation (metres)."""


@dataclass(frozen=True, slots=True)
class LinkParams:
    """Which stops are tried for links."""

    max_distance_m: MetresOrZero = 50.0
    """Beyond this distance, Navcam stereo does not see common ground well enough."""
    max_earlier: FewOrZero = 4
    """Nearest earlier stops tried for each new one: m-1, m-2 and revisits limit the drift."""


@dataclass(frozen=True, slots=True)
class GateParams:
    """Assumed uncertainty of telemetry between two stops, independent of its own statements."""

    slip_sigma: Share = 0.08
    """Fraction of the distance between the stops: 3 sigma cover wheel slip of 4-20 %."""
    position_sigma_m: Metres = 0.3
    """Standard deviation of even the shortest drive: about a wheel's width, as the first motion is
    a turn."""
    azimuth_sigma: Radians = 0.026
    """Radians (1.5 degrees): drift of the heading over a drive."""
    tilt_sigma: Radians = 0.0052
    """Radians (0.3 degrees): roll and pitch from gravity."""
    sigmas: Factor = 3.0
    """Half width of the gate in standard deviations."""

    def __post_init__(self) -> None:
        if min(self.position_sigma_m, self.azimuth_sigma, self.tilt_sigma, self.sigmas) <= 0:
            raise MatchingError(
                "the standard deviations of a gate must be above zero (`position_sigma_m`, "
                "`azimuth_sigma`, `tilt_sigma`, `sigmas`)"
            )

    def opened(self, position: float, azimuth: float, tilt: float) -> GateParams:
        """The gate with standard deviations multiplied by a factor estimated from the mission.

        The factor is rounded to a power of two, so that a mission's links rarely have to be
        searched again, and is never below one, which would find nothing more.
        """
        place, heading, level = (
            2.0 ** max(0, round(float(np.log2(factor)))) for factor in (position, azimuth, tilt)
        )
        return replace(
            self,
            slip_sigma=place * self.slip_sigma,
            position_sigma_m=place * self.position_sigma_m,
            azimuth_sigma=heading * self.azimuth_sigma,
            tilt_sigma=level * self.tilt_sigma,
        )

    def usual_sigma_m(self, distance_m: float) -> float:
        """Usual standard deviation of telemetry positions of stops at this distance."""
        return self.slip_sigma * distance_m + self.position_sigma_m


def link_candidates(
    lsl_from_rover: Pose,
    earlier: Mapping[StopId, Pose],
    params: LinkParams,
    gate: GateParams,
) -> list[StopId]:
    """The earlier stops that may share ground with one at `lsl_from_rover`, nearest first.

    Stops that are too far away only by the usual error of telemetry are included.
    """
    here = lsl_from_rover.translation_m[:2]
    distances = sorted(
        (float(np.linalg.norm(pose.translation_m[:2] - here)), stop)
        for stop, pose in earlier.items()
    )
    near = [
        stop
        for distance_m, stop in distances
        if distance_m - gate.sigmas * gate.usual_sigma_m(distance_m) <= params.max_distance_m
    ]
    return near[: params.max_earlier]


@dataclass(frozen=True, slots=True, eq=False)
class SearchStage:
    """A gate to search, and the prior covariance of the pose in it."""

    gate: SearchGate
    prior: PoseCovariance


LEAST_WAY = 0.25
"""Least true length of a drive, as a fraction of that by wheel odometry: a slip of 300 %."""

WIDENED = (1.0, 4.0, 16.0)
"""Factors of the usual uncertainty of the position by telemetry: normal; with spinning wheels (four
times 24 % of the drive is all of it); and anywhere with common ground. The uncertainty of the
heading, which gravity and the sun limit, grows with the square root."""


def search_stages(
    earlier: MatchedStop, later: MatchedStop, params: GateParams, radius_m: float
) -> list[SearchStage]:
    """The gates to search one after the other; views show the ground to `radius_m`.

    None where telemetry puts the stops farther apart than twice the reach of common ground, more
    than any plausible error of it.
    """
    stages = []
    for widened in WIDENED:
        gate, prior = search_gate(earlier, later, params, widened)
        apart_m = float(np.hypot(gate.north_m, gate.east_m))
        if gate.reach_m > 2 * radius_m:  # farther apart they share no ground
            gate = SearchGate(0.0, 0.0, 2 * radius_m, gate.azimuth_reach, apart_m=gate.apart_m)
        if apart_m - gate.reach_m < 2 * radius_m:
            stages.append(SearchStage(gate, prior))
    return stages


def search_gate(
    earlier: MatchedStop, later: MatchedStop, params: GateParams, widened: float = 1.0
) -> tuple[SearchGate, PoseCovariance]:
    """Possible poses of the later rover, and the prior covariance of the pose between both.

    Errors accumulate along a traverse, so the uncertainty between two stops is the growth of the
    covariance from one to the other, but at least that of a drive of this length.
    """
    step = later.lsl_from_rover.translation_m - earlier.lsl_from_rover.translation_m
    distance_m = float(np.hypot(step[0], step[1]))
    growth = np.maximum(np.diag(later.covariance) - np.diag(earlier.covariance), 0.0)
    position = params.usual_sigma_m(distance_m)
    least = np.array([params.tilt_sigma] * 2 + [params.azimuth_sigma] + [position] * 3) ** 2
    variance = np.maximum(growth, least)
    variance[2] *= widened
    variance[3:] *= widened**2
    gate = SearchGate(
        float(step[0]),
        float(step[1]),
        params.sigmas * float(np.sqrt(variance[3:5].max())),
        params.sigmas * float(np.sqrt(variance[2])),
        apart_m=min(SEPARATION_M, LEAST_WAY * distance_m),
    )
    axes = np.zeros((6, 6))
    axes[:3, :3] = axes[3:, 3:] = earlier.lsl_from_rover.rotation.T
    return gate, axes @ np.diag(variance) @ axes.T


def pose_from_fit(earlier: MatchedStop, later: MatchedStop, fit: PlaneFit) -> Pose:
    """earlier_from_later with the tilt of telemetry and the other components of a fit."""
    level_from_earlier = earlier.lsl_from_rover.rotation
    turn = rotation_of_roll_pitch_yaw(0.0, 0.0, fit.azimuth)
    place = np.array([fit.north_m, fit.east_m, fit.down_m])
    return Pose(
        earlier.stop.frame,
        later.stop.frame,
        level_from_earlier.T @ turn @ later.lsl_from_rover.rotation,
        level_from_earlier.T @ place,
    )


def level_pose(earlier: MatchedStop, later: MatchedStop, pose: Pose) -> Pose:
    """A pose of rover to rover as one between the level frames of both stops."""
    one, other = earlier.lsl_from_rover.rotation, later.lsl_from_rover.rotation
    return Pose(pose.target, pose.source, one @ pose.rotation @ other.T, one @ pose.translation_m)
