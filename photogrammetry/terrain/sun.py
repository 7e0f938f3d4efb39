"""The sun over Mars: by season, latitude and local solar time.

With the areocentric solar longitude L_s (0 at the northern spring equinox, 90 in the middle of the
southern winter), the obliquity of the axis e and the eccentricity of the orbit k,

    sin delta = sin e sin L_s                                    declination of the sun
    G_0 = G_m (1 + k cos(L_s - L_p))^2 / (1 - k^2)^2             W/m^2 across the beam

(Appelbaum and Flood 1990, Solar radiation on Mars, Solar Energy 45, eq. 4 and 7; G_m = 590 W/m^2 at
the mean distance; obliquity and perihelion L_p as Allison and McEwen 2000 have them, Planet. Space
Sci. 48). At the hour angle w (0 at noon, 15 degrees a Mars hour) and latitude phi, the direction to
the sun in (north, east, up) is

    north = cos phi sin delta - sin phi cos delta cos w
    east  = -cos delta sin w
    up    = sin phi sin delta + cos phi cos delta cos w

The latitude is planetographic: up is the plumb line, which the inertial unit and the map follow. At
Gusev it is 0.17 degrees more than the planetocentric one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, PerPoint

OBLIQUITY_DEG = 25.19
ECCENTRICITY = 0.0934
PERIHELION_LS_DEG = 250.999
MEAN_IRRADIANCE = 590.0
"""W/m^2 across the beam at the mean distance from the sun, 1.5237 AU (Appelbaum and Flood 1990)."""
SOL_HOURS = 88775.244 / 3600
"""Length of a solar day in hours of the clock: watt-hours are counted with these."""


@dataclass(frozen=True, slots=True)
class Season:
    """Where the sun stands among the seasons."""

    ls_deg: float
    """Areocentric solar longitude."""

    @property
    def declination(self) -> float:
        """Of the sun, radians north of the equator."""
        return math.asin(
            math.sin(math.radians(OBLIQUITY_DEG)) * math.sin(math.radians(self.ls_deg))
        )

    @property
    def irradiance(self) -> float:
        """W/m^2 across the beam at the top of the atmosphere."""
        along = 1 + ECCENTRICITY * math.cos(math.radians(self.ls_deg - PERIHELION_LS_DEG))
        return MEAN_IRRADIANCE * (along / (1 - ECCENTRICITY**2)) ** 2


def sun_directions(
    latitude: float, declination: float, hour_angle: PerPoint
) -> Float64[np.ndarray, "n 3"]:
    """Unit vectors (north, east, up) to the sun; angles in radians, latitude planetographic."""
    sin_phi, cos_phi = math.sin(latitude), math.cos(latitude)
    sin_delta, cos_delta = math.sin(declination), math.cos(declination)
    cos_w, sin_w = np.cos(hour_angle), np.sin(hour_angle)
    return np.column_stack(
        [
            cos_phi * sin_delta - sin_phi * cos_delta * cos_w,
            -cos_delta * sin_w,
            sin_phi * sin_delta + cos_phi * cos_delta * cos_w,
        ]
    )


def half_day(latitude: float, declination: float) -> float:
    """Hour angle of sunset over a level horizon, radians: 0 in polar night, pi in polar day."""
    cosine = -math.tan(latitude) * math.tan(declination)
    return math.acos(min(1.0, max(-1.0, cosine)))


def daily_insolation_above(latitude: float, season: Season) -> float:
    """Wh/m^2 a sol on level ground without an atmosphere (Appelbaum and Flood 1990, eq. 13)."""
    delta = season.declination
    w = half_day(latitude, delta)
    day = w * math.sin(latitude) * math.sin(delta) + math.cos(latitude) * math.cos(
        delta
    ) * math.sin(w)
    return season.irradiance * SOL_HOURS / math.pi * day


def local_winter(latitude: float) -> Season:
    """The middle of winter in this hemisphere, when a rover needs the sun most."""
    return Season(90.0 if latitude < 0 else 270.0)
