"""How well the same feature agrees when seen from different places (Di et al. 2008, section 3.3).

Without ground control the quality of an adjustment shows in two numbers. In the ground: the
distance between the places that two pairs give the same point, each by its own parallax. In the
image: the distance between where a pair measured a point and where its place, the weighted mean
of what all pairs say, projects to. Both are means of absolute values: 3-D over every two
observations of a point in different pairs, 2-D over all observations of such points; cross-site
where the point is seen from more than one stop (3-D: from these two), inter-stereo otherwise.
"""

from __future__ import annotations

import numpy as np

from photogrammetry.adjustment.collinearity import Observations, State, misclosures
from photogrammetry.adjustment.records import Consistency
from photogrammetry.adjustment.sightings import Sightings, in_lsl, with_points
from photogrammetry.imagery import TieKind


def comparisons(observations: Observations, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every two used stereo observations of one point in different pairs."""
    rows = np.flatnonzero(used & observations.is_stereo)
    rows = rows[np.argsort(observations.point[rows], kind="stable")]
    points = observations.point[rows]
    first, second = [], []
    for lag in range(1, len(rows)):
        same = np.flatnonzero(points[lag:] == points[:-lag])
        if not len(same):
            break
        first.append(rows[same])
        second.append(rows[same + lag])
    if not first:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    a, b = np.concatenate(first), np.concatenate(second)
    differ = observations.pair[a] != observations.pair[b]
    return a[differ], b[differ]


def consistency(
    observations: Observations,
    state: State,
    seen: Sightings,
    used: np.ndarray,
    compared: tuple[np.ndarray, np.ndarray],
) -> dict[TieKind, Consistency]:
    """Agreement of the used observations at a state, by kind of tie; see `comparisons`."""
    a, b = compared
    apart_m = np.linalg.norm(
        in_lsl(state, observations, seen, a) - in_lsl(state, observations, seen, b), axis=1
    )
    across = observations.stop[a] != observations.stop[b]
    is_cross = np.zeros(observations.points, dtype=bool)
    is_cross[observations.point[a[across]]] = True
    is_compared = np.zeros(observations.points, dtype=bool)
    is_compared[observations.point[a]] = True
    fused = with_points(state, observations, seen, used & is_compared[observations.point])
    rows = np.unique(np.concatenate([a, b]))
    off_px = np.linalg.norm(misclosures(fused, observations, rows)[:, :2], axis=1)
    cross_rows = is_cross[observations.point[rows]]
    return {
        kind: Consistency(int(apart.sum()), _mean(off_px[off]), _mean(apart_m[apart]))
        for kind, apart, off in (
            (TieKind.INTER_STEREO, ~across, ~cross_rows),
            (TieKind.CROSS_SITE, across, cross_rows),
        )
    }


def _mean(values: np.ndarray) -> float:
    """Mean of what is there; a point behind a camera has no image to compare."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if len(there) else float("nan")
