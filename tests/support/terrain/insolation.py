"""Insolation above the atmosphere in closed form: what maps of insolation are compared with."""

import math

from solmap.photogrammetry.terrain.insolation.sun import SOL_HOURS, Season, half_day


def daily_insolation_above(latitude: float, season: Season) -> float:
    """Wh/m^2 a sol on level ground without an atmosphere (Appelbaum and Flood 1990, eq. 13)."""
    delta = season.declination
    w = half_day(latitude, delta)
    day = w * math.sin(latitude) * math.sin(delta) + math.cos(latitude) * math.cos(
        delta
    ) * math.sin(w)
    return season.irradiance * SOL_HOURS / math.pi * day
