"""The traverse: true poses of the rover, and those by telemetry.

The rover stands on the plane through the ground under its six wheels, its origin 0.294 m above that
plane along its own z axis. Between stops the wheels turn more than the rover moves: with the true
motion d, slip s and the accumulated azimuth drift a, telemetry gives

    t_k = t_{k-1} + Rz(a_k) (1 + s_k) d_k + noise,      q_k = Rz(a_k) Ry(pitch) Rx(roll) q_true,

including small pitch and roll errors of the inertial unit. The first stop is exact. A new site is
declared every few stops, with its origin at the rover's position by telemetry.

The sun follows from the local solar time, the latitude and the solar longitude L_s, which grows by
0.524 degrees per sol from 327.7 at Spirit's landing; declination: sin(25.19 deg) sin(L_s).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Rotation, Vector3
from solmap.photogrammetry.errors import FrameError
from solmap.photogrammetry.frames import LSL, Frame, Pose, rotation_of_roll_pitch_yaw, site_frame
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.synthetic.lighting import Sun
from solmap.photogrammetry.synthetic.rig import GROUND_M
from solmap.photogrammetry.synthetic.terrain import Terrain

LATITUDE, LONGITUDE_DEG = np.deg2rad(-14.5692), 175.4729
"""Position of Spirit's lander, image-tied (Arvidson et al. 2004)."""
OBLIQUITY = np.deg2rad(25.19)
WHEELS_M = [(x, y) for x in (0.62, 0.0, -0.62) for y in (-0.53, 0.53)]
"""Wheels in the rover frame: a base of 1.24 m, a track of 1.06 m."""
FOOTPRINT_M = 0.1
"""Half the side of the patch of soil under a wheel."""


@dataclass(frozen=True, slots=True)
class TraverseParams:
    """Parameters of the drives and of their telemetry errors."""

    stops: int = 2
    first_site: int = 10
    stops_per_site: int = 2
    """Number of stops per site."""
    first_sol: int = 155
    spacing_m: tuple[float, float] = (10.0, 22.0)
    slip: tuple[float, float] = (0.01, 0.20)
    """Excess of the wheels' motion over the rover's, as a fraction; lowest and highest."""
    drift: float = float(np.deg2rad(1.2))
    """Standard deviation of the azimuth drift of a drive, radians."""
    tilt: float = float(np.deg2rad(0.12))
    """Standard deviation of roll and pitch of the telemetry, radians."""
    position_m: float = 0.15
    """Standard deviation of other errors of the telemetry position, for each axis and drive."""
    local_solar_hours: tuple[float, float] = (9.5, 15.5)
    """Hours between which images are taken."""
    suns: tuple[Sun, ...] = ()
    """Suns of the stops, in turn; none: by hour over Spirit's landing site."""

    def __post_init__(self) -> None:
        if self.stops < 1 or self.stops_per_site < 1 or self.first_site < 1:
            raise FrameError(
                f"a traverse needs stops and sites, not {self.stops} stops, {self.stops_per_site} "
                f"per site, from site {self.first_site}"
            )
        for name in ("spacing_m", "slip", "local_solar_hours"):
            low, high = getattr(self, name)
            if not 0 <= low <= high:
                raise FrameError(f"{name} must run from low to high, not from {low} to {high}")


@dataclass(frozen=True, slots=True, eq=False)
class Stop:
    """One stop: the truth and the telemetry."""

    id: StopId
    sol: int
    local_solar_hour: float
    sun: Sun
    slip: float
    lsl_from_rover: Pose
    """True."""
    telemetry_lsl_from_rover: Pose
    lsl_from_site: Pose
    """Telemetry: the origin of the stop's site."""

    @property
    def site_from_rover(self) -> Pose:
        """The pose in the labels."""
        return self.lsl_from_site.inverse @ self.telemetry_lsl_from_rover


def plan_stops(params: TraverseParams, rng: np.random.Generator) -> tuple[tuple[float, float], ...]:
    """(north, east) of the stops: a path that bends at every stop, from the LSL origin."""
    places, heading = [(0.0, 0.0)], rng.uniform(np.deg2rad(15), np.deg2rad(75))
    for _ in range(params.stops - 1):
        length_m = rng.uniform(*params.spacing_m)
        north, east = places[-1]
        places.append((north + length_m * np.cos(heading), east + length_m * np.sin(heading)))
        heading += rng.normal(0.0, np.deg2rad(20))
    return tuple((float(north), float(east)) for north, east in places)


