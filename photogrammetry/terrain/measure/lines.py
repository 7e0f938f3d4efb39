"""Profiles, lengths and directions of lines on the map.

Stations are at equal distances along every leg of the line, including its corners. The slope at a
station is that of the best straight line through the elevations within half a baseline before and
behind it,

    tan a = sum (s - s0)(h - h0) / sum (s - s0)^2,

positive uphill in the direction of the line. Errors common to all elevations cancel. The rest
counts as only two independent values, the means of both halves, half a baseline apart, because
neighbouring cells of a terrain model come from the same matching windows. So

    sigma(tan a) = sqrt(2) sigma_h / (L / 2)

with sigma_h the standard deviation of a single elevation without its common part.

Lengths on the ground are sums of straight steps of one baseline: with shorter steps the noise of a
terrain model would make every line longer. A step over ground that was not measured counts with its
length on the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Int32, PerPoint
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.resampling import GroundSamples, MapPoints

SAME_M = 1e-6
"""Points closer than this count as one."""
MOST_STATIONS = 20_000
"""Most stations of one profile, ten times those of a line on a screen."""
LEAST_STATIONS = 3
"""Fewest known stations for a slope."""
LEAST_SPAN = 0.5
"""Fraction of the baseline that they must span."""


@dataclass(frozen=True, slots=True, eq=False)
class Stations:
    """Stations along a line."""

    distance_m: PerPoint
    """Distance along the line on the map, from its first corner."""
    places: MapPoints
    leg: Int32[np.ndarray, " n"]
    """Number of the leg of each station; a leg ends at a corner."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """The ground along a line; NaN where it was not measured."""

    stations: Stations
    ground: GroundSamples
    slope: PerPoint
    """Radians, positive uphill along the line."""
    slope_sigma: PerPoint
    """Radians."""


def stations(corners: MapPoints, step_m: float) -> Stations:
    """Stations along a line at most `step_m` apart, including every corner.

    Raises:
        TerrainError: the line has no length, or too many stations.
    """
    lengths = np.hypot(*np.diff(corners, axis=0).T)
    total = float(lengths.sum())
    if not (total > SAME_M and step_m > 0):
        raise TerrainError("a profile needs a line through at least two different points")
    if total / step_m > MOST_STATIONS:
        raise TerrainError(
            f"a line of {total:.0f} m has more than {MOST_STATIONS} stations of {step_m:g} m; use "
            f"a step of {total / MOST_STATIONS:.2g} m or more"
        )
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    distance, places, legs = [np.zeros(1)], [corners[:1]], [np.zeros(1, np.int32)]
    for number, length in enumerate(lengths.tolist()):
        if length > SAME_M:
            share = np.arange(1, math.ceil(length / step_m - 1e-9) + 1)
            share = share / len(share)
            distance.append(starts[number] + share * length)
            step = corners[number + 1] - corners[number]
            places.append(corners[number] + share[:, None] * step)
            legs.append(np.full(len(share), number, np.int32))
    return Stations(np.concatenate(distance), np.concatenate(places), np.concatenate(legs))


def profile(along: Stations, ground: GroundSamples, baseline_m: float) -> Profile:
    """The slope at every station over a baseline, with the ground there."""
    if not baseline_m > 0:
        raise TerrainError(f"the baseline of a slope must be above zero, not {baseline_m:g} m")
    tangent = _tangent(along.distance_m, ground.elevation, baseline_m)
    own = np.where(np.isfinite(tangent), ground.own_sigma_m, np.nan)
    sigma = math.sqrt(2.0) * own / (baseline_m / 2)
    return Profile(along, ground, np.arctan(tangent), sigma / (1 + tangent**2))


def _tangent(s: PerPoint, h: PerPoint, baseline_m: float) -> PerPoint:
    """Rise per metre of the line through all known stations within half a baseline.

    Sums over the window of every station are differences of running sums.
    """
    known = np.isfinite(h)
    low = np.searchsorted(s, s - baseline_m / 2 - 1e-9)
    high = np.searchsorted(s, s + baseline_m / 2 + 1e-9, side="right")
    middle = float(h[known].mean()) if known.any() else 0.0
    rise, along = np.where(known, h - middle, 0.0), np.where(known, s - s.mean(), 0.0)

    def window_sum(values: PerPoint) -> PerPoint:
        running = np.concatenate([[0.0], np.cumsum(values)])
        return running[high] - running[low]

    count = window_sum(known.astype(np.float64))
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = window_sum(along**2) - window_sum(along) ** 2 / count
        tangent = (window_sum(along * rise) - window_sum(along) * window_sum(rise) / count) / spread
        span = np.sqrt(12.0 * np.maximum(spread, 0.0) / count)  # of stations at equal distances
    enough = known & (count >= LEAST_STATIONS) & (span >= LEAST_SPAN * baseline_m)
    return np.where(enough, tangent, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class LineMeasures:
    """A line on the map and on the ground."""

    map_length_m: float
    surface_length_m: float
    """Length along the ground, by steps of the stations."""
    measured_share: float
    """Part of the line, on the map, whose steps have elevations at both ends."""
    leg_length_m: PerPoint
    leg_azimuth: PerPoint
    """Radians, clockwise from the map's north, 0 to 2 pi."""


@dataclass(frozen=True, slots=True)
class Rise:
    """Difference of elevation between two points."""

    map_length_m: float
    rise_m: float
    sigma_rise_m: float
    straight_m: float
    """Straight length in space."""
    slope: float
    """Radians, positive where the second point is higher."""
    sigma_slope: float


def measure_line(corners: MapPoints, along: Stations, ground: GroundSamples) -> LineMeasures:
    """Length and directions of a line whose ground was sampled at stations."""
    legs = np.diff(corners, axis=0)
    steps = np.diff(along.distance_m)
    climbs = np.diff(ground.elevation)
    known = np.isfinite(climbs)
    surface = np.where(known, np.hypot(steps, np.where(known, climbs, 0.0)), steps)
    total = float(along.distance_m[-1])
    return LineMeasures(
        map_length_m=total,
        surface_length_m=float(surface.sum()),
        measured_share=float(steps[known].sum() / total),
        leg_length_m=np.hypot(*legs.T),
        leg_azimuth=np.arctan2(legs[:, 0], legs[:, 1]) % (2 * np.pi),
    )


def rise_between(places: MapPoints, ground: GroundSamples) -> Rise:
    """Difference of elevation and slope from the first of two points to the second.

    The common part of their poses' errors cancels if both are from one model.

    Raises:
        TerrainError: a point has no elevation, or both are the same.
    """
    heights = ground.elevation
    if not np.isfinite(heights).all():
        raise TerrainError("one of the two points has no elevation: choose points on mapped ground")
    run = float(np.hypot(*(places[1] - places[0])))
    if not run > 0:
        raise TerrainError("both points are the same: there is no slope between them")
    rise = float(heights[1] - heights[0])
    same = ground.source[0] == ground.source[1]
    sigma = float(np.linalg.norm(ground.own_sigma_m if same else ground.sigma_m))
    tangent = rise / run
    slope, sigma_slope = np.arctan(tangent), sigma / run / (1 + tangent**2)
    return Rise(run, rise, sigma, float(np.hypot(run, rise)), float(slope), float(sigma_slope))
