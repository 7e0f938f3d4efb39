"""Where every unknown of the normal equations lies, and which tie points are seen alike.

Images tell how stops lie to each other and nothing of where all of them lie: a common motion of the
stops that see a tie point, the point moving along, changes no image coordinate. The observations of
a point are therefore written in the motions of its stops relative to the first of them, the base b,

    x_s = (d_s, dc_s)         rotation vector and shift of stop s, in the LSL
    r_s = x_s - M_sb x_b      M_sb = | I               0 |      what a turn of b does to s,
                                     | -[c_s - c_b]    I |      carried rigidly

so that a point seen from one stop alone feels mast pointings and no pose, and one seen from two
stops six coordinates of pose rather than twelve. Sums over points are taken in these coordinates
and brought to the poses afterwards, once for all points that the same pairs see (a signature).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from photogrammetry.adjustment.collinearity import PAIR_UNKNOWNS, STOP_UNKNOWNS, Observations
from photogrammetry.adjustment.rotations import cross_matrix
from photogrammetry.arrays import Float64


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Which orientations are free, and their places: stop by stop, pose first, then its pairs."""

    sizes: np.ndarray
    offsets: np.ndarray
    stop_columns: np.ndarray
    """(stops, 6) place inside the stop's block; -1 where held."""
    pair_columns: np.ndarray
    """(pairs, 3) place inside the block of the pair's stop."""
    pair_stop: np.ndarray

    @classmethod
    def of(cls, held: np.ndarray, pair_stop: np.ndarray) -> Unknowns:
        """Number the unknowns of a network whose stops are held or free."""
        pose = np.where(held, 0, STOP_UNKNOWNS)
        per_stop = np.bincount(pair_stop, minlength=len(held)).astype(np.int64)
        sizes = (pose + PAIR_UNKNOWNS * per_stop).astype(np.int64)
        stop_columns = np.where(held[:, None], -1, np.arange(STOP_UNKNOWNS))
        by_stop = np.argsort(pair_stop, kind="stable")
        slot = np.zeros(len(pair_stop), dtype=np.int64)
        before = np.cumsum(per_stop) - per_stop
        slot[by_stop] = np.arange(len(pair_stop)) - np.repeat(before, per_stop)
        first = pose[pair_stop] + PAIR_UNKNOWNS * slot
        pair_columns = first[:, None] + np.arange(PAIR_UNKNOWNS)
        offsets = np.concatenate([[0], np.cumsum(sizes)])[:-1]
        return cls(sizes, offsets, stop_columns, pair_columns, pair_stop)

    @property
    def count(self) -> int:
        """How many."""
        return int(self.sizes.sum())

    def columns(self, pair: np.ndarray) -> np.ndarray:
        """(…, 9) places inside the stop's block of the unknowns an observation by `pair` feels."""
        return np.concatenate(
            [self.stop_columns[self.pair_stop[pair]], self.pair_columns[pair]], axis=-1
        )

    def places(self, blocks: np.ndarray, local: np.ndarray) -> np.ndarray:
        """Places of columns in the vector of unknowns; what is held goes to a bin at its end."""
        return np.where(local >= 0, self.offsets[blocks] + local, self.count)

    def unpack(self, x: Float64[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Corrections (stops, 6), zero where held, and (pairs, 3)."""
        padded = np.concatenate([x, [0.0]])
        at = np.where(self.stop_columns >= 0, self.offsets[:, None] + self.stop_columns, len(x))
        pairs = self.offsets[self.pair_stop][:, None] + self.pair_columns
        return padded[at], padded[pairs]


@dataclass(frozen=True, slots=True, eq=False)
class TieGroup:
    """Tie points with k observations each, shared out among their stops in the same way.

    Columns: 6 for each stop after the base, then 3 for each observation's pair (relative); and 6
    for the base besides (absolute).
    """

    rows: np.ndarray
    """(k, n) observation numbers; points in the order of their signatures."""
    slots: tuple[int, ...]
    """Which of the point's stops each of the k is from, ascending; the base is 0."""
    first: np.ndarray
    """Point with which each signature begins."""
    stops: np.ndarray
    """(signatures, stops of a point)."""
    blocks: np.ndarray
    """(signatures, absolute columns) block of every column."""
    local: np.ndarray
    """(signatures, absolute columns) place inside that block, -1 where held."""

    @classmethod
    def of(
        cls,
        rows: np.ndarray,
        first: np.ndarray,
        slots: tuple[int, ...],
        unknowns: Unknowns,
        pair: np.ndarray,
    ) -> TieGroup:
        """The group of some observations by pairs `pair` (signatures, k)."""
        stop = unknowns.pair_stop[pair].astype(np.int64)
        stops = stop[:, [slots.index(slot) for slot in range(slots[-1] + 1)]]
        posed = np.roll(stops, -1, axis=1)
        n = len(pair)
        blocks, local = (
            [poses[:, : 6 * slots[-1]], pairs.reshape(n, -1), poses[:, 6 * slots[-1] :]]
            for poses, pairs in (
                (np.repeat(posed, 6, axis=1), np.repeat(stop, 3, axis=1)),
                (unknowns.stop_columns[posed].reshape(n, -1), unknowns.pair_columns[pair]),
            )
        )
        return cls(rows, slots, first, stops, np.hstack(blocks), np.hstack(local))

    @property
    def seen(self) -> int:
        """Observations per point."""
        return len(self.slots)

    @property
    def points(self) -> int:
        """How many."""
        return self.rows.shape[1]

    @property
    def relative(self) -> int:
        """How many relative columns."""
        return STOP_UNKNOWNS * self.slots[-1] + PAIR_UNKNOWNS * self.seen

    @property
    def felt(self) -> int:
        """How many leading absolute columns its normal equations feel: of one stop, no pose."""
        return self.blocks.shape[1] if self.slots[-1] else self.relative

    @property
    def signature(self) -> np.ndarray:
        """Signature of every point."""
        return np.repeat(np.arange(len(self.first)), np.diff(self.first, append=self.points))

    def to_relative(self, centres: np.ndarray) -> np.ndarray:
        """(signatures, relative, absolute): relative coordinates of absolute ones."""
        n, count = len(self.stops), self.relative
        T = np.tile(np.eye(count, self.blocks.shape[1]), (n, 1, 1))
        for slot in range(1, self.slots[-1] + 1):
            at = STOP_UNKNOWNS * (slot - 1)
            arm = centres[self.stops[:, slot]] - centres[self.stops[:, 0]]
            T[:, at : at + 6, count:] = -np.eye(6)
            T[:, at + 3 : at + 6, count : count + 3] = cross_matrix(arm)
        return T


def tie_groups(
    observations: Observations, used: np.ndarray, unknowns: Unknowns
) -> tuple[TieGroup, ...]:
    """Group the used observations by tie point; points with a single one are left out."""
    rows = np.flatnonzero(used)
    pair, point = observations.pair[rows], observations.point[rows]
    rows = rows[np.lexsort((pair, observations.pair_stop[pair], point))]
    _, first, counts = np.unique(observations.point[rows], return_index=True, return_counts=True)
    return tuple(
        group
        for k in np.unique(counts[counts > 1]).tolist()
        for group in _groups(
            observations, rows[first[counts == k][:, None] + np.arange(k)], unknowns
        )
    )


def _groups(observations: Observations, rows: np.ndarray, unknowns: Unknowns) -> Iterator[TieGroup]:
    """The groups of points with equally many observations, (n, k), sorted by stop and pair."""
    pairs = observations.pair[rows]
    order = np.lexsort(pairs.T[::-1])
    rows, pairs = rows[order], pairs[order]
    new = np.ones(len(pairs), dtype=bool)
    new[1:] = (pairs[1:] != pairs[:-1]).any(axis=1)
    signature, begin = np.cumsum(new) - 1, np.flatnonzero(new)
    stops = unknowns.pair_stop[pairs[begin]]
    slots = np.cumsum(np.diff(stops, axis=1, prepend=stops[:, :1]) != 0, axis=1)
    kinds, kind = np.unique(slots, axis=0, return_inverse=True)
    for number, kind_slots in enumerate(kinds.tolist()):
        mine = kind.ravel() == number
        points = mine[signature]
        first = np.flatnonzero(new[points])
        yield TieGroup.of(
            rows[points].T.copy(), first, tuple(kind_slots), unknowns, pairs[begin[mine]]
        )
