"""Whether one place can be seen from another, by the ground between them.

The line from the eye at height 0 share of the way to the target runs over the ground h(s). It is

    blocked     where known ground reaches above it,
    doubtful    where it passes a long stretch whose ground was not seen,

and free otherwise. The clearance is the smallest height of the line over known ground. Blocking
ground outweighs doubtful ground, as in `viewshed`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, PerPoint, Vector3
from solmap.photogrammetry.terrain.dtm.resampling import MapPoints
from solmap.photogrammetry.terrain.viewshed import Sight

NEAR_M = 0.3
"""Ground so near to either end does not block: it carries the end."""


@dataclass(frozen=True, slots=True, eq=False)
class SightLine:
    """The line between an eye and a target, and the ground below it."""

    sight: Sight
    distance_m: PerPoint
    """Of stations, from the eye on the map."""
    places: MapPoints
    line_m: PerPoint
    """Elevation of the line."""
    ground_m: PerPoint
    """Elevation of the ground; NaN where it is not known."""
    clearance_m: float | None
    """Least height over known ground; None where none is known."""
    obstruction: int | None
    """The station where the line is farthest below the ground, if it is anywhere."""
    unseen_m: float
    """Longest stretch of unknown ground that the line passes."""


def places_between(eye: Vector3, target: Vector3, step_m: float) -> MapPoints:
    """Stations on the map from an eye to a target, both (east, north, up), ends included."""
    length = float(np.hypot(*(target - eye)[:2]))
    share = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / step_m)) + 1))
    return eye[:2] + share[:, None] * (target - eye)[:2]


def sight_line(
    eye: Vector3,
    target: Vector3,
    places: MapPoints,
    ground_m: PerPoint,
    max_unseen_m: float,
) -> SightLine:
    """What the ground at the stations of `places_between` lets an eye see of a target."""
    share = np.linspace(0.0, 1.0, len(places))
    length = float(np.hypot(*(target - eye)[:2]))
    distance, line = share * length, eye[2] + share * (target - eye)[2]
    counts = (distance > NEAR_M) & (distance < length - NEAR_M)
    room = np.where(counts & np.isfinite(ground_m), line - ground_m, np.inf)
    lowest = int(np.argmin(room))
    clearance = float(room[lowest]) if np.isfinite(room[lowest]) else None
    unseen = _longest(distance, np.isfinite(ground_m))
    blocked = clearance is not None and clearance < 0
    sight = Sight.HIDDEN if blocked else Sight.UNKNOWN if unseen > max_unseen_m else Sight.VISIBLE
    obstruction = lowest if blocked else None
    return SightLine(sight, distance, places, line, ground_m, clearance, obstruction, unseen)


def _longest(distance: PerPoint, known: np.ndarray) -> float:
    """Longest stretch without known ground, from the first known ground on.

    The unseen ground around the eye does not count: a mast stands on it and looks over it.
    """
    stations: Float64[np.ndarray, " k"] = distance[known]
    if not len(stations):
        return float(distance[-1])
    return float(np.diff(np.append(stations, distance[-1])).max())
