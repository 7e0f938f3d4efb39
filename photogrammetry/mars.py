"""Mars: its ellipsoid, latitudes on it, and the map of the landing site local frame.

The LSL is Cartesian, so its horizontal plane departs from the sphere by D^2 / 2R at the distance D
from its origin: 0.15 m at 1 km, 15 m at 10 km. Projected vertically its points form the
orthographic map of the tangent plane, east = y and north = x, exactly.

R of IAU_2015:49900 and of most Mars maps is 3396190 m. Longitudes run east. With the axes a and c
of the ellipsoid, tan(planetographic latitude) = tan(planetocentric latitude) a²/c²: at Gusev crater
the two are 0.166 degrees or 9.8 km apart.
"""

from __future__ import annotations

import math

import numpy as np

from solmap.photogrammetry.arrays import ObjectPoints

MARS_RADIUS_M = 3_396_190.0
"""Sphere of IAU_2015:49900; also the equatorial radius a of the ellipsoid."""
MARS_POLAR_RADIUS_M = 3_376_200.0
"""c of the IAU ellipsoid of Mars."""


def map_from_lsl(points_in_lsl: ObjectPoints) -> ObjectPoints:
    """(east, north, up) on the tangent plane of (north, east, down)."""
    return points_in_lsl[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])


def planetographic(latitude: float) -> float:
    """Planetographic latitude of a planetocentric one, radians."""
    ratio = (MARS_RADIUS_M / MARS_POLAR_RADIUS_M) ** 2
    return math.atan2(ratio * math.sin(latitude), math.cos(latitude))
