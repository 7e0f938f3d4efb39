"""The sun over Mars by season, latitude and local solar time, and the dust of the sky.

With the areocentric solar longitude L_s (0 at the northern spring equinox, 90 in the middle of the
southern winter), the obliquity of the axis e and the eccentricity of the orbit k,

    sin delta = sin e sin L_s                                    declination of the sun
    G_0 = G_m (1 + k cos(L_s - L_p))^2 / (1 - k^2)^2             W/m^2 across the beam

(Appelbaum and Flood 1990, Solar radiation on Mars, Solar Energy 45, eq. 4 and 7; G_m = 590 W/m^2 at
the mean distance; obliquity and perihelion L_p by Allison and McEwen 2000, Planet. Space Sci. 48).
At the hour angle w (0 at noon, 15 degrees a Mars hour) and latitude phi, the direction to the sun
in (north, east, up) is

    north = cos phi sin delta - sin phi cos delta cos w
    east  = -cos delta sin w
    up    = sin phi sin delta + cos phi cos delta cos w

The latitude is planetographic: up is the plumb line, to which the inertial unit and the map refer.
At Gusev it is 0.17 degrees more than the planetocentric one.

Dust divides the sun's light into a beam and light from the whole sky. At an optical depth tau, with
the sun at the zenith distance z,

    beam across       G_b = G_0 exp(-tau / cos z)                         Beer's law
    all on level      G_h = G_0 cos z f(z, tau) / (1 - a)
    from the sky      G_d = G_h - G_b cos z

f is the normalised net flux that Pollack computed with multiple scattering for an albedo a = 0.1,
as tabled by Appelbaum and Flood (1990, Solar radiation on Mars, Solar Energy 45, table III). The
table begins at tau = 0.1; without dust f = 1 - a. Below 5 degrees of elevation f is constant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, PerPoint
from solmap.photogrammetry.errors import TerrainError

OBLIQUITY_DEG = 25.19
ECCENTRICITY = 0.0934
PERIHELION_LS_DEG = 250.999
MEAN_IRRADIANCE = 590.0
"""W/m^2 across the beam at the mean distance from the sun, 1.5237 AU (Appelbaum and Flood 1990)."""
SOL_HOURS = 88775.244 / 3600
"""Length of a solar day in clock hours, for watt-hours."""
ALBEDO = 0.1
"""Albedo of the ground for which the net flux is tabled."""
ZENITH_DEG = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 85.0)
NET_FLUX = {
    0.0: (0.9,) * 10,
    0.1: (0.885, 0.883, 0.882, 0.880, 0.876, 0.870, 0.857, 0.830, 0.755, 0.635),
    0.2: (0.866, 0.865, 0.860, 0.858, 0.851, 0.836, 0.813, 0.758, 0.640, 0.470),
    0.3: (0.847, 0.846, 0.841, 0.836, 0.826, 0.806, 0.774, 0.708, 0.562, 0.412),
    0.4: (0.828, 0.827, 0.821, 0.815, 0.802, 0.778, 0.740, 0.667, 0.502, 0.373),
    0.5: (0.810, 0.810, 0.802, 0.796, 0.778, 0.752, 0.708, 0.628, 0.452, 0.342),
    0.6: (0.793, 0.791, 0.785, 0.775, 0.755, 0.725, 0.677, 0.593, 0.414, 0.318),
    0.7: (0.776, 0.773, 0.766, 0.755, 0.733, 0.700, 0.646, 0.555, 0.383, 0.298),
    0.8: (0.760, 0.756, 0.750, 0.736, 0.710, 0.675, 0.616, 0.520, 0.360, 0.280),
    0.9: (0.745, 0.740, 0.733, 0.717, 0.690, 0.650, 0.587, 0.487, 0.336, 0.264),
    1.0: (0.732, 0.725, 0.717, 0.700, 0.670, 0.628, 0.560, 0.455, 0.317, 0.252),
    1.2: (0.697, 0.692, 0.683, 0.662, 0.632, 0.585, 0.518, 0.413, 0.288, 0.230),
    1.4: (0.666, 0.661, 0.650, 0.629, 0.596, 0.546, 0.478, 0.379, 0.262, 0.210),
    1.6: (0.637, 0.630, 0.618, 0.597, 0.563, 0.512, 0.441, 0.348, 0.240, 0.195),
    1.8: (0.609, 0.600, 0.586, 0.568, 0.531, 0.480, 0.408, 0.318, 0.224, 0.181),
    2.0: (0.582, 0.573, 0.558, 0.537, 0.500, 0.448, 0.378, 0.293, 0.208, 0.170),
    2.5: (0.518, 0.509, 0.492, 0.469, 0.430, 0.378, 0.316, 0.242, 0.174, 0.145),
    3.0: (0.460, 0.450, 0.434, 0.414, 0.376, 0.330, 0.273, 0.206, 0.150, 0.128),
    3.5: (0.411, 0.400, 0.387, 0.367, 0.333, 0.290, 0.240, 0.180, 0.132, 0.110),
    4.0: (0.370, 0.360, 0.347, 0.330, 0.296, 0.258, 0.212, 0.160, 0.118, 0.100),
    5.0: (0.294, 0.286, 0.275, 0.258, 0.230, 0.203, 0.166, 0.130, 0.094, 0.080),
    6.0: (0.228, 0.223, 0.215, 0.200, 0.178, 0.153, 0.130, 0.103, 0.080, 0.068),
}
"""Normalised net flux by optical depth, at the zenith distances above; of the published rows above
1.0 every second."""


@dataclass(frozen=True, slots=True)
class Season:
    """A season by the position of the sun."""

    ls_deg: float
    """Areocentric solar longitude."""

    @property
    def declination(self) -> float:
        """Declination of the sun, radians north of the equator."""
        return math.asin(
            math.sin(math.radians(OBLIQUITY_DEG)) * math.sin(math.radians(self.ls_deg))
        )

    @property
    def irradiance(self) -> float:
        """W/m^2 normal to the beam at the top of the atmosphere."""
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


def local_winter(latitude: float) -> Season:
    """The middle of winter in this hemisphere, the critical season of a rover."""
    return Season(90.0 if latitude < 0 else 270.0)


def beam_share(cos_zenith: PerPoint, optical_depth: float) -> PerPoint:
    """Direct sunlight at the ground, as a fraction of the light above the atmosphere."""
    return np.exp(-optical_depth / np.maximum(cos_zenith, 1e-6))


def diffuse_share(cos_zenith: PerPoint, optical_depth: float) -> PerPoint:
    """Skylight on level ground, as the same fraction."""
    net = net_flux(np.degrees(np.arccos(np.clip(cos_zenith, 0, 1))), optical_depth)
    level = cos_zenith * (net / (1 - ALBEDO) - beam_share(cos_zenith, optical_depth))
    return np.maximum(level, 0.0)


def net_flux(zenith_deg: PerPoint, optical_depth: float) -> PerPoint:
    """Normalised net flux at zenith distances, interpolated in the table.

    Raises:
        TerrainError: the optical depth is outside the table.
    """
    depths = np.array(list(NET_FLUX))
    if not depths[0] <= optical_depth <= depths[-1]:
        raise TerrainError(
            f"an optical depth of {optical_depth} is outside the table of net flux, {depths[0]} "
            f"to {depths[-1]}: 0.3 to 1 is usual, a global storm has 4"
        )
    table: Float64[np.ndarray, "depths angles"] = np.array(list(NET_FLUX.values()))
    row = [np.interp(optical_depth, depths, column) for column in table.T]
    return np.interp(zenith_deg, ZENITH_DEG, row)
