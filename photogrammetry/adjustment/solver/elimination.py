"""Elimination of tie points by orthogonal projection, and the remaining normal equations.

The observations of one tie point, whitened, are l = A_o x_o + A_t x_t with the relative
orientations (o, see `layout`) of its stops and pairs and the three coordinates of the point (t).
With A_t = Q R, Q of three orthonormal columns, and P = I - Q Q',

    P l = P A_o x_o                free of the point: added to the normal equations
    R x_t = Q' (l - A_o x_o)       gives the point afterwards, as seen from the base stop

This equals the classical reduction N_oo - N_ot N_tt^-1 N_to, but does not square the condition of
A_t, which is bad for far points (Demmel et al. 2021; two per cent of the last sigma after 500
stops). Q comes from Gram and Schmidt's process, each column orthogonalised twice (Kahan's "twice is
enough"), for all points of a group at once. A direction in which the images do not determine the
point is left alone. A point seen by only one pair has as many unknowns as observations and does not
constrain orientations: it is left out and placed afterwards.

For tests of the residuals v, with the cofactor matrix Z of x_o,

    Q_vv = P (I - A_o Z A_o') P                  (whitened; its diagonal is the redundancy numbers)
    Q_tt = R^-1 (I + Q' A_o Z A_o' Q) R'^-1      (covariance of the point, relative to the base)
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import STOP_UNKNOWNS, Partials, Views
from solmap.photogrammetry.adjustment.model.small_matrices import cross_matrix, cross_rows
from solmap.photogrammetry.adjustment.solver.layout import TieGroup

NEGLIGIBLE = 1e-13
"""Fraction of its length below which a column of A_t is rounding error after orthogonalisation."""


@dataclass(frozen=True, slots=True, eq=False)
class EliminatedTies:
    """One group after elimination: its part of the normal equations and what places its points.

    Ordered by point; rows of a point are those of its observations, one after the other.
    """

    group: TieGroup
    free: np.ndarray
    """(n, 3 k, active columns and l) P A_o and P l."""
    along: np.ndarray
    """(n, 3, active columns and l) Q' A_o and Q' l."""
    basis: np.ndarray
    """(n, 3, 3 k) Q'."""
    triangle: np.ndarray
    """(3, 3, n) R, component by component."""
    centres: np.ndarray
    """(stops, 3) of the state."""

    def normals(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower triangle of A_o' P A_o, row by row, and A_o' P l, by signature."""
        products = self.free[:, :, :-1].mT @ self.free
        if self.group.is_shared:
            products = np.add.reduceat(products, self.group.first, axis=0)
        entries = products.reshape(len(products), -1)
        return np.take(entries, _triangle_beside(self.group.active), axis=1), products[:, :, -1]

    @property
    def residuals(self) -> np.ndarray:
        """(3, k n) P l, component by component."""
        by_point = self.free[:, :, -1].reshape(-1, self.group.seen, 3)
        return by_point.transpose(2, 1, 0).reshape(3, -1)

    def with_misclosures(self, l: np.ndarray) -> EliminatedTies:
        """The same elimination with whitened misclosures (3, k n) of a nearby state."""
        by_point = (
            l.reshape(3, self.group.seen, -1).transpose(2, 1, 0).reshape(len(self.free), -1, 1)
        )
        free, along = self.free.copy(), self.along.copy()
        along[:, :, -1:] = self.basis @ by_point
        free[:, :, -1:] = by_point - self.basis.mT @ along[:, :, -1:]
        return replace(self, free=free, along=along)

    def relative_cofactors(self, triangle: np.ndarray) -> np.ndarray:
        """(signatures, relative, relative) T Z T' from the lower triangle of the active Z."""
        Z = symmetric(triangle, self.group.active)
        if not self.group.slots[-1]:
            return Z  # seen from one stop, no pose is active
        centres = self.centres[self.group.stops]
        arms = cross_matrix(centres - centres[:, :1])
        return self._relative(self._relative(Z, arms).mT, arms)

    def _relative(self, rows: np.ndarray, arms: np.ndarray) -> np.ndarray:
        """T rows (signatures, active, ...): see `layout`; `arms` (signatures, stops, 3, 3)."""
        group, end = self.group, self.group.relative
        relative = rows[:, :end].copy()
        turn, shift = rows[:, end : end + 3], rows[:, end + 3 :]
        for slot in range(1, group.slots[-1] + 1):
            at = STOP_UNKNOWNS * (slot - 1)
            relative[:, at : at + 3] -= turn
            relative[:, at + 3 : at + 6] -= shift - arms[:, slot] @ turn
        return relative

    @property
    def is_determined(self) -> np.ndarray:
        """(n) whether the images determine a point in every direction."""
        return np.all(self.triangle[range(3), range(3)] > 0, axis=0)

    @property
    def inverse_triangle(self) -> np.ndarray:
        """(3, 3, n) R^-1; zero along what the images do not determine."""
        unit = np.broadcast_to(np.eye(3)[:, :, None], self.triangle.shape)
        return _back_substitute(self.triangle, unit)


def symmetric(triangle: np.ndarray, count: int) -> np.ndarray:
    """(n, count, count) symmetric matrices of which the lower triangles are given row by row."""
    return np.take(triangle, _places_in_triangle(count), axis=1)


@lru_cache(maxsize=256)
def _places_in_triangle(count: int) -> np.ndarray:
    row, column = np.indices((count, count))
    row, column = np.maximum(row, column), np.minimum(row, column)
    return row * (row + 1) // 2 + column


@lru_cache(maxsize=256)
def _triangle_beside(count: int) -> np.ndarray:
    """Places of the lower triangle of a matrix that has one more column, row by row."""
    row, column = np.tril_indices(count)
    return row * (count + 1) + column


def eliminate(group: TieGroup, l: np.ndarray, A: Partials, views: Views) -> EliminatedTies:
    """Eliminate the points of a group; misclosures (3, k n) and partials are whitened."""
    k, n = group.rows.shape
    by_point = A.by_point.reshape(3, 3, k, n).transpose(1, 2, 0, 3)
    columns, triangle = orthonormalise(by_point.reshape(3, 3 * k, n))
    basis = columns.transpose(2, 0, 1).copy()
    free = _by_orientations(group, l.reshape(3, k, n), A, views)
    along = basis @ free
    free -= basis.mT @ along
    return EliminatedTies(group, free, along, basis, triangle, views.centres.T)


def _by_orientations(group: TieGroup, l: np.ndarray, A: Partials, views: Views) -> np.ndarray:
    """(n, 3 k, active columns and l) A_o and l."""
    k, n = group.rows.shape
    rows = np.zeros((n, k, 3, group.active + 1))
    by_component = rows.transpose(2, 3, 1, 0)
    by_component[:, -1] = l
    if group.per_pair:
        by_pointing = A.by_pointing.reshape(3, 3, k, n)
        for i in range(k):
            at = group.posed + group.per_pair * i
            by_component[:, at : at + group.per_pair, i] = by_pointing[:, :, i]
    stops = group.stops[group.signature] if group.is_shared else group.stops
    for slot in range(1, group.slots[-1] + 1):
        seen = slice(group.slots.index(slot), bisect_right(group.slots, slot))
        own, at = A.of(slice(seen.start * n, seen.stop * n)), STOP_UNKNOWNS * (slot - 1)
        own_by_point = own.by_point.reshape(3, 3, -1, n)
        for turn, of, sign in ((at, slot, 1.0), (group.relative, 0, -1.0)):
            arm, shift = views.arm(own.X[:, :n], stops[:, of]), turn + 3
            by_component[:, turn:shift, seen] = sign * cross_rows(own_by_point, arm)
            by_component[:, shift : shift + 3, seen] = -sign * own_by_point
    return rows.reshape(n, 3 * k, -1)


def orthonormalise(A_t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Q (3, rows, n), column by column, and R (3, 3, n) of many A_t (column, row, n)."""
    Q = A_t.copy()
    R = np.zeros((3, 3, A_t.shape[-1]))
    for c in range(3):
        column = Q[c]
        length = left = np.sqrt(_dot(column, column))
        if c:
            for _ in range(2):
                r = np.einsum("drn,rn->dn", Q[:c], column)
                column -= np.einsum("drn,dn->rn", Q[:c], r)
                R[:c, c] += r
            left = np.sqrt(_dot(column, column))
        determined = left > NEGLIGIBLE * length
        R[c, c] = determined * left
        column *= determined / np.where(determined, left, 1.0)
    return Q, R


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products of many columns (rows, n)."""
    return np.einsum("rn,rn->n", a, b)


def place_points(ties: EliminatedTies, x: np.ndarray) -> np.ndarray:
    """Corrections (3, n) of the group's points, relative to those that their base stop causes.

    `x` (signatures, active columns) are corrections of the orientations.
    """
    if ties.group.is_shared:
        x = x[ties.group.signature]
    by_orientations = (ties.along[:, :, :-1] @ x[:, :, None])[:, :, 0]
    return _back_substitute(ties.triangle, (ties.along[:, :, -1] - by_orientations).T)


def _back_substitute(R: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve R x = right (3, ..., n) for many upper triangles (3, 3, n).

    Zero along what the images do not determine.
    """
    pivots = R[range(3), range(3)]
    scale = (pivots > 0) / np.where(pivots > 0, pivots, 1.0)
    x = np.empty(right.shape)
    x[2] = scale[2] * right[2]
    x[1] = scale[1] * (right[1] - R[1, 2] * x[2])
    x[0] = scale[0] * (right[0] - R[0, 1] * x[1] - R[0, 2] * x[2])
    return x
