"""Which blocks a sparse symmetric matrix and its factor have, one block a stop.

The order of elimination is that of least degree on the graph of stops; eliminating one makes its
neighbours neighbours of one another.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

Blocks = dict[tuple[int, int], np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class BlockPattern:
    """Which blocks a matrix and its factor have, and where each lies in one flat array.

    Both (s, t) and (t, s) are kept, so that gathering needs no case distinction; the last entry of
    a flat array is a bin for what belongs to no unknown. Of a matrix that is to be factored the
    lower triangle counts alone: blocks (s, t) with s >= t, and of (s, s) the lower triangle.
    """

    sizes: np.ndarray
    """Unknowns of each block; may be zero."""
    order: tuple[int, ...]
    """Elimination order of the blocks that have unknowns."""
    later: dict[int, tuple[int, ...]]
    """For each block its neighbours that are eliminated after it, with fill."""
    keys: np.ndarray
    """Sorted codes s * n + t of the blocks."""
    starts: np.ndarray
    """Where each of `keys` begins in the flat array."""
    length: int

    @classmethod
    def of(cls, sizes: np.ndarray, cliques: Iterable[tuple[int, ...]]) -> BlockPattern:
        """The pattern of a matrix whose cliques of blocks are coupled, with its fill."""
        n = len(sizes)
        active = [k for k in range(n) if sizes[k]]
        near: dict[int, set[int]] = {k: set() for k in active}
        for clique in cliques:
            members = [k for k in clique if sizes[k]]
            for k in members:
                near[k].update(members)
        for k in active:
            near[k].discard(k)
        order, later = _minimum_degree(near)
        codes = [k * n + k for k in active]
        codes += [
            a * n + b for s, others in later.items() for t in others for a, b in ((s, t), (t, s))
        ]
        keys = np.unique(np.array(codes, dtype=np.int64))
        areas = sizes[keys // n] * sizes[keys % n] if len(keys) else np.zeros(0, dtype=np.int64)
        starts = np.concatenate([[0], np.cumsum(areas)])[:-1]
        return cls(sizes, order, later, keys, starts.astype(np.int64), int(areas.sum()))

    def start(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Where blocks begin; -1 where there is none."""
        if not len(self.keys):
            return np.full(np.broadcast(rows, columns).shape, -1, dtype=np.int64)
        codes = rows.astype(np.int64) * len(self.sizes) + columns
        at = np.minimum(np.searchsorted(self.keys, codes), len(self.keys) - 1)
        return np.where(self.keys[at] == codes, self.starts[at], -1)

    def indices(self, blocks: np.ndarray, local: np.ndarray) -> np.ndarray:
        """Flat places of the entries of dense matrices over (block, local unknown) columns.

        `blocks` and `local` are (n, k); local -1 is no unknown and goes to the bin. (n, k, k).
        """
        changes = (blocks[:, 1:] != blocks[:, :-1]).any(axis=0)
        run = np.concatenate([[0], np.cumsum(changes)])[: blocks.shape[1]]
        one = blocks[:, np.flatnonzero(np.diff(run, prepend=-1))]  # of columns of the same blocks
        begin, spread = self.start(one[:, :, None], one[:, None, :]), (run[:, None], run)
        at = begin[:, *spread]
        at += local[:, :, None] * self.sizes[blocks][:, None, :]
        at += local[:, None, :]
        if (lost := local < 0).any() or (begin < 0).any():
            at[lost[:, :, None] | lost[:, None, :] | (begin < 0)[:, *spread]] = self.length
        return at

    def own(self, blocks: np.ndarray, local: np.ndarray) -> np.ndarray:
        """The same where all columns (n, k) of a matrix are of one of the blocks (n): (n, k, k)."""
        begin, sizes = self.start(blocks, blocks), self.sizes[blocks]
        at = (begin[:, None] + local * sizes[:, None])[:, :, None] + local[:, None, :]
        lost = (local < 0) | (begin < 0)[:, None]
        if lost.any():
            at[lost[:, :, None] | lost[:, None, :]] = self.length
        return at

    def lower(
        self,
        stops: np.ndarray,
        slots: np.ndarray,
        local: np.ndarray,
        triangle: tuple[np.ndarray, np.ndarray],
    ) -> np.ndarray:
        """(n, entries) flat places of some entries of the lower triangles of matrices.

        Column c of matrix k is unknown `local[k, c]` of block `stops[k, slots[c]]`; the `triangle`
        tells the row and the column of every entry.
        """
        row, column = triangle
        begin = self.start(stops[:, :, None], stops[:, None, :]).reshape(len(stops), -1)
        at = np.take(begin, slots[row] * stops.shape[1] + slots[column], axis=1)
        at += np.take(local, row, axis=1) * np.take(self.sizes[stops], slots[column], axis=1)
        at += np.take(local, column, axis=1)
        if (local < 0).any():
            at[np.take(local, row, axis=1) < 0] = self.length
            at[np.take(local, column, axis=1) < 0] = self.length
        return at

    def symmetric(self, flat: np.ndarray) -> np.ndarray:
        """A flat array with what is in its lower triangle above the diagonal too."""
        full = flat.copy()
        blocks = self.views(full)
        for (s, t), block in blocks.items():
            if s > t:
                blocks[t, s][:] = block.T
            elif s == t:
                block[:] = np.tril(block) + np.tril(block, -1).T
        return full

    def views(self, flat: np.ndarray) -> Blocks:
        """The blocks of a flat array, as matrices that share its memory."""
        n, sizes = len(self.sizes), self.sizes.tolist()
        blocks = {}
        for key, start in zip(self.keys.tolist(), self.starts.tolist(), strict=True):
            s, t = divmod(key, n)
            blocks[s, t] = flat[start : start + sizes[s] * sizes[t]].reshape(sizes[s], sizes[t])
        return blocks


def _minimum_degree(
    near: dict[int, set[int]],
) -> tuple[tuple[int, ...], dict[int, tuple[int, ...]]]:
    """Elimination order of least degree, and each one's neighbours after it (with fill)."""
    graph = {k: set(others) for k, others in near.items()}
    buckets: dict[int, set[int]] = {}
    for k, others in graph.items():
        buckets.setdefault(len(others), set()).add(k)
    order: list[int] = []
    later: dict[int, tuple[int, ...]] = {}
    while graph:
        degree = min(d for d, members in buckets.items() if members)
        s = min(buckets[degree])  # of equals the first: runs of a program agree
        buckets[degree].discard(s)
        others = graph.pop(s)
        order.append(s)
        later[s] = tuple(sorted(others))
        for t in others:
            buckets[len(graph[t])].discard(t)
            graph[t] |= others
            graph[t] -= {s, t}
            buckets.setdefault(len(graph[t]), set()).add(t)
    rank = {s: k for k, s in enumerate(order)}
    return tuple(order), {s: tuple(sorted(o, key=rank.__getitem__)) for s, o in later.items()}
