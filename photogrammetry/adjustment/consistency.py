"""How well the same feature agrees when seen from different places (Di et al. 2008, section 3.3).

Without ground control the quality of an adjustment shows in two numbers. In the ground: the
distance between the places that two pairs give the same point, each by its own parallax. In the
image: the distance between where a pair measured a point and where its place, the weighted mean
of what all pairs say, projects to. Both are means of absolute values: 3-D over every two
observations of a point in different pairs, 2-D over all observations of such points; cross-site
where the point is seen from more than one stop (3-D: from these two), inter-stereo otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.collinearity import Observations, Sights, Views
from solmap.photogrammetry.adjustment.records import Consistency
from solmap.photogrammetry.adjustment.sightings import Sightings, WeightedSightings, in_lsl
from solmap.photogrammetry.arrays import Bool
from solmap.photogrammetry.imagery import TieKind


@dataclass(frozen=True, slots=True, eq=False)
class Comparisons:
    """Every two used stereo observations of one point in different pairs."""

    rows: np.ndarray
    """Observations that are compared, those of a point together."""
    first: np.ndarray
    """Places in `rows` of the one, and of the other."""
    second: np.ndarray
    across: Bool[np.ndarray, " m"]
    """Whether the two are of different stops."""
    of_cross: Bool[np.ndarray, " n"]
    """Whether the point of an observation is seen from several stops."""
    sights: Sights
    """The observations."""
    weighted: WeightedSightings
    """What they see."""

    @classmethod
    def of(
        cls, observations: Observations, seen: Sightings, used: Bool[np.ndarray, " k"]
    ) -> Comparisons:
        """Of the observations in use."""
        rows = np.flatnonzero(used & observations.is_stereo)
        rows = rows[np.argsort(observations.point[rows], kind="stable")]
        point, pair = observations.point[rows], observations.pair[rows]
        apart = [np.zeros((2, 0), dtype=np.int64)]
        for lag in range(1, len(rows)):
            same = np.flatnonzero(point[lag:] == point[:-lag])
            if not len(same):
                break
            apart.append(np.stack([same, same + lag]))
        both = np.concatenate(apart, axis=1)
        a, b = both[:, pair[both[0]] != pair[both[1]]]
        stop = observations.pair_stop[pair]
        across = stop[a] != stop[b]
        is_compared, is_cross = np.zeros((2, observations.points), dtype=bool)
        is_compared[point[a]] = True
        is_cross[point[a[across]]] = True
        stays = is_compared[point]
        place, rows = np.cumsum(stays) - 1, rows[stays]
        sights = observations.sights.at(rows)
        weighted = WeightedSightings.of(observations, seen, rows)
        return cls(rows, place[a], place[b], across, is_cross[sights.point], sights, weighted)


def consistency(
    observations: Observations, views: Views, seen: Sightings, compared: Comparisons
) -> dict[TieKind, Consistency]:
    """Agreement of the used observations at a state, by kind of tie."""
    across, of_cross, weighted = compared.across, compared.of_cross, compared.weighted
    place = in_lsl(views, observations, seen, compared.rows)
    one, other = (np.take(place, rows, axis=1) for rows in (compared.first, compared.second))
    apart_m = _lengths(one - other)
    fused = np.full((3, observations.points), np.nan)
    fused[:, weighted.numbers] = weighted.means(views, place)
    off_px = _lengths(views.at(fused).misclosures(compared.sights)[:2])
    return {
        kind: Consistency(int(apart.sum()), _mean(off_px[off]), _mean(apart_m[apart]))
        for kind, apart, off in (
            (TieKind.INTER_STEREO, ~across, ~of_cross),
            (TieKind.CROSS_SITE, across, of_cross),
        )
    }


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """Of vectors, component by component."""
    return np.sqrt(np.einsum("cn,cn->n", vectors, vectors))


def _mean(values: np.ndarray) -> float:
    """Mean of what is there; a point behind a camera has no image to compare."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if len(there) else float("nan")
