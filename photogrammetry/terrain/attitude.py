"""Strike and dip of a plane, and how sure they are.

With the normal pointing up, n = (sin D sin A, sin D cos A, cos D) in (east, north, up): D is the
dip, A the azimuth of the dip, and the strike is A - 90 degrees (right-hand rule: looking along
it, the plane falls to the right). An error of the normal along the horizontal turns the strike
by 1 / sin D of it, so the strike of a level plane is nobody's to say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.plane_fit import PlaneFit

LEVEL = 3.0
"""Standard deviations within which a level plane leaves the strike undefined."""


@dataclass(frozen=True, slots=True)
class Attitude:
    """Strike and dip, radians."""

    strike: float
    """Azimuth, clockwise from north: looking along it the plane falls to the right."""
    dip: float
    """Below the horizontal, 0 to pi/2."""
    sigma_strike: float
    sigma_dip: float

    @property
    def dip_direction(self) -> float:
        """Azimuth in which the plane falls most steeply."""
        return float((self.strike + np.pi / 2) % (2 * np.pi))


def attitude(plane: PlaneFit) -> Attitude:
    """Strike and dip of a plane.

    Raises:
        TerrainError: the plane is level as far as can be told, so that it has no strike.
    """
    east, north, up = plane.normal
    dip = float(np.arctan2(np.hypot(east, north), up))
    azimuth = float(np.arctan2(east, north))
    along = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    downward = np.cross(along, plane.normal)
    sigma_along, sigma_dip = (
        float(np.sqrt(max(0.0, axis @ plane.covariance @ axis))) for axis in (along, downward)
    )
    if dip <= LEVEL * max(sigma_along, sigma_dip):
        raise TerrainError(
            f"the plane dips by {np.degrees(dip):.2f} +- {np.degrees(sigma_dip):.2f} degrees: it "
            "is level as far as can be told, and its strike is undefined"
        )
    return Attitude(
        strike=float((azimuth - np.pi / 2) % (2 * np.pi)),
        dip=dip,
        sigma_strike=sigma_along / float(np.sin(dip)),
        sigma_dip=sigma_dip,
    )
