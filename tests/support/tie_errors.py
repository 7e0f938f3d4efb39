"""Ties held against the truth: where the ground of the first measurement lies in the second pair.

The true parallax of the left point of the first pair gives its true ground point; that point in the
true camera of the second pair is where the conjugate should be. Nothing of the poses that were
found enters.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from solmap.photogrammetry.matching.records import Ties
from tests.support.simulated_stops import SimulatedStop, true_pair


@dataclass(frozen=True, slots=True, eq=False)
class TieErrors:
    """Errors of n ties; NaN where the truth does not show the point."""

    left_px: np.ndarray
    """(sample, line) of the second left point, measured less true; n x 2."""
    first_parallax_px: np.ndarray
    second_parallax_px: np.ndarray
    range_m: np.ndarray
    """Along the axes of the first and the second pair; n x 2."""


def tie_errors(ties: Ties, one: SimulatedStop, other: SimulatedStop) -> TieErrors:
    """The errors of ties between two stops of one world."""
    n = len(ties)
    ids = [[pair.pair_id for pair in stop.matched.pairs] for stop in (one, other)]
    left, first, second = np.full((n, 2), np.nan), np.full(n, np.nan), np.full(n, np.nan)
    range_m = np.full((n, 2), np.nan)
    for a, b in {*zip(ties.first.tolist(), ties.second.tolist(), strict=True)}:
        rows = (ties.first == a) & (ties.second == b)
        j, k = ids[0].index(ties.pair_ids[a]), ids[1].index(ties.pair_ids[b])
        lsl_one, parallax_one = true_pair(one, j)
        lsl_other, parallax_other = true_pair(other, k)
        g, h = one.matched.pairs[j].geometry, other.matched.pairs[k].geometry
        here = _at(parallax_one, ties.first_left[rows])
        points = g.triangulate(ties.first_left[rows], here)
        seen = lsl_other.inverse.apply(lsl_one.apply(points))
        place, _ = h.project(seen)
        left[rows] = ties.second_left[rows] - place
        first[rows] = ties.first_parallax_px[rows] - here
        second[rows] = ties.second_parallax_px[rows] - _at(parallax_other, ties.second_left[rows])
        range_m[rows] = np.column_stack([points[:, 2], seen[:, 2]])
    return TieErrors(left, first, second, range_m)


def _at(parallax: np.ndarray, points: np.ndarray) -> np.ndarray:
    return ndimage.map_coordinates(parallax, points[:, ::-1].T, order=1, cval=np.nan)
