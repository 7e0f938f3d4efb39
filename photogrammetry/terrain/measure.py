"""Lengths, areas and directions on the map and on the ground.

Lengths on the ground are of straight steps of one baseline: with shorter steps the noise of a
terrain model would make every line longer. Over ground that was not measured a step has its length
on the map. The area of a polygon on the map is that of the shoelace formula about its own middle,

    A = 1/2 |sum e_i n_(i+1) - e_(i+1) n_i|.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely

from solmap.photogrammetry.arrays import Flags, PerPoint
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.resampling import GroundSamples, MapPoints
from solmap.photogrammetry.terrain.profile import Stations

Elevations = Callable[[MapPoints], PerPoint]
"""Elevation at (east, north); NaN where the ground is not known."""
MOST_PLACES = 250_000
"""Places inside a polygon at which the ground is read."""


@dataclass(frozen=True, slots=True, eq=False)
class LineMeasured:
    """A line on the map and on the ground."""

    map_length_m: float
    surface_length_m: float
    """Along the ground, by steps of the stations."""
    measured_share: float
    """Part of the line, on the map, whose steps have elevations at both ends."""
    leg_length_m: PerPoint
    leg_azimuth: PerPoint
    """Radians, clockwise from the map's north, 0 to 2 pi."""


@dataclass(frozen=True, slots=True)
class Rise:
    """From one place to another."""

    map_length_m: float
    rise_m: float
    sigma_rise_m: float
    straight_m: float
    """In space."""
    slope: float
    """Radians, positive where the second place is higher."""
    sigma_slope: float


def measure_line(corners: MapPoints, along: Stations, ground: GroundSamples) -> LineMeasured:
    """Length and directions of a line whose ground was read at stations."""
    legs = np.diff(corners, axis=0)
    steps = np.diff(along.distance_m)
    climbs = np.diff(ground.elevation)
    known = np.isfinite(climbs)
    surface = np.where(known, np.hypot(steps, np.where(known, climbs, 0.0)), steps)
    total = float(along.distance_m[-1])
    return LineMeasured(
        map_length_m=total,
        surface_length_m=float(surface.sum()),
        measured_share=float(steps[known].sum() / total),
        leg_length_m=np.hypot(*legs.T),
        leg_azimuth=np.arctan2(legs[:, 0], legs[:, 1]) % (2 * np.pi),
    )


def rise_between(places: MapPoints, ground: GroundSamples) -> Rise:
    """Difference of elevation and slope from the first of two places to the second.

    What both share of their poses' error cancels if they are of one model.

    Raises:
        TerrainError: a place has no elevation, or both are one.
    """
    heights = ground.elevation
    if not np.isfinite(heights).all():
        raise TerrainError("one of the two places has no elevation: take places on mapped ground")
    run = float(np.hypot(*(places[1] - places[0])))
    if not run > 0:
        raise TerrainError("there is no slope between a place and itself")
    rise = float(heights[1] - heights[0])
    same = ground.source[0] == ground.source[1]
    sigma = float(np.linalg.norm(ground.own_sigma_m if same else ground.sigma_m))
    tangent = rise / run
    slope, sigma_slope = np.arctan(tangent), sigma / run / (1 + tangent**2)
    return Rise(run, rise, sigma, float(np.hypot(run, rise)), float(slope), float(sigma_slope))


def polygon_of(corners: MapPoints) -> shapely.Polygon:
    """The polygon of a ring of corners, closed or not.

    Raises:
        TerrainError: it crosses itself or has no area.
    """
    polygon = shapely.Polygon(corners)
    if not polygon.is_valid or not polygon.area > 0:
        why = shapely.is_valid_reason(polygon)
        raise TerrainError(f"the corners span no simple polygon ({why}): draw it without crossing")
    return polygon


def places_inside(
    polygon: shapely.Polygon, cell_m: float, most: int = MOST_PLACES
) -> tuple[MapPoints, float]:
    """Centres of the cells of a lattice that lie in a polygon, and the cell: `cell_m` or more.

    The cell is widened where the polygon's box would hold more than `most` of them.

    Raises:
        TerrainError: no centre lies in it.
    """
    west, south, east, north = polygon.bounds
    cell = max(cell_m, float(np.sqrt((east - west) * (north - south) / most)))
    across = west + (np.arange(int(np.ceil((east - west) / cell))) + 0.5) * cell
    down = south + (np.arange(int(np.ceil((north - south) / cell))) + 0.5) * cell
    places = np.stack([axis.ravel() for axis in np.meshgrid(across, down)], axis=1)
    inside: Flags = shapely.contains_xy(polygon, places[:, 0], places[:, 1])
    if not inside.any():
        raise TerrainError(
            f"the polygon of {polygon.area:.3g} m2 holds no cell of {cell:.3g} m: draw a larger one"
        )
    return places[inside], cell


def steepening(places: MapPoints, elevations: Elevations, half_m: float) -> PerPoint:
    """Area of the ground over its area on the map, from its slope over 2 `half_m`; NaN in gaps."""
    squares = np.zeros(len(places))
    for step in half_m * np.eye(2):
        rise = (elevations(places + step) - elevations(places - step)) / (2 * half_m)
        squares += rise**2
    return np.sqrt(1 + squares)
