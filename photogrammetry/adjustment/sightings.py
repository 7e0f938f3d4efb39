"""What single observations see: a point by its own parallax, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from photogrammetry.adjustment.collinearity import Observations, State, triangulated_in_pair
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.rotations import rotation_of_vector
from photogrammetry.arrays import Covariances3, Float64


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Every observation's own point in its rover frame, with covariance; which may align."""

    points: np.ndarray
    covariances: np.ndarray
    usable: np.ndarray
    size: np.ndarray
    """Sum of the three variances, square metres."""


def sightings(
    observations: Observations, pointings: np.ndarray, params: AdjustmentParams
) -> Sightings:
    """Triangulate every observation by itself in the frame of its rover."""
    j = observations.pair
    in_pair = triangulated_in_pair(observations)
    turned = (rotation_of_vector(pointings) @ observations.rover_from_pair)[j]
    arm = (turned @ in_pair[:, :, None])[:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = 1.0 / observations.weight
        along = arm / observations.measured[:, 2:] * sigma[:, 2:]
        across = (in_pair[:, 2] * sigma[:, 0] / observations.focal_px[j]) ** 2
    turn = np.radians(params.pointing_deg) ** 2
    S = _outer(along) - across[:, None, None] * _outer(turned[:, :, 2]) - turn * _outer(arm)
    S[:, range(3), range(3)] += (across + turn * (arm**2).sum(axis=1))[:, None]
    usable = observations.is_stereo & (observations.measured[:, 2] >= params.far_parallax_px)
    size = np.trace(S, axis1=1, axis2=2)
    return Sightings(observations.origins_in_rover(pointings)[j] + arm, S, usable, size)


def _outer(v: Float64[np.ndarray, "n 3"]) -> Covariances3:
    """V v' of many vectors."""
    return v[:, :, None] * v[:, None, :]


def best_sightings(observations: Observations, seen: Sightings, stops: int) -> list[np.ndarray]:
    """For each stop its observations that may align, the best one of each point."""
    rows = np.flatnonzero(seen.usable)
    stop, point = observations.stop[rows], observations.point[rows]
    order = np.lexsort((seen.size[rows], point, stop))
    rows, stop, point = rows[order], stop[order], point[order]
    first = np.ones(len(rows), dtype=bool)
    first[1:] = (point[1:] != point[:-1]) | (stop[1:] != stop[:-1])
    ends = np.searchsorted(stop[first], np.arange(stops + 1))
    best = rows[first]
    return [best[a:b] for a, b in pairwise(ends.tolist())]


Couple = tuple[int, int]
"""Two stops, the earlier one first."""


def shared_sightings(
    observations: Observations, best: list[np.ndarray]
) -> dict[Couple, tuple[np.ndarray, np.ndarray]]:
    """Rows of the points that two stops both saw, by stops (a < b), in ascending order."""
    rows = np.concatenate([*best, np.zeros(0, dtype=np.int64)])
    stops = np.repeat(np.arange(len(best)), [len(ours) for ours in best])
    order = np.lexsort((stops, observations.point[rows]))
    rows, stops = rows[order], stops[order]
    points = observations.point[rows]
    first, second = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for lag in range(1, len(rows)):
        same = np.flatnonzero(points[lag:] == points[:-lag])
        if not len(same):
            break
        first.append(same)
        second.append(same + lag)
    a, b = np.concatenate(first), np.concatenate(second)
    order = np.lexsort((stops[b], stops[a]))
    a, b = a[order], b[order]
    if not len(a):
        return {}
    codes = stops[a] * len(best) + stops[b]
    begin = np.flatnonzero(np.diff(codes, prepend=-1))
    ends = np.append(begin[1:], len(a))
    return {
        divmod(code, len(best)): (rows[a[i:j]], rows[b[i:j]])
        for code, i, j in zip(codes[begin].tolist(), begin.tolist(), ends.tolist(), strict=True)
    }


@dataclass(frozen=True, slots=True, eq=False)
class Overview:
    """All sightings of a network, the best ones, and what stops share."""

    seen: Sightings
    best: list[np.ndarray]
    """As of `best_sightings`."""
    couples: dict[Couple, tuple[np.ndarray, np.ndarray]]
    """As of `shared_sightings`."""

    @classmethod
    def of(
        cls, observations: Observations, pointings: np.ndarray, stops: int, params: AdjustmentParams
    ) -> Overview:
        """Of a network of so many stops."""
        seen = sightings(observations, pointings, params)
        best = best_sightings(observations, seen, stops)
        return cls(seen, best, shared_sightings(observations, best))


def with_points(
    state: State, observations: Observations, seen: Sightings, used: np.ndarray
) -> State:
    """The state with every point at the weighted mean of its used sightings; NaN if none can.

    The weights are the inverse covariances of the sightings, so rays of several stops intersect
    here although each sighting alone is poor in range.
    """
    rows = np.flatnonzero(used & observations.is_stereo)
    number = observations.point[rows]
    place = in_lsl(state, observations, seen, rows)
    points = np.full((observations.points, 3), np.nan)
    points[number] = place
    several = np.bincount(number, minlength=observations.points)[number] > 1
    if several.any():
        mean_of, mean = _weighted_means(state, observations, seen, rows[several], place[several])
        points[mean_of] = mean
    return replace(state, points=points)


def in_lsl(
    state: State, observations: Observations, seen: Sightings, rows: np.ndarray
) -> Float64[np.ndarray, "m 3"]:
    """Where some sightings have their points, in the LSL."""
    stop = observations.stop[rows]
    R = state.rotations[stop]
    return state.centres[stop] + (R @ seen.points[rows][:, :, None])[:, :, 0]


def _weighted_means(
    state: State, observations: Observations, seen: Sightings, rows: np.ndarray, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the points that some sightings see, and the weighted mean place of each."""
    R = state.rotations[observations.stop[rows]]
    P = R @ inverses(seen.covariances[rows]) @ R.mT
    equations = np.concatenate([P, (P @ place[:, :, None])], axis=2).reshape(-1, 12)
    numbers, of = np.unique(observations.point[rows], return_inverse=True)
    at = (12 * of[:, None] + np.arange(12)).ravel()
    sums = np.bincount(at, equations.ravel(), minlength=12 * len(numbers)).reshape(-1, 3, 4)
    return numbers, (inverses(sums[:, :, :3]) @ sums[:, :, 3:])[:, :, 0]


def inverses(S: Covariances3) -> Covariances3:
    """Inverses of many symmetric matrices: cofactors over the determinant.

    For matrices of three rows this is as exact as elimination and ten times as fast.
    """
    a, b, c = S[:, 0, 0], S[:, 0, 1], S[:, 0, 2]
    d, e, f = S[:, 1, 1], S[:, 1, 2], S[:, 2, 2]
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    cofactors = [aa, bb, cc, bb, a * f - c * c, b * c - a * e, cc, b * c - a * e, a * d - b * b]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.stack(cofactors, axis=1) / (a * aa + b * bb + c * cc)[:, None]
    return inverse.reshape(-1, 3, 3)
