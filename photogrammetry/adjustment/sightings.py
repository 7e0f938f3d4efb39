"""What single observations see: a point by its own parallax, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from photogrammetry.adjustment.collinearity import Observations, State, triangulated_in_pair
from photogrammetry.adjustment.componentwise import (
    Matrices,
    Vectors,
    by_component,
    product,
    turned,
)
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
    rover_from_pair = rotation_of_vector(pointings) @ observations.rover_from_pair
    to_rover = np.take(by_component(rover_from_pair), j, axis=2)
    arm, parallax = turned(to_rover, in_pair.T.copy()), observations.measured[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = arm / (parallax * observations.weight[:, 2])
        across = in_pair[:, 2] / (observations.weight[:, 0] * observations.focal_px[j])
    turn = float(np.radians(params.pointing_deg))
    S, size = _covariances(along, arm * turn, to_rover[:, 2] * across, across**2)
    usable = observations.is_stereo & (parallax >= params.far_parallax_px)
    return Sightings(observations.origins_in_rover(pointings)[j] + arm.T, S, usable, size)


def _covariances(
    along: Vectors, swing: Vectors, ahead: Vectors, across2: Float64[np.ndarray, " m"]
) -> tuple[Covariances3, Float64[np.ndarray, " m"]]:
    """Covariances of points and their traces.

    Of the range `along` the ray; of what turns by an angle's deviation move, which is across
    `swing`, their way times that deviation; and of the variance `across2` across the axis, whose
    direction times the deviation is `ahead`.
    """
    S = np.empty((along.shape[1], 3, 3))
    round_ = across2 + np.einsum("in,in->n", swing, swing)
    size = 3 * round_
    for i in range(3):
        for j in range(i + 1):
            part = along[i] * along[j] - ahead[i] * ahead[j] - swing[i] * swing[j]
            if i == j:
                size += part
                part += round_
            S[:, i, j] = S[:, j, i] = part
    return S, size


def best_sightings(observations: Observations, seen: Sightings, stops: int) -> list[np.ndarray]:
    """For each stop its observations that may align, the best one of each point."""
    rows = np.flatnonzero(seen.usable)
    stop, point = observations.stop[rows], observations.point[rows]
    rank = np.empty(len(rows), dtype=np.int64)
    rank[np.argsort(seen.size[rows])] = np.arange(len(rows))
    order = np.argsort((stop.astype(np.int64) * observations.points + point) * len(rows) + rank)
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
    points[number] = place.T
    several = np.bincount(number, minlength=observations.points)[number] > 1
    if several.any():
        mean_of, mean = means(state, observations, seen, rows[several], place[:, several])
        points[mean_of] = mean.T
    return replace(state, points=points)


def in_lsl(state: State, observations: Observations, seen: Sightings, rows: np.ndarray) -> Vectors:
    """Where some sightings have their points, in the LSL."""
    stop = observations.stop_of(rows)
    R = np.take(by_component(state.rotations), stop, axis=2)
    place = turned(R, seen.points[rows].T.copy())
    place += np.take(state.centres.T, stop, axis=1)
    return place


def means(
    state: State, observations: Observations, seen: Sightings, rows: np.ndarray, place: Vectors
) -> tuple[np.ndarray, Float64[np.ndarray, "3 points"]]:
    """Numbers of the points that some sightings see, and the weighted mean place of each."""
    R = np.take(by_component(state.rotations), observations.stop_of(rows), axis=2)
    S = by_component(seen.covariances[rows])
    P = product(product(R, inverses_by_component(S)), R.swapaxes(0, 1))
    number = observations.point[rows]
    there = np.zeros(observations.points, dtype=bool)
    there[number] = True
    numbers = np.flatnonzero(there)
    of = (np.cumsum(there) - 1)[number]
    equations = np.concatenate([P.reshape(9, -1), turned(P, place)])
    n = len(numbers)
    at = (of + n * np.arange(12)[:, None]).ravel()
    sums = np.bincount(at, equations.ravel(), minlength=12 * n).reshape(12, n)
    sums = sums.astype(np.float64, copy=False)  # of no sightings numpy counts in integers
    return numbers, turned(inverses_by_component(sums[:9].reshape(3, 3, n)), sums[9:])


def inverses(S: Covariances3) -> Covariances3:
    """Inverses of many symmetric matrices: cofactors over the determinant.

    For matrices of three rows this is as exact as elimination and ten times as fast.
    """
    return inverses_by_component(by_component(S)).transpose(2, 0, 1).copy()


def inverses_by_component(S: Matrices) -> Matrices:
    """The same, component by component."""
    (a, b, c), (_, d, e), (_, _, f) = S
    inverse = np.empty_like(S)
    inverse[0] = d * f - e * e, c * e - b * f, b * e - c * d
    inverse[1, 1], inverse[1, 2], inverse[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    aa, bb, cc = inverse[0]
    inverse[1, 0], inverse[2, 0], inverse[2, 1] = bb, cc, inverse[1, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse /= a * aa + b * bb + c * cc
    return inverse
