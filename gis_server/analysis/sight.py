"""Lines of sight: whether one place can be seen from another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel

from solmap.gis_server.analysis.bodies import SIGHT_NAMES, UNITS, LayerUsed, number, numbers
from solmap.gis_server.analysis.ground import Ground
from solmap.gis_server.analysis.measures import used_in
from solmap.gis_server.analysis.refusal import RefusedError
from solmap.photogrammetry.arrays import Vector3
from solmap.photogrammetry.terrain.visibility.viewshed import places_between, sight_line

FARTHEST_M = 2000.0
"""Longest line of sight, and largest radius of a viewshed."""
_MOST_STATIONS = 2000


class SightAnswer(BaseModel):
    """Whether one place can be seen from another, and the ground between."""

    units: str = UNITS
    sight: str
    """visible, hidden or unknown."""
    clearance_m: float | None
    """Least height of the line over known ground; below zero, how far it runs under it."""
    obstruction: tuple[float, float, float] | None
    """(east, north, elevation) of the ground that is most in the way."""
    obstruction_distance_m: float | None
    unseen_m: float
    """Longest stretch of unmapped ground on the way."""
    eye_elevation_m: float
    target_elevation_m: float
    map_distance_m: float
    distance_m: list[float | None]
    ground_m: list[float | None]
    line_m: list[float | None]
    layers: list[LayerUsed]


@dataclass(frozen=True, slots=True)
class End:
    """One end of a line of sight."""

    place: tuple[float, float]
    elevation_m: float | None
    """Of the ground; None: the map's."""
    height_m: float
    """Above it."""


def line_of_sight(eye: End, target: End, max_unseen_m: float, ground: Ground) -> SightAnswer:
    """Whether a target above one place can be seen from an eye above another."""
    start, end = (raised(e.place, e.elevation_m, e.height_m, ground) for e in (eye, target))
    length = float(np.hypot(*(end - start)[:2]))
    if not 0 < length <= FARTHEST_M:
        raise RefusedError(
            f"a line of sight is longer than 0 m and no longer than {FARTHEST_M:g} m; this one has "
            f"{length:.1f} m"
        )
    places = places_between(start, end, max(ground.finest_cell_m, length / _MOST_STATIONS))
    read = ground.at(places)
    found = sight_line(start, end, places, read.elevation, max_unseen_m)
    where = found.obstruction
    return SightAnswer(
        sight=SIGHT_NAMES[found.sight],
        clearance_m=number(found.clearance_m),
        obstruction=None
        if where is None
        else (
            round(float(places[where, 0]), 4),
            round(float(places[where, 1]), 4),
            round(float(found.ground_m[where]), 4),
        ),
        obstruction_distance_m=None if where is None else number(float(found.distance_m[where])),
        unseen_m=round(found.unseen_m, 3),
        eye_elevation_m=round(float(start[2]), 4),
        target_elevation_m=round(float(end[2]), 4),
        map_distance_m=round(length, 4),
        distance_m=numbers(found.distance_m),
        ground_m=numbers(found.ground_m),
        line_m=numbers(found.line_m),
        layers=used_in(read, ground),
    )


def raised(
    place: tuple[float, float], elevation: float | None, height_m: float, ground: Ground
) -> Vector3:
    """(east, north, up) of what is so high above the ground, the map's where none is given.

    Raises:
        RefusedError: the map has no elevation there.
    """
    if elevation is None:
        found = float(ground.elevation(np.array([place]))[0])
        if not np.isfinite(found):
            raise RefusedError(
                f"the ground at east {place[0]:.2f}, north {place[1]:.2f} has no elevation: stand "
                "on mapped ground, or give its elevation"
            )
        elevation = found
    return np.array([*place, elevation + height_m])
