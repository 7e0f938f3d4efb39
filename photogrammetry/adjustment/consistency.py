"""How well the same feature agrees when seen from different places (Di et al. 2008, section 3.3).

Without ground control the quality of an adjustment shows in two numbers. For every two
observations of a tie point in different pairs, in the ground: the distance between the places
that the two pairs give the point, each by its own parallax; and in the image: the distance
between where the second pair measured the point and where the place given by the first projects
to. Both are means of absolute values; cross-site over pairs of different stops, inter-stereo over
pairs of one stop.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from photogrammetry.adjustment.collinearity import (
    Observations,
    State,
    misclosures,
    triangulated,
)
from photogrammetry.adjustment.records import Consistency
from photogrammetry.imagery import TieKind


def comparisons(observations: Observations, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All ordered couples of used stereo observations of one point in different pairs."""
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
    a, b = a[differ], b[differ]
    return np.concatenate([a, b]), np.concatenate([b, a])


def consistency(
    observations: Observations, state: State, used: np.ndarray
) -> dict[TieKind, Consistency]:
    """Agreement of the used observations at a state, by kind of tie."""
    a, b = comparisons(observations, used)
    places = triangulated(state, observations)
    apart_m = np.linalg.norm(places[a] - places[b], axis=1)
    seen = replace(state, points=places)
    off_px = np.full(len(a), np.nan)
    if len(a):
        doubled = replace(
            observations,
            point=a.astype(np.int32),
            pair=observations.pair[b],
            measured=observations.measured[b],
            weight=observations.weight[b],
        )
        off_px = np.linalg.norm(misclosures(seen, doubled, np.arange(len(a)))[:, :2], axis=1)
    across = observations.stop[a] != observations.stop[b]
    result = {}
    for kind, rows in ((TieKind.INTER_STEREO, ~across), (TieKind.CROSS_SITE, across)):
        in_front = rows & np.isfinite(off_px)
        result[kind] = Consistency(
            int(rows.sum()) // 2,
            float(off_px[in_front].mean()) if in_front.any() else float("nan"),
            float(apart_m[rows].mean()) if rows.any() else float("nan"),
        )
    return result
