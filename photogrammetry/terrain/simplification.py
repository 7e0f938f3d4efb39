"""Lines with fewer points, none of which crosses or touches another.

Every line is simplified on its own (Douglas and Peucker 1973: no point of it moves away by more
than the tolerance). Lines that then meet each other or themselves are simplified again with half
the tolerance, and again, and are left as they were in the end; so if the lines given do not meet,
those returned do not either.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from solmap.photogrammetry.arrays import Float64

Line = Float64[np.ndarray, "_ 2"]
"""(east, north), metres; the first and last are equal where the line is closed."""
HALVINGS = 4
"""How often the tolerance of a line that meets another is halved before the line is left alone."""


def simplified(lines: Sequence[Line], tolerance_m: float) -> list[Line]:
    """The lines with as few points as the tolerance allows, in the same order."""
    if not lines or not tolerance_m > 0:
        return list(lines)
    given = np.array([shapely.LineString(line) for line in lines])
    kept = shapely.simplify(given, tolerance_m, preserve_topology=False)
    halved = np.zeros(len(given), dtype=int)
    while True:
        meeting = _meeting(kept)
        meeting = meeting[halved[meeting] <= HALVINGS]
        if not len(meeting):
            return [shapely.get_coordinates(line) for line in kept]
        halved[meeting] += 1
        for index in meeting:
            kept[index] = _less_simplified(given[index], tolerance_m, int(halved[index]))


def _less_simplified(line: shapely.LineString, tolerance_m: float, halved: int) -> shapely.Geometry:
    """A line simplified with a tolerance halved so often, or as it is after the last time."""
    if halved > HALVINGS:
        return line
    return shapely.simplify(line, tolerance_m / 2.0**halved, preserve_topology=False)


def _meeting(lines: np.ndarray) -> np.ndarray:
    """Indices of the lines that meet another one or themselves."""
    one, other = shapely.STRtree(lines).query(lines, predicate="intersects")
    return np.union1d(one[one != other], np.flatnonzero(~shapely.is_simple(lines)))
