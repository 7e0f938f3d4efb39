"""Tie points eliminated by QR, and the normal equations that remain.

The observations of one tie point, whitened, are l = A_o x_o + A_t x_t with the orientations (o)
of its stops and pairs and the three coordinates of the point (t). With A_t = [Q1 Q2] [R; 0],

    Q2' l = Q2' A_o x_o            is free of the point: added to the normal equations
    R x_t = Q1' (l - A_o x_o)      gives the point afterwards

This equals the classical reduction N_oo - N_ot N_tt^-1 N_to, but does not square the condition of
A_t, which is bad for far points (Demmel et al. 2021; two per cent of the last sigma after 500
stops). A point seen by one pair alone has as many unknowns as observations and says nothing about
orientations: it is left out and placed afterwards.

Points with equal numbers of observations k are handled together, sorted by the tuple of their pairs
(their signature), so that products are summed before they are scattered to the blocks of the stops.
For tests of the residuals v, with the cofactor matrix Z of x_o,

    Q_vv = Q2 (I - Q2' A_o Z A_o' Q2) Q2'        (whitened; its diagonal is the redundancy numbers)
    Q_tt = R^-1 (I + Q1' A_o Z A_o' Q1) R'^-1    (covariance of the point)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photogrammetry.adjustment.blocks import BlockPattern
from photogrammetry.adjustment.collinearity import PAIR_UNKNOWNS, STOP_UNKNOWNS, Observations
from photogrammetry.arrays import Float64

COLUMNS = STOP_UNKNOWNS + PAIR_UNKNOWNS


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
        slot = np.zeros(len(pair_stop), dtype=np.int64)
        for k in range(len(held)):
            of_stop = pair_stop == k
            slot[of_stop] = np.arange(of_stop.sum())
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

    def unpack(self, x: Float64[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Corrections (stops, 6), zero where held, and (pairs, 3)."""
        padded = np.concatenate([x, [0.0]])
        at = np.where(self.stop_columns >= 0, self.offsets[:, None] + self.stop_columns, len(x))
        pairs = self.offsets[self.pair_stop][:, None] + self.pair_columns
        return padded[at], padded[pairs]


@dataclass(frozen=True, slots=True, eq=False)
class TieGroup:
    """The tie points that have k observations each, sorted by signature."""

    rows: np.ndarray
    """(n, k) observation numbers."""
    first: np.ndarray
    """Where each signature begins."""
    stops: np.ndarray
    """(signatures, 9k) block of every column."""
    local: np.ndarray
    """(signatures, 9k) place inside that block, -1 where held."""

    @property
    def seen(self) -> int:
        """Observations per point."""
        return self.rows.shape[1]

    @property
    def signature(self) -> np.ndarray:
        """Signature of every point."""
        counts = np.diff(np.append(self.first, len(self.rows)))
        return np.repeat(np.arange(len(self.first)), counts)


def tie_groups(
    observations: Observations, used: np.ndarray, unknowns: Unknowns
) -> tuple[TieGroup, ...]:
    """Group the used observations by tie point; points with a single one are left out."""
    rows = np.flatnonzero(used)
    rows = rows[np.lexsort((observations.pair[rows], observations.point[rows]))]
    _, first, counts = np.unique(observations.point[rows], return_index=True, return_counts=True)
    groups = []
    for k in np.unique(counts[counts > 1]):
        members = rows[first[counts == k][:, None] + np.arange(k)]
        pairs = observations.pair[members]
        order = np.lexsort(pairs.T[::-1])
        members, pairs = members[order], pairs[order]
        new = np.ones(len(pairs), dtype=bool)
        new[1:] = (pairs[1:] != pairs[:-1]).any(axis=1)
        begin = np.flatnonzero(new)
        signature = pairs[begin]
        stops = np.repeat(unknowns.pair_stop[signature], COLUMNS, axis=1)
        local = unknowns.columns(signature).reshape(len(begin), -1)
        groups.append(TieGroup(members, begin, stops.astype(np.int64), local))
    return tuple(groups)


