"""Cut a network into parts by stops, and assemble it again.

A step along the traverse estimates the last stops and leaves the others unchanged. Each step
therefore receives a part of the network, and the whole is assembled with every stop as estimated by
the last step that included it. Every part numbers tie points from zero: rows of two parts are the
same observation where the same image point was measured in the same pair, and points that share an
observation are the same point. An observation has the status of the last part that contains it. A
point keeps the coordinates of the part in which most stops see it, though a later part may still
see it from one of its stops.
"""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from itertools import compress

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    KINDS,
    UNUSED,
    AdjustedControl,
    AdjustedNetwork,
    AdjustedPair,
    AdjustedTies,
)
from solmap.photogrammetry.adjustment.model.network import Network, select
from solmap.photogrammetry.arrays import Flags
from solmap.photogrammetry.imagery import StopId, TiePoints


def part_at(network: AdjustedNetwork, stops: AbstractSet[StopId]) -> AdjustedNetwork:
    """Some stops of a network, their pairs, and all tie points that these pairs see.

    The part includes the marginal of a sequential adjustment and all control.
    """
    pairs = tuple(pair for pair in network.pairs if pair.stop in stops)
    ours, ties = {pair.pair_id for pair in pairs}, network.ties
    of_pair = np.array([name in ours for name in ties.observations.pair_ids], dtype=bool)
    rows = of_pair[ties.observations.pair] if len(ties.observations) else np.zeros(0, dtype=bool)
    seen = np.zeros(len(ties.points), dtype=bool)
    seen[ties.observations.point[rows]] = True
    return replace(
        network,
        stops=tuple(stop for stop in network.stops if stop.stop in stops),
        pairs=pairs,
        ties=_of_points(ties, seen),
    )


def assemble(parts: Sequence[AdjustedNetwork]) -> AdjustedNetwork:
    """Assemble one network of all parts, its stops in the order of their names.

    Pose and pairs of a stop are those of the last part that has it. The marginal of a sequential
    adjustment, and control, are those of the very last part.
    """
    stops = {stop.stop: stop for part in parts for stop in part.stops}
    pairs: dict[StopId, list[AdjustedPair]] = {}
    for part in parts:
        pairs |= {stop.stop: [] for stop in part.stops}
        for pair in part.pairs:
            pairs[pair.stop].append(pair)
    order = sorted(stops)
    return replace(
        parts[-1],
        stops=tuple(stops[stop] for stop in order),
        pairs=tuple(pair for stop in order for pair in pairs[stop]),
        ties=_join_ties([part.ties for part in parts]),
    )


def _of_points(ties: AdjustedTies, seen: Flags) -> AdjustedTies:
    """The ties of some points, numbered from zero."""
    rows = np.flatnonzero(seen[ties.observations.point])
    numbers = np.cumsum(seen, dtype=np.int32) - 1
    observations = select(ties.observations, rows)
    return AdjustedTies(
        replace(observations, point=numbers[observations.point]),
        ties.points[seen],
        ties.covariances[seen],
        tuple(compress(ties.kinds, seen.tolist())),
        ties.status[rows],
        ties.residuals_px[rows],
        ties.standardised[rows],
        ties.redundancy[rows],
    )


def _join_ties(parts: Sequence[AdjustedTies]) -> AdjustedTies:
    """The ties of all parts, every observation and every point once."""
    names = tuple(dict.fromkeys(name for part in parts for name in part.observations.pair_ids))
    pair = _pairs(parts, names)
    left = np.concatenate([part.observations.left for part in parts])
    row = _same_rows(pair, left)
    firsts = np.cumsum([0, *(len(part.points) for part in parts)])
    point = np.concatenate(
        [part.observations.point + first for part, first in zip(parts, firsts, strict=False)]
    )
    number = _same_points(point, row, int(firsts[-1]))
    last = np.zeros(int(row.max(initial=-1)) + 1, dtype=np.int64)
    last[row] = np.arange(len(row))  # of equal ones the last is assigned last
    last = last[np.lexsort((pair[last], number[point[last]]))]
    return _take_rows(parts, names, pair, number, point, last)


def _pairs(parts: Sequence[AdjustedTies], names: tuple[str, ...]) -> np.ndarray:
    """Numbers of the observations' pairs among all names."""
    place = {name: k for k, name in enumerate(names)}
    columns = []
    for part in parts:
        own = np.array([place[name] for name in part.observations.pair_ids], dtype=np.int32)
        columns.append(own[part.observations.pair] if len(own) else part.observations.pair)
    return np.concatenate(columns)


def _same_rows(pair: np.ndarray, left: np.ndarray) -> np.ndarray:
    """A number for every measurement; equal image points of one pair have equal numbers."""
    order = np.lexsort((left[:, 1], left[:, 0], pair))
    p, at = pair[order], left[order]
    is_new = np.ones(len(order), dtype=bool)
    is_new[1:] = (p[1:] != p[:-1]) | (at[1:] != at[:-1]).any(axis=1)
    row = np.zeros(len(order), dtype=np.int64)
    row[order] = np.cumsum(is_new) - 1
    return row


def _same_points(point: np.ndarray, row: np.ndarray, points: int) -> np.ndarray:
    """New numbers of all points of all parts; points with a common measurement share one."""
    n = points + int(row.max(initial=-1)) + 1
    links = coo_matrix((np.ones(len(point), dtype=np.int8), (point, points + row)), shape=(n, n))
    return connected_components(links)[1][:points]


