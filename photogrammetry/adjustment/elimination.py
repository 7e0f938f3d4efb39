"""Tie points eliminated by orthogonal projection, and the normal equations that remain.

The observations of one tie point, whitened, are l = A_o x_o + A_t x_t with the relative
orientations (o, see `layout`) of its stops and pairs and the three coordinates of the point (t).
With A_t = Q R, Q of three orthonormal columns, and P = I - Q Q',

    P l = P A_o x_o                free of the point: added to the normal equations
    R x_t = Q' (l - A_o x_o)       gives the point afterwards, as seen from the base stop

This equals the classical reduction N_oo - N_ot N_tt^-1 N_to, but does not square the condition of
A_t, which is bad for far points (Demmel et al. 2021; two per cent of the last sigma after 500
stops). Q comes from Gram and Schmidt's process, each column orthogonalised twice (Kahan's "twice is
enough"), for all points of a group at once. A direction in which the images do not feel the point
at all is left alone. A point seen by one pair alone has as many unknowns as observations and says
nothing about orientations: it is left out and placed afterwards.

For tests of the residuals v, with the cofactor matrix Z of x_o,

    Q_vv = P (I - A_o Z A_o') P                  (whitened; its diagonal is the redundancy numbers)
    Q_tt = R^-1 (I + Q' A_o Z A_o' Q) R'^-1      (covariance of the point, relative to the base)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from photogrammetry.adjustment.collinearity import STOP_UNKNOWNS, Partials, Views
from photogrammetry.adjustment.componentwise import cross
from photogrammetry.adjustment.layout import TieGroup

UNFELT = 1e-13
"""A column of A_t shorter than this share of itself after the others were taken out is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class EliminatedTies:
    """One group after elimination: what goes to the orientations and what gives the points back.

    Kept component by component, points last; properties give the same point by point.
    """

    group: TieGroup
    free: np.ndarray
    """(3 k, felt columns and l, n) P A_o and P l."""
    along: np.ndarray
    """(3, felt columns and l, n) Q' A_o and Q' l."""
    basis: np.ndarray
    """(3, 3 k, n) columns of Q."""
    triangle: np.ndarray
    """(3, 3, n) R."""
    centres: np.ndarray
    """(stops, 3) of the state."""

    def normals(self) -> np.ndarray:
        """(columns + 1 below columns + 1, signatures) lower triangle of (A_o, l)' P (A_o, l)."""
        count, n = self.free.shape[1:]
        if len(self.group.first) == n:  # many columns, few points: matrix by matrix is faster
            by_point = self.free.transpose(2, 1, 0).copy()
            row, column = np.tril_indices(count)
            products = (by_point @ by_point.mT).reshape(n, -1)
            return np.take(products, row * count + column, axis=1).T
        N = np.empty((count * (count + 1) // 2, n))
        for i in range(count):
            at = i * (i + 1) // 2
            row, others = self.free[:, i], self.free[:, : i + 1]
            np.einsum("rn,rjn->jn", row, others, out=N[at : at + i + 1])
        return np.add.reduceat(N, self.group.first, axis=1)

    def relative_cofactors(self, triangle: np.ndarray) -> np.ndarray:
        """(relative, relative, signatures) T Z T' from the lower triangle of the felt Z."""
        Z = squared(triangle, self.group.felt)
        return self._relative(self._relative(Z).swapaxes(0, 1))

    def _relative(self, rows: np.ndarray) -> np.ndarray:
        """T rows (felt, ..., signatures): see `layout`; of one stop, no pose is felt."""
        group, end = self.group, self.group.relative
        relative = rows[:end].copy()
        if not group.slots[-1]:
            return relative
        turn, shift = rows[end : end + 3], rows[end + 3 :]
        for slot in range(1, group.slots[-1] + 1):
            at = STOP_UNKNOWNS * (slot - 1)
            arm = (self.centres[group.stops[:, slot]] - self.centres[group.stops[:, 0]]).T
            relative[at : at + 3] -= turn
            relative[at + 3 : at + 6] -= shift + cross(turn, arm)
        return relative

    @property
    def is_felt(self) -> np.ndarray:
        """(n) whether the images feel a point in every direction."""
        return np.all(self.triangle[range(3), range(3)] > 0, axis=0)

    def freed(self, right: np.ndarray) -> np.ndarray:
        """R^-1 right (3, ..., n); nothing along what the images do not feel."""
        return _back_substitute(self.triangle, right)


def squared(triangle: np.ndarray, count: int) -> np.ndarray:
    """(count, count, n) symmetric matrices of which the lower triangles are given row by row."""
    return triangle[_places_in_triangle(count)]


@lru_cache(maxsize=256)
def _places_in_triangle(count: int) -> np.ndarray:
    row, column = np.indices((count, count))
    row, column = np.maximum(row, column), np.minimum(row, column)
    return row * (row + 1) // 2 + column


def eliminate(group: TieGroup, l: np.ndarray, A: Partials, views: Views) -> EliminatedTies:
    """Free a group of its points; misclosures (3, k n) and partials are whitened."""
    k, n = group.rows.shape
    by_point = A.by_point.reshape(3, 3, k, n).swapaxes(0, 1)
    basis, triangle = orthonormal(by_point.reshape(3, -1, n))
    Q, l = basis.reshape(3, 3, k, n), l.reshape(3, k, n)
    parts = list(_by_column(group, A, views))
    along = np.zeros((3, group.felt + 1, n))
    for i, at, part in parts:
        along[:, at] += np.einsum("drn,rcn->dcn", Q[:, :, i], part)
    along[:, -1] = np.einsum("dcin,cin->dn", Q, l)
    rest = np.einsum("dcin,djn->cijn", Q, along)
    np.negative(rest, out=rest)
    for i, at, part in parts:
        rest[:, i, at] += part
    rest[:, :, -1] += l
    free = rest.reshape(3 * k, -1, n)
    return EliminatedTies(group, free, along, basis, triangle, views.centres.T)


def _by_column(
    group: TieGroup, A: Partials, views: Views
) -> Iterator[tuple[int, slice, np.ndarray]]:
    """What A_o has: number of an observation, columns, and derivatives (3, columns, n) by them."""
    n, stops = group.points, group.stops
    if len(stops) < n:
        stops = stops[group.signature]
    for i, slot in enumerate(group.slots):
        own = A.of(slice(i * n, i * n + n))
        if group.per_pair:
            at = group.posed + group.per_pair * i
            yield i, slice(at, at + group.per_pair), own.by_pointing
        if slot:
            at = STOP_UNKNOWNS * (slot - 1)
            yield i, slice(at, at + 6), own.by_stop(views.arm(own.X, stops[:, slot]))
            yield i, slice(-7, -1), -own.by_stop(views.arm(own.X, stops[:, 0]))


def orthonormal(A_t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Q (3, rows, n), column by column, and R (3, 3, n) of many A_t (column, row, n)."""
    Q = A_t.copy()
    R = np.zeros((3, 3, A_t.shape[-1]))
    for c in range(3):
        length = np.sqrt(_dot(Q[c], Q[c]))
        for _ in range(2):
            for d in range(c):
                r = _dot(Q[d], Q[c])
                Q[c] -= r * Q[d]
                R[d, c] += r
        left = np.sqrt(_dot(Q[c], Q[c]))
        R[c, c] = np.where(left > UNFELT * length, left, 0.0)
        Q[c] *= np.divide(1.0, R[c, c], out=np.zeros_like(left), where=R[c, c] > 0)
    return Q, R


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products of many columns (rows, n)."""
    return np.einsum("rn,rn->n", a, b)


def place_points(ties: EliminatedTies, x: np.ndarray) -> np.ndarray:
    """Corrections (3, n) of the group's points, relative to what their base stop does to them.

    `x` (felt columns, signatures) are corrections of the orientations.
    """
    if x.shape[1] < ties.group.points:
        x = x[:, ties.group.signature]
    return ties.freed(ties.along[:, -1] - np.einsum("dcn,cn->dn", ties.along[:, :-1], x))


def _back_substitute(R: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve R x = right (3, ..., n) for many upper triangles (3, 3, n).

    Nothing along what the images do not feel.
    """
    x = np.zeros_like(right)
    for i in (2, 1, 0):
        known = sum((R[i, j] * x[j] for j in range(i + 1, 3)), np.zeros_like(right[i]))
        np.divide(right[i] - known, R[i, i], out=x[i], where=R[i, i] > 0)
    return x
