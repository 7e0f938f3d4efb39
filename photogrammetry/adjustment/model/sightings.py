"""Points triangulated from single stereo observations, and their agreement.

In the frame of its pair a sighting does not depend on the poses of stops and masts. With the
position r (direction from the image coordinates, range from the parallax), e along the axis of the
pair, and the standard deviations s_a of the range (relative), s_c across the axis (metres) and t of
the mast pointing (radians), its covariance is

    S = s_a^2 r r' + s_c^2 (I - e e') + t^2 (|r|^2 I - r r')

Without ground control the quality of an adjustment is described by two numbers (Di et al. 2008,
section 3.3; `consistency`). In object space: the distance between the positions of a point by two
pairs, each from its own parallax. In the image: the distance between the measured image point and
the projection of the weighted mean of all pairs' positions. Both are means of absolute values: 3-D
over every two observations of a point in different pairs, 2-D over all observations of such points;
cross-site where the point is seen from more than one stop (3-D: from these two), inter-stereo
otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import Consistency
from solmap.photogrammetry.adjustment.model.collinearity import Observations, Sights, State, Views
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import (
    Matrices,
    Vectors,
    inverses_by_component,
    product,
    transform,
)
from solmap.photogrammetry.arrays import Bool, Covariances3, Flags, Float64, Int32
from solmap.photogrammetry.imagery import TieKind

FAR_PARALLAX_PX = 3.0
"""Parallax below which the error of a point is not ellipsoidal: it cannot align stops rigidly."""


Couple = tuple[int, int]
"""Two stops, the earlier one first."""


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """The point of every observation in the frame of its pair; NaN where it has none."""

    points: Vectors
    covariances: Matrices
    usable: Flags
    """Which may be used for alignment."""
    size: Float64[np.ndarray, " n"]
    """Sum of the three variances, square metres."""

    @classmethod
    def of(cls, observations: Observations, params: AdjustmentParams) -> Sightings:
        """Triangulate every observation by itself."""
        sights, points = observations.sights, np.empty((3, len(observations)))
        focal_px, base_m, *centre_px = np.take(observations.bodies.optics, sights.pair, axis=1)
        parallax = sights.measured[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            points[2] = np.where(observations.is_stereo, focal_px * base_m / parallax, np.nan)
            range_ = 1.0 / (parallax * sights.weight[2])
            across = points[2] / (sights.weight[0] * focal_px)
        np.subtract(sights.measured[:2], centre_px, out=points[:2])
        points[:2] *= points[2] / focal_px
        turn = float(np.radians(params.pointing_deg))
        S, size = _covariances(points, range_, across, turn)
        usable = observations.is_stereo & (parallax >= FAR_PARALLAX_PX)
        return cls(points, S, usable, size)


def _covariances(
    points: Vectors,
    along: Float64[np.ndarray, " n"],
    across: Float64[np.ndarray, " n"],
    turn: float,
) -> tuple[Matrices, Float64[np.ndarray, " n"]]:
    """Covariances of points and their traces, from standard deviations: see above."""
    distance2, across2 = np.einsum("cn,cn->n", points, points), across**2
    S = points[:, None] * points
    S *= along**2 - turn**2
    across2_of_turn = turn**2 * distance2
    S[0, 0] += across2_of_turn + across2
    S[1, 1] += across2_of_turn + across2
    S[2, 2] += across2_of_turn
    return S, S[0, 0] + S[1, 1] + S[2, 2]


def best_sightings(observations: Observations, seen: Sightings, stops: int) -> list[np.ndarray]:
    """For each stop its observations that may be used for alignment, the best one of each point."""
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
    """All sightings of a network, the best ones, and those that stops share."""

    observations: Observations
    seen: Sightings
    best: list[np.ndarray]
    """Result of `best_sightings`."""
    couples: dict[Couple, tuple[np.ndarray, np.ndarray]]
    """Result of `shared_sightings`."""
    rover_from_pair: Float64[np.ndarray, "pairs 3 3"]
    origins_in_rover: Float64[np.ndarray, "pairs 3"]

    @classmethod
    def of(
        cls, observations: Observations, pointings: np.ndarray, stops: int, params: AdjustmentParams
    ) -> Overview:
        """Of a network with that number of stops."""
        seen = Sightings.of(observations, params)
        best = best_sightings(observations, seen, stops)
        couples = shared_sightings(observations, best)
        return cls(observations, seen, best, couples, *observations.in_rover(pointings))

    def places_in_rover(self, rows: np.ndarray) -> Float64[np.ndarray, "m 3"]:
        """Positions of some sightings in the frames of their rovers."""
        pair, points = self.observations.pair[rows], self.seen.points[:, rows].T
        from_pair = (self.rover_from_pair[pair] @ points[:, :, None])[:, :, 0]
        return self.origins_in_rover[pair] + from_pair

    def in_rover(self, rows: np.ndarray) -> tuple[Float64[np.ndarray, "m 3"], Covariances3]:
        """Points and covariances in the rover frame."""
        R = self.rover_from_pair[self.observations.pair[rows]]
        S = self.seen.covariances[:, :, rows].transpose(2, 0, 1).copy()
        return self.places_in_rover(rows), R @ S @ R.mT

    def in_lsl(
        self, state: State, rows: np.ndarray
    ) -> tuple[Float64[np.ndarray, "m 3"], Covariances3]:
        """Positions and covariances in the LSL at a state."""
        (places, S), stop = self.in_rover(rows), self.observations.stop_of(rows)
        R = state.rotations[stop]
        return state.centres[stop] + (R @ places[:, :, None])[:, :, 0], R @ S @ R.mT


def weighted_mean_points(
    views: Views, observations: Observations, seen: Sightings, used: np.ndarray
) -> Float64[np.ndarray, "points 3"]:
    """Every point at the weighted mean of its used sightings; NaN if none can.

    The weights are the inverse covariances of the sightings, so rays of several stops intersect
    here although a single sighting has a weak range.
    """
    rows = np.flatnonzero(used & observations.is_stereo)
    number = observations.point[rows]
    place = places_in_lsl(views, observations, seen, rows)
    points = np.full((observations.points, 3), np.nan)
    points[number] = place.T
    several = np.bincount(number, minlength=observations.points)[number] > 1
    if several.any():
        weighted = WeightedSightings.of(observations, seen, rows[several])
        points[weighted.numbers] = weighted.means(views, place[:, several]).T
    return points


def places_in_lsl(
    views: Views, observations: Observations, seen: Sightings, rows: np.ndarray
) -> Vectors:
    """Positions of the points of some sightings, in the LSL."""
    of_pair = np.take(views.pairs[:12], observations.pair[rows], axis=1)
    place = transform(
        of_pair[:9].reshape(3, 3, -1).swapaxes(0, 1), np.take(seen.points, rows, axis=1)
    )
    place += of_pair[9:]
    return place


@dataclass(frozen=True, slots=True, eq=False)
class WeightedSightings:
    """Some sightings with their weights, and which of them see the same point."""

    pair: Int32[np.ndarray, " m"]
    weights: Matrices
    """Inverse covariances in the frames of the pairs."""
    numbers: np.ndarray
    """Numbers of the points that they see, ascending."""
    places: np.ndarray
    """Indices at which the 12 numbers of each sighting's normal equations are summed."""

    @classmethod
    def of(cls, observations: Observations, seen: Sightings, rows: np.ndarray) -> WeightedSightings:
        """The sums of some observations."""
        number = observations.point[rows]
        there = np.zeros(observations.points, dtype=bool)
        there[number] = True
        numbers = np.flatnonzero(there)
        of = (np.cumsum(there) - 1)[number]
        places = (of + len(numbers) * np.arange(12)[:, None]).ravel()
        weights = inverses_by_component(np.take(seen.covariances, rows, axis=2))
        return cls(observations.pair[rows], weights, numbers, places)

    def means(self, views: Views, place: Vectors) -> Float64[np.ndarray, "3 points"]:
        """The weighted mean place of each point, from those of the sightings in the LSL."""
        F, n = np.take(views.pairs[:9], self.pair, axis=1).reshape(3, 3, -1), len(self.numbers)
        P = product(F.swapaxes(0, 1), product(self.weights, F))
        equations = np.concatenate([P.reshape(9, -1), transform(P, place)])
        sums = np.bincount(self.places, equations.ravel(), minlength=12 * n).reshape(12, n)
        sums = sums.astype(np.float64, copy=False)  # numpy returns integers for no sightings
        return transform(inverses_by_component(sums[:9].reshape(3, 3, n)), sums[9:])


@dataclass(frozen=True, slots=True, eq=False)
class Comparisons:
    """Every two used stereo observations of one point in different pairs."""

    rows: np.ndarray
    """Observations that are compared, those of a point together."""
    first: np.ndarray
    """Places in `rows` of the one, and of the other."""
    second: np.ndarray
    across: Bool[np.ndarray, " m"]
    """Whether the two belong to different stops."""
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
    place = places_in_lsl(views, observations, seen, compared.rows)
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
    """Lengths of vectors given component by component."""
    return np.sqrt(np.einsum("cn,cn->n", vectors, vectors))


def _mean(values: np.ndarray) -> float:
    """Mean of the values that exist; a point behind a camera has no image to compare."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if len(there) else float("nan")
