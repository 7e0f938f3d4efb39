"""Layout of the unknowns in the normal equations, and tie points with the same columns.

Images determine only relative poses: a common motion of the stops that see a tie point and of the
point changes no image coordinate. The observations of a point are therefore written in the motions
of its stops relative to the first of them, the base b,

    x_s = (d_s, dc_s)         rotation vector and shift of stop s, in the LSL
    r_s = x_s - M_sb x_b      M_sb = | I               0 |      effect on s of a
                                     | -[c_s - c_b]    I |      rigid motion of b

so that a point seen from only one stop depends on mast pointings and not on poses. The normal
equations of all points that the same pairs see (a signature) are summed before they are added to
the matrix. A point that several stops see depends on the poses of all of them, on that of the base
by

    A_b = -sum_s A_s M_sb,        in every row - a' [X - c_b], a', with a' the derivative by X

The columns on which the observations of a group of points depend are its active columns. Only the
lower triangle of the normal matrix is computed.

Each group has a fixed cost, so a few points join a group whose points have more observations: their
observations are repeated up to that number, with zero weight.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import groupby

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import (
    PAIR_UNKNOWNS,
    STOP_UNKNOWNS,
    Observations,
)
from solmap.photogrammetry.adjustment.model.network import FRAME_UNKNOWNS
from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import AdjustmentError

CACHED = 100_000
"""Numbers in the observation equations of a group, so that they fit a processor core's cache."""
LEAST_POINTS = 64
"""Points of a group if each has so many observations that its equations alone are long."""
SHARED = 2
"""Average points per signature from which on summing them first saves time."""
KEPT = 256
"""Signatures whose columns are kept from one layout to the next."""
OWN_GROUP = 1_000_000
"""Products that a separate group must save: its calls take as long."""
Kind = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Points with equal numbers of observations: rows (n, k), their pairs, and the first point of every
signature."""


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """The free orientations and their columns: stop by stop, pose first, then its pairs."""

    sizes: np.ndarray
    offsets: np.ndarray
    stop_columns: np.ndarray
    """(stops, 6) column inside the stop's block; -1 where held."""
    pair_columns: np.ndarray
    """(pairs, 3) column inside the block of the pair's stop; -1 where masts do not turn."""
    pair_stop: np.ndarray
    per_pair: int
    """Unknowns of a pair: its pointing, or none where label pointings are exact."""
    frame_columns: np.ndarray
    """(frames, 5) column inside the block of a control frame; -1 where certain. Blocks of frames
    follow those of stops."""
    mast: int = 0
    """Systematic errors of the mast: the last block."""
    count: int = field(init=False)
    """Number of the unknowns."""
    unpacked: tuple[np.ndarray, np.ndarray, np.ndarray] = field(init=False)
    """Positions of the columns of stops, pairs and frames in the vector of unknowns."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "count", int(self.sizes.sum()))
        stops = np.arange(len(self.stop_columns))
        unpacked = (
            self.places(stops[:, None], self.stop_columns),
            self.places(self.pair_stop[:, None], self.pair_columns),
            self.places(self.frame_blocks[:, None], self.frame_columns),
        )
        object.__setattr__(self, "unpacked", unpacked)

    @classmethod
    def of(
        cls,
        held: np.ndarray,
        pair_stop: np.ndarray,
        *,
        turning: bool = True,
        frames: np.ndarray | None = None,
        mast: int = 0,
    ) -> Unknowns:
        """Number the unknowns of a network whose stops are held or free, and masts turn or not.

        `frames` (n, 5) marks the unknowns of the positions of control frames.
        """
        free = np.zeros((0, FRAME_UNKNOWNS), dtype=bool) if frames is None else frames
        pose, per_pair = np.where(held, 0, STOP_UNKNOWNS), PAIR_UNKNOWNS if turning else 0
        per_stop = np.bincount(pair_stop, minlength=len(held)).astype(np.int64)
        of_stops = (pose + per_pair * per_stop).astype(np.int64)
        sizes = np.concatenate([of_stops, free.sum(axis=1).astype(np.int64), [mast]])
        frame_columns = np.where(free, np.cumsum(free, axis=1) - 1, -1)
        stop_columns = np.where(held[:, None], -1, np.arange(STOP_UNKNOWNS))
        by_stop = np.argsort(pair_stop, kind="stable")
        slot = np.zeros(len(pair_stop), dtype=np.int64)
        before = np.cumsum(per_stop) - per_stop
        slot[by_stop] = np.arange(len(pair_stop)) - np.repeat(before, per_stop)
        first = pose[pair_stop] + PAIR_UNKNOWNS * slot
        pair_columns = np.where(turning, first[:, None] + np.arange(PAIR_UNKNOWNS), -1)
        offsets = np.concatenate([[0], np.cumsum(sizes)])[:-1]
        columns = (stop_columns, pair_columns, pair_stop, per_pair, frame_columns)
        return cls(sizes, offsets, *columns, mast)

    @property
    def frame_blocks(self) -> np.ndarray:
        """Blocks of the control frames."""
        return len(self.stop_columns) + np.arange(len(self.frame_columns))

    def columns(self, pair: np.ndarray) -> np.ndarray:
        """(…, 9) columns, inside the stop's block, on which an observation by `pair` depends."""
        return np.concatenate(
            [self.stop_columns[self.pair_stop[pair]], self.pair_columns[pair]], axis=-1
        )

    def places(self, blocks: np.ndarray, local: np.ndarray) -> np.ndarray:
        """Positions of columns in the vector of unknowns; held ones map to its unused last one."""
        return np.where(local >= 0, self.offsets[blocks] + local, self.count)

    def unpack(self, x: Float64[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Corrections (stops, 6), zero where held, (pairs, 3) and (frames, 5)."""
        padded, (stops, pairs, frames) = np.append(x, 0.0), self.unpacked
        return padded[stops], padded[pairs], padded[frames]


@dataclass(frozen=True, slots=True, eq=False)
class TieGroup:
    """Tie points with k observations each, distributed over their stops in the same way.

    Columns: 6 for each stop after the base, then 3 for each observation's pair if masts turn
    (relative); and 6 for the base besides (absolute).
    """

    rows: np.ndarray
    """(k, n) observation numbers, some repeated; points in the order of their signatures."""
    slots: tuple[int, ...]
    """Index among the point's stops of each of the k, ascending; the base is 0."""
    first: np.ndarray
    """First point of each signature; where few points share one, each has its own."""
    stops: np.ndarray
    """(signatures, stops of a point)."""
    local: np.ndarray
    """(signatures, absolute columns) column inside its stop's block, -1 where held."""
    per_pair: int
    """Columns of a pair."""
    counts: np.ndarray = field(init=False)
    """(k, n) which observations count: those that do not repeat the previous one."""
    signature: np.ndarray = field(init=False)
    """Signature of every point."""

    def __post_init__(self) -> None:
        counts, begins = np.ones(self.rows.shape, dtype=bool), np.zeros(self.points, dtype=np.int64)
        np.not_equal(self.rows[1:], self.rows[:-1], out=counts[1:])
        begins[self.first[1:]] = 1
        object.__setattr__(self, "counts", counts)
        object.__setattr__(self, "signature", begins.cumsum())

    @classmethod
    def of(
        cls,
        rows: np.ndarray,
        slots: tuple[int, ...],
        first: np.ndarray,
        pair: np.ndarray,
        unknowns: Unknowns,
    ) -> TieGroup:
        """The group of some observations by pairs `pair` (signatures, k)."""
        stop = unknowns.pair_stop[pair].astype(np.int64)
        stops = stop[:, [slots.index(slot) for slot in range(slots[-1] + 1)]]
        of_pair = unknowns.pair_columns[:, : unknowns.per_pair]
        local = _by_column(unknowns.stop_columns[stops], of_pair[pair])
        return cls(rows, slots, first, stops, local, unknowns.per_pair)

    def columns(self, of_stop: np.ndarray, of_pair: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """(signatures, absolute columns) positions of the columns, by stop and by pair.

        `pair` is that of every observation of the network.
        """
        pairs = pair[self.rows[:, self.first]].T
        return _by_column(of_stop[self.stops], of_pair[pairs][:, :, : self.per_pair])

    def of_points(self, numbers: np.ndarray) -> TieGroup:
        """The layout of some points, each with its own signature."""
        of = self.signature[numbers]
        return replace(
            self,
            rows=self.rows[:, numbers],
            first=np.arange(len(numbers)),
            stops=self.stops[of],
            local=self.local[of],
        )

    @property
    def seen(self) -> int:
        """Observations per point."""
        return len(self.slots)

    @property
    def points(self) -> int:
        """Number of points."""
        return self.rows.shape[1]

    @property
    def posed(self) -> int:
        """Number of columns of relative poses."""
        return STOP_UNKNOWNS * self.slots[-1]

    @property
    def relative(self) -> int:
        """Number of relative columns."""
        return self.posed + self.per_pair * self.seen

    @property
    def active(self) -> int:
        """Number of leading absolute columns on which its normal equations depend.

        Points seen from one stop depend on no pose.
        """
        return self.relative + (STOP_UNKNOWNS if self.slots[-1] else 0)

    @property
    def column_slots(self) -> np.ndarray:
        """Index among the point's stops of every absolute column."""
        return _column_slots(self.slots, self.per_pair)

    @property
    def blocks(self) -> np.ndarray:
        """(signatures, absolute columns) block of every column."""
        return self.stops[:, self.column_slots]

    @property
    def triangle(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the lower triangle of the active columns, row by row.

        Of two columns the row belongs to the later stop, or to the later unknown of one stop.
        """
        return _triangle(self.slots, self.per_pair)

    @property
    def is_shared(self) -> bool:
        """Whether several points share a signature."""
        return len(self.first) < self.points


def _by_column(of_stops: np.ndarray, of_pairs: np.ndarray) -> np.ndarray:
    """Values of the absolute columns, from (n, stops, 6) and (n, k, 3)."""
    n = len(of_stops)
    others = of_stops[:, 1:].reshape(n, -1)
    return np.concatenate([others, of_pairs.reshape(n, -1), of_stops[:, 0]], axis=1)


@lru_cache(maxsize=KEPT)
def _column_slots(slots: tuple[int, ...], per_pair: int) -> np.ndarray:
    others = np.repeat(np.arange(1, slots[-1] + 1), STOP_UNKNOWNS)
    return np.concatenate([others, np.repeat(slots, per_pair), np.zeros(STOP_UNKNOWNS, np.int64)])


@lru_cache(maxsize=KEPT)
def _triangle(slots: tuple[int, ...], per_pair: int) -> tuple[np.ndarray, np.ndarray]:
    posed = STOP_UNKNOWNS * slots[-1]
    relative = posed + per_pair * len(slots)
    active = relative + (STOP_UNKNOWNS if slots[-1] else 0)
    is_pair = np.zeros(active, dtype=bool)
    is_pair[posed:relative] = True
    place = np.arange(active) + active * (is_pair + 2 * _column_slots(slots, per_pair)[:active])
    i, j = np.tril_indices(active)
    swapped = place[i] < place[j]
    return np.where(swapped, j, i), np.where(swapped, i, j)


def tie_groups(
    observations: Observations, used: np.ndarray, unknowns: Unknowns
) -> tuple[TieGroup, ...]:
    """Group the used observations by tie point; points with a single one are left out.

    Raises:
        AdjustmentError: a point was measured twice in one pair.
    """
    often = np.bincount(observations.point[used], minlength=observations.points) > 1
    rows = np.flatnonzero(used & often[observations.point])
    pair, point = observations.pair[rows], observations.point[rows].astype(np.int64)
    along = np.empty(len(unknowns.pair_stop), dtype=np.int64)  # place of a pair, stop by stop
    along[np.argsort(unknowns.pair_stop, kind="stable")] = np.arange(len(along))
    order = np.argsort(point * len(along) + along[pair])
    rows, pair, point = rows[order], pair[order], point[order]
    twice = np.flatnonzero((pair[1:] == pair[:-1]) & (point[1:] == point[:-1]))
    if len(twice):
        raise AdjustmentError(
            f"tie point {point[twice[0]]} was measured twice in pair {pair[twice[0]]} of the "
            "network: a pair measures a point only once; give one measurement, or use two points"
        )
    begin = np.flatnonzero(np.diff(point, prepend=-1))
    counts = np.diff(begin, append=len(point))
    kinds = [
        kind
        for k in np.flatnonzero(np.bincount(counts))[::-1].tolist()
        for kind in _kinds(observations, rows[begin[counts == k][:, None] + np.arange(k)], unknowns)
    ]
    return tuple(
        group for kind in _join_small(kinds, unknowns) for group in _groups(*kind, unknowns)
    )


def _join_small(kinds: list[Kind], unknowns: Unknowns) -> list[Kind]:
    """Kinds, most observations first; kinds with few points join kinds with more observations."""
    joined: list[Kind] = []
    for kind in kinds:
        seen = _counts_by_stop(kind, unknowns)
        for i, (rows, pairs, first) in enumerate(joined):
            more = _counts_by_stop(joined[i], unknowns)
            if len(more) != len(seen) or (more < seen).any():
                continue
            if len(kind[0]) * (_products(more) - _products(seen)) > OWN_GROUP:
                continue
            repeats = np.ones(seen.sum(), dtype=np.int64)
            repeats[np.cumsum(seen) - 1] += more - seen
            take = np.repeat(np.arange(len(repeats)), repeats)
            joined[i] = (
                np.concatenate([rows, kind[0][:, take]]),
                np.concatenate([pairs, kind[1][:, take]]),
                np.concatenate([first, len(rows) + kind[2]]),
            )
            break
        else:
            joined.append(kind)
    return joined


def _counts_by_stop(kind: Kind, unknowns: Unknowns) -> np.ndarray:
    """Number of pairs at each of its stops from which a point of a kind is seen."""
    stops = unknowns.pair_stop[kind[1][0]].tolist()
    return np.array([len(list(own)) for _, own in groupby(stops)])


def _products(seen: np.ndarray) -> int:
    """Number of products for the normal equations of a point with these observations per stop."""
    columns = STOP_UNKNOWNS * len(seen) * (len(seen) > 1) + PAIR_UNKNOWNS * int(seen.sum())
    return 3 * int(seen.sum()) * columns**2 // 2


def _kinds(observations: Observations, rows: np.ndarray, unknowns: Unknowns) -> Iterator[Kind]:
    """Points with equally many observations, (n, k), grouped by their distribution over stops.

    Gives rows and their pairs, sorted by stop and pair, and the first point of every signature.
    """
    pairs = observations.pair[rows]
    order = np.lexsort(pairs.T[::-1])
    rows, pairs = rows[order], pairs[order]
    new = np.ones(len(pairs), dtype=bool)
    new[1:] = (pairs[1:] != pairs[:-1]).any(axis=1)
    stops = unknowns.pair_stop[pairs[new]]
    packed = np.packbits(stops[:, 1:] != stops[:, :-1], axis=1)
    if (packed == packed[0]).all():
        yield rows, pairs, np.flatnonzero(new)
        return
    kinds, kind = np.unique(packed.view(f"V{packed.shape[1]}")[:, 0], return_inverse=True)
    for number in range(len(kinds)):
        mine = (kind == number)[np.cumsum(new) - 1]
        yield rows[mine], pairs[mine], np.flatnonzero(new[mine])


def _groups(
    rows: np.ndarray, pairs: np.ndarray, first: np.ndarray, unknowns: Unknowns
) -> Iterator[TieGroup]:
    """Points of one kind in groups that a processor's cache holds."""
    k, stops = rows.shape[1], unknowns.pair_stop[pairs[0]]
    slots = np.concatenate([[0], np.cumsum(stops[1:] != stops[:-1])])
    columns = STOP_UNKNOWNS * (slots[-1] + 1) + PAIR_UNKNOWNS * k
    size = max(CACHED // (3 * k * columns), LEAST_POINTS)
    starts = np.zeros(len(rows), dtype=bool)
    starts[first if len(rows) > SHARED * len(first) else slice(None)] = True
    starts[::size] = True
    for begin in range(0, len(rows), size):
        part = slice(begin, begin + size)
        own = np.flatnonzero(starts[part])
        yield TieGroup.of(
            rows[part].T.copy(), tuple(slots.tolist()), own, pairs[part][own], unknowns
        )