def _take_rows(
    parts: Sequence[AdjustedTies],
    names: tuple[str, ...],
    pair: np.ndarray,
    number: np.ndarray,
    point: np.ndarray,
    last: np.ndarray,
) -> AdjustedTies:
    """The rows `last` of all parts together, with the points that they see."""
    here, numbers = np.unique(number[point[last]], return_inverse=True)
    new = np.full(int(number.max(initial=-1)) + 1, -1, dtype=np.int64)
    new[here] = np.arange(len(here))
    new = new[number]
    places = np.concatenate([part.points for part in parts])
    covariances = np.concatenate([part.covariances for part in parts])
    rank = np.array([KINDS.index(kind) for part in parts for kind in part.kinds], dtype=np.int64)
    known = np.flatnonzero((new >= 0) & np.isfinite(places).all(axis=1))
    best = known[np.argsort(rank[known], kind="stable")]  # the highest and last comes last
    where, spread = np.full((len(here), 3), np.nan), np.full((len(here), 3, 3), np.nan)
    ranks = np.zeros(len(here), dtype=np.int64)
    where[new[best]], spread[new[best]], ranks[new[best]] = (
        places[best],
        covariances[best],
        rank[best],
    )

    def column(name: str) -> np.ndarray:
        return np.concatenate([getattr(part.observations, name) for part in parts])[last]

    def of_ties(name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in parts])[last]

    seen = TiePoints(
        names,
        numbers.astype(np.int32),
        pair[last],
        column("left"),
        column("parallax_px"),
        column("sigma_px"),
        column("sigma_parallax_px"),
        column("sigma_line_px"),
        column("surface_matched"),
    )
    return AdjustedTies(
        seen,
        where,
        spread,
        tuple(map(KINDS.__getitem__, ranks.tolist())),
        of_ties("status"),
        of_ties("residuals_px"),
        of_ties("standardised"),
        of_ties("redundancy"),
    )


def merge_ties(observations: TiePoints, parts: tuple[AdjustedTies, ...]) -> AdjustedTies:
    """The ties of a whole network, each with the status of the last part that has it.

    Tie points are numbered separately in every network, so parts are matched by measurement: the
    same image point in the same pair. A point keeps the coordinates of the part in which most stops
    see it. Observations that no part has are marked as unused.
    """
    n, points = len(observations), int(observations.point.max(initial=-1)) + 1
    status = np.full(n, UNUSED, dtype=np.int32)
    residuals, standardised = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    redundancy = np.zeros((n, 3))
    where, covariances = np.full((points, 3), np.nan), np.full((points, 3, 3), np.nan)
    ranks = np.full(points, -1)
    for part in parts:
        rows, at = _same_measurements(part.observations, observations)
        status[at], residuals[at] = part.status[rows], part.residuals_px[rows]
        standardised[at], redundancy[at] = part.standardised[rows], part.redundancy[rows]
        rank = np.array([KINDS.index(kind) for kind in part.kinds], dtype=np.int64)
        old, new = part.observations.point[rows], observations.point[at]
        better = np.isfinite(part.points[old]).all(axis=1) & (rank[old] >= ranks[new])
        old, new = old[better], new[better]
        where[new], covariances[new], ranks[new] = (
            part.points[old],
            part.covariances[old],
            rank[old],
        )
    kinds = tuple(KINDS[max(rank, 0)] for rank in ranks.tolist())
    return AdjustedTies(
        observations, where, covariances, kinds, status, residuals, standardised, redundancy
    )


def _same_measurements(some: TiePoints, others: TiePoints) -> tuple[np.ndarray, np.ndarray]:
    """Rows of both that are the same measurement."""
    place = {name: k for k, name in enumerate(others.pair_ids)}
    numbers = np.array([place.get(name, -1) for name in some.pair_ids], dtype=np.int64)
    both = [(numbers[some.pair] if len(some) else some.pair, some.left), (others.pair, others.left)]
    keys = np.vstack([np.column_stack([pair, left]) for pair, left in both])
    _, codes = np.unique(keys, axis=0, return_inverse=True)
    _, rows, at = np.intersect1d(codes[: len(some)], codes[len(some) :], return_indices=True)
    return rows, at


def merge_networks(
    previous: AdjustedNetwork, adjusted: AdjustedNetwork, network: Network
) -> AdjustedNetwork:
    """The whole traverse: the newly adjusted part, and the rest unchanged."""
    stops = {stop.stop: stop for stop in (*previous.stops, *adjusted.stops)}
    pairs = {pair.pair_id: pair for pair in (*previous.pairs, *adjusted.pairs)}
    order = {stop: k for k, stop in enumerate(network.stop_ids)}
    return AdjustedNetwork(
        tuple(sorted(stops.values(), key=lambda s: order[s.stop])),
        tuple(pairs[pair.pair_id] for pair in network.pairs if pair.pair_id in pairs),
        merge_ties(network.within(set(stops)).ties, (previous.ties, adjusted.ties)),
        adjusted.memory,
        _merge_control(previous, adjusted),
        adjusted.frames or previous.frames,
        adjusted.components,
        adjusted.mast,
    )


def _merge_control(
    previous: AdjustedNetwork, adjusted: AdjustedNetwork
) -> tuple[AdjustedControl, ...]:
    """The control of the whole traverse, with the new results of the stops adjusted now."""
    estimated = {stop.stop for stop in adjusted.stops}
    kept = tuple(one for one in previous.control if one.control.stop not in estimated)
    return (*kept, *adjusted.control)