def standing_pose(
    terrain: Terrain, north: float, east: float, heading: float, rover: Frame
) -> Pose:
    """The true `lsl_from_rover` of a rover with its origin above (north, east)."""
    c, s = np.cos(heading), np.sin(heading)
    wheels = np.array([(north + c * x - s * y, east + s * x + c * y) for x, y in WHEELS_M])
    spots = np.array([-1.0, 0.0, 1.0]) * FOOTPRINT_M
    under = wheels[:, :, None, None] + np.stack(np.meshgrid(spots, spots))
    soil = terrain.elevation(under[:, 0], under[:, 1]).mean(axis=(1, 2))
    design = np.column_stack([np.ones(6), wheels - (north, east)])
    height, to_north, to_east = np.linalg.lstsq(design, soil, rcond=None)[0]
    down = np.array([to_north, to_east, 1.0]) / np.linalg.norm([to_north, to_east, 1.0])
    forward = np.array([c, s, 0.0]) - down * (c * down[0] + s * down[1])
    forward /= np.linalg.norm(forward)
    rotation = np.column_stack([forward, np.cross(down, forward), down])
    return Pose(LSL, rover, rotation, np.array([north, east, -height - GROUND_M / down[2]]))


def stop_ids(params: TraverseParams, rng: np.random.Generator) -> tuple[StopId, ...]:
    """Site and drive counters; a new site starts with drive 0."""
    ids, drive = [], 0
    for k in range(params.stops):
        site, place = divmod(k, params.stops_per_site)
        drive = 0 if place == 0 else drive + int(rng.integers(40, 120))
        ids.append(StopId("MER2", params.first_site + site, drive))
    return tuple(ids)


def drive_traverse(
    truths: tuple[Pose, ...],
    ids: tuple[StopId, ...],
    params: TraverseParams,
    rng: np.random.Generator,
) -> tuple[Stop, ...]:
    """The stops of a traverse with true poses, with telemetry."""
    stops: list[Stop] = []
    estimated, drift, slip = truths[0], 0.0, 0.0
    for k, (truth, stop_id) in enumerate(zip(truths, ids, strict=True)):
        if k:
            slip = rng.uniform(*params.slip)
            drift += rng.normal(0.0, params.drift)
            way = truth.translation_m - truths[k - 1].translation_m
            turn = rotation_of_roll_pitch_yaw(0.0, 0.0, drift)
            position = estimated.translation_m + (1 + slip) * turn @ way
            position = position + rng.normal(0.0, params.position_m, 3)
            error = _attitude_error(params, drift, rng)
            estimated = Pose(LSL, stop_id.frame, error @ truth.rotation, position)
        declared = stop_id.drive == 0
        origin = estimated.translation_m if declared else stops[-1].lsl_from_site.translation_m
        sol = params.first_sol + k
        hour = rng.uniform(*params.local_solar_hours)
        sun = sun_at(sol, hour)
        if params.suns:
            sun = params.suns[k % len(params.suns)]
            hour = hour_of(sun)
        stops.append(
            Stop(
                id=stop_id,
                sol=sol,
                local_solar_hour=hour,
                sun=sun,
                slip=slip,
                lsl_from_rover=truth,
                telemetry_lsl_from_rover=estimated,
                lsl_from_site=Pose(LSL, site_frame(stop_id.site), np.eye(3), origin),
            )
        )
    return tuple(stops)


def _attitude_error(params: TraverseParams, drift: float, rng: np.random.Generator) -> Rotation:
    roll, pitch = rng.normal(0.0, params.tilt, 2)
    return rotation_of_roll_pitch_yaw(float(roll), float(pitch), drift)


def solar_longitude(sol: int) -> float:
    """L_s of a sol of Spirit, radians: mean motion from its landing."""
    return float(np.deg2rad((327.7 + 0.5242 * sol) % 360))


def sun_at(sol: int, local_solar_hour: float) -> Sun:
    """Direction of the sun over Spirit's landing site."""
    declination = np.arcsin(np.sin(OBLIQUITY) * np.sin(solar_longitude(sol)))
    angle = (local_solar_hour - 12) * np.pi / 12
    sun: Vector3 = np.array(
        [
            np.sin(declination) * np.cos(LATITUDE)
            - np.cos(declination) * np.sin(LATITUDE) * np.cos(angle),
            -np.cos(declination) * np.sin(angle),
            np.sin(declination) * np.sin(LATITUDE)
            + np.cos(declination) * np.cos(LATITUDE) * np.cos(angle),
        ]
    )
    return Sun(float(np.arctan2(sun[1], sun[0]) % (2 * np.pi)), float(np.arcsin(sun[2])))


def hour_of(sun: Sun) -> float:
    """Local solar hour of a sun that rises in the east and passes overhead at noon."""
    hours = (np.pi / 2 - sun.elevation) * 12 / np.pi
    return float(12 - hours if np.sin(sun.azimuth) > 0 else 12 + hours)