@dataclass(frozen=True, slots=True, eq=False)
class EliminatedTies:
    """One group after QR: what goes to the orientations and what gives the points back."""

    group: TieGroup
    places: np.ndarray
    """Flat places of the normal matrix, per signature."""
    A: np.ndarray
    """(n, 3k-3, 9k) Q2' A_o."""
    b: np.ndarray
    """(n, 3k-3) Q2' l."""
    A1: np.ndarray
    """(n, 3, 9k) Q1' A_o."""
    b1: np.ndarray
    R: np.ndarray
    Q: np.ndarray


def eliminate(
    group: TieGroup,
    places: np.ndarray,
    misclosure: np.ndarray,
    by_orientation: np.ndarray,
    by_point: np.ndarray,
) -> EliminatedTies:
    """QR of one group; the three arrays are whitened and indexed by observation."""
    n, k = group.rows.shape
    A_t = by_point[group.rows].reshape(n, 3 * k, 3)
    Q, R = np.linalg.qr(A_t, mode="complete")
    pieces = by_orientation[group.rows]  # (n, k, 3, 9): one observation feels nine columns only
    Qk = Q.reshape(n, k, 3, 3 * k)
    A = np.empty((n, 3 * k, COLUMNS * k))
    for i in range(k):
        A[:, :, COLUMNS * i : COLUMNS * (i + 1)] = Qk[:, i].swapaxes(1, 2) @ pieces[:, i]
    b = (misclosure[group.rows].reshape(n, 1, 3 * k) @ Q)[:, 0]
    return EliminatedTies(group, places, A[:, 3:], b[:, 3:], A[:, :3], b[:, :3], R[:, :3], Q)


def add_normals(
    ties: EliminatedTies, unknowns: Unknowns, flat: np.ndarray, right: np.ndarray
) -> None:
    """Add a group to the normal matrix and right-hand side."""
    group = ties.group
    A, b = ties.A, ties.b
    N = np.add.reduceat(A.swapaxes(1, 2) @ A, group.first, axis=0)
    n = np.add.reduceat((b[:, None, :] @ A)[:, 0], group.first, axis=0)
    flat += np.bincount(ties.places.ravel(), N.ravel(), minlength=len(flat))
    at = np.where(group.local >= 0, unknowns.offsets[group.stops] + group.local, len(right) - 1)
    right += np.bincount(at.ravel(), n.ravel(), minlength=len(right))


def place_points(
    ties: EliminatedTies, turn_shift: np.ndarray, pointing: np.ndarray, observations: Observations
) -> np.ndarray:
    """Corrections (n, 3) of the group's points for given corrections of the orientations."""
    pair = observations.pair[ties.group.rows]
    x = np.concatenate([turn_shift[observations.pair_stop[pair]], pointing[pair]], axis=-1)
    right = ties.b1 - (ties.A1 @ x.reshape(len(pair), -1, 1))[:, :, 0]
    return _back_substitute(ties.R, right)


def _back_substitute(R: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve R x = right for many upper triangles; no solution where a pivot vanishes."""
    x = np.zeros_like(right)
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in (2, 1, 0):
            known = (R[:, i, i + 1 :] * x[:, i + 1 :]).sum(axis=1)
            x[:, i] = (right[:, i] - known) / R[:, i, i]
    return np.where(np.isfinite(x), x, 0.0)


def cofactors(places: np.ndarray, inverse: np.ndarray, group: TieGroup) -> np.ndarray:
    """Z of the columns of every point of a group, (n, 9k, 9k), from the flat inverse."""
    return inverse[places][group.signature]


def prior_places(
    unknowns: Unknowns, pattern: BlockPattern, before: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Flat places (stops, 12, 12) and right-hand places (stops, 12) of the telemetry rows."""
    here = np.arange(len(before))
    stops = np.repeat(np.column_stack([before, here]), STOP_UNKNOWNS, axis=1)
    local = np.concatenate([unknowns.stop_columns[before], unknowns.stop_columns[here]], axis=1)
    right = np.where(local >= 0, unknowns.offsets[stops] + local, unknowns.count)
    return pattern.indices(stops, local), right
