"""The landing site local frame on Mars: LSL, planetocentric coordinates and the body-fixed frame.

The body-fixed frame is Cartesian, origin in the centre of Mars, z to the north pole, x through the
prime meridian. At a landing point with east longitude lambda and planetocentric latitude phi, at
the distance R from that centre, north, east and down are

    n = (-sin phi cos lambda, -sin phi sin lambda, cos phi)
    e = (-sin lambda,          cos lambda,         0)
    d = -(cos phi cos lambda,  cos phi sin lambda, sin phi)

and p_body = [n e d] p_LSL - R d. The LSL is Cartesian, so what it calls level leaves the sphere
by D^2 / 2R: 0.15 m at 1 km, 15 m at 10 km. Seen along -d its points make the orthographic map of
the tangent plane, east = y and north = x, exactly.

R is the radius of the local ground; that of IAU_2015:49900 and of most Mars maps is 3396190 m.
Longitudes run east. With the axes a and c of the ellipsoid, tan(planetographic latitude) =
tan(planetocentric latitude) a²/c²: at Gusev crater 0.166 degrees or 9.8 km apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import ObjectPoints, PerPoint
from solmap.photogrammetry.errors import FrameError
from solmap.photogrammetry.frames import BODY_FIXED, LSL, Pose

MARS_RADIUS_M = 3_396_190.0
"""Sphere of IAU_2015:49900; also the equatorial radius a of the ellipsoid."""
MARS_POLAR_RADIUS_M = 3_376_200.0
"""c of the IAU ellipsoid of Mars."""


@dataclass(frozen=True, slots=True)
class MarsPoint:
    """A place on Mars: east longitude and planetocentric latitude, radians."""

    longitude: float
    latitude: float
    radius_m: float = MARS_RADIUS_M
    """Distance from the centre of Mars."""

    def __post_init__(self) -> None:
        finite = all(map(math.isfinite, (self.longitude, self.latitude, self.radius_m)))
        if not finite or abs(self.latitude) > math.pi / 2 or self.radius_m <= 0:
            raise FrameError(
                f"no place on Mars: longitude {self.longitude} and latitude {self.latitude} "
                f"(radians, not degrees), {self.radius_m} m from its centre"
            )


def body_from_lsl(landing_point: MarsPoint) -> Pose:
    """The LSL at a landing point, in the body-fixed frame."""
    sin_lon, cos_lon = math.sin(landing_point.longitude), math.cos(landing_point.longitude)
    sin_lat, cos_lat = math.sin(landing_point.latitude), math.cos(landing_point.latitude)
    north = np.array([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat])
    east = np.array([-sin_lon, cos_lon, 0.0])
    down = -np.array([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat])
    rotation = np.column_stack([north, east, down])
    return Pose(BODY_FIXED, LSL, rotation, -landing_point.radius_m * down)


def geographic(points_in_body: ObjectPoints) -> tuple[PerPoint, PerPoint, PerPoint]:
    """East longitude in (-pi, pi], planetocentric latitude, distance from the centre in metres."""
    x, y, z = points_in_body.T
    level = np.hypot(x, y)
    return np.arctan2(y, x), np.arctan2(z, level), np.hypot(level, z)


def body_fixed(longitude: PerPoint, latitude: PerPoint, radius_m: PerPoint) -> ObjectPoints:
    """Body-fixed points of places on Mars; the twin of `geographic`."""
    level = radius_m * np.cos(latitude)
    return np.column_stack(
        [level * np.cos(longitude), level * np.sin(longitude), radius_m * np.sin(latitude)]
    )


def map_from_lsl(points_in_lsl: ObjectPoints) -> ObjectPoints:
    """(east, north, up) on the tangent plane of (north, east, down)."""
    return points_in_lsl[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])


def planetographic(latitude: float) -> float:
    """Planetographic latitude of a planetocentric one, radians."""
    ratio = (MARS_RADIUS_M / MARS_POLAR_RADIUS_M) ** 2
    return math.atan2(ratio * math.sin(latitude), math.cos(latitude))


def planetocentric(latitude: float) -> float:
    """Planetocentric latitude of a planetographic one, radians."""
    ratio = (MARS_POLAR_RADIUS_M / MARS_RADIUS_M) ** 2
    return math.atan2(ratio * math.sin(latitude), math.cos(latitude))
