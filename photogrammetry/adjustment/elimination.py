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

from dataclasses import dataclass

import numpy as np

from photogrammetry.adjustment.collinearity import PAIR_UNKNOWNS, STOP_UNKNOWNS, Partials
from photogrammetry.adjustment.layout import TieGroup

UNFELT = 1e-13
"""A column of A_t shorter than this share of itself after the others were taken out is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class EliminatedTies:
    """One group after elimination: what goes to the orientations and what gives the points back."""

    group: TieGroup
    A: np.ndarray
    """(n, 3k, relative) P A_o."""
    b: np.ndarray
    """(n, 3k) P l."""
    A1: np.ndarray
    """(n, 3, relative) Q' A_o."""
    b1: np.ndarray
    """(n, 3) Q' l."""
    R: np.ndarray
    """(n, 3, 3)."""
    Q: np.ndarray
    """(n, 3k, 3)."""
    T: np.ndarray
    """(signatures, relative, absolute)."""

    def normals(self) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix and right-hand side of every signature, in absolute columns."""
        first, felt = self.group.first, self.group.felt
        N = np.add.reduceat(self.A.mT @ self.A, first, axis=0)
        n = np.add.reduceat(np.einsum("nr,nrc->nc", self.b, self.A), first, axis=0)
        if felt == self.group.relative:
            return N, n
        # T' N T, T being a unit matrix but for the columns of the base
        posed = felt - STOP_UNKNOWNS - PAIR_UNKNOWNS * self.group.seen
        base = self.T[:, :posed, -STOP_UNKNOWNS:]
        full = np.empty((len(N), felt, felt))
        full[:, :-6, :-6] = N
        full[:, :-6, -6:] = N[:, :, :posed] @ base
        full[:, -6:, :-6] = full[:, :-6, -6:].mT
        full[:, -6:, -6:] = base.mT @ full[:, :posed, -6:]
        return full, np.concatenate([n, np.einsum("nc,ncb->nb", n[:, :posed], base)], axis=1)


def eliminate(
    group: TieGroup, misclosure: np.ndarray, partials: Partials, centres: np.ndarray
) -> EliminatedTies:
    """Free a group of its points; misclosures (3, k n) and partials are whitened."""
    k, n = group.rows.shape
    Q, R = orthonormal(partials.by_point.reshape(3, 3, k, n))
    by_row = np.zeros((n, k, 3, group.relative))
    for i, slot in enumerate(group.slots):
        part = slice(i * n, i * n + n)
        at = STOP_UNKNOWNS * group.slots[-1] + PAIR_UNKNOWNS * i
        by_row[:, i, :, at : at + 3] = partials.by_pointing[:, :, part].transpose(2, 0, 1)
        if slot:
            at = STOP_UNKNOWNS * (slot - 1)
            by_row[:, i, :, at : at + 6] = partials.of(part).by_stop.transpose(2, 0, 1)
    A = by_row.reshape(n, 3 * k, group.relative)
    l = misclosure.reshape(3, k, n).transpose(2, 1, 0).reshape(n, 3 * k)
    A1, b1 = Q.mT @ A, np.einsum("nrc,nr->nc", Q, l)
    A -= Q @ A1
    b = l - np.einsum("nrc,nc->nr", Q, b1)
    return EliminatedTies(group, A, b, A1, b1, R, Q, group.to_relative(centres))


def orthonormal(A_t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Q (n, 3k, 3) and R (n, 3, 3) of many A_t (coordinate, unknown, k, n)."""
    Q = A_t.swapaxes(0, 1).copy()
    R = np.zeros((3, 3, A_t.shape[-1]))
    for c in range(3):
        length = np.sqrt((Q[c] ** 2).sum(axis=(0, 1)))
        for _ in range(2):
            for d in range(c):
                r = (Q[d] * Q[c]).sum(axis=(0, 1))
                Q[c] -= r * Q[d]
                R[d, c] += r
        left = np.sqrt((Q[c] ** 2).sum(axis=(0, 1)))
        R[c, c] = np.where(left > UNFELT * length, left, 0.0)
        Q[c] *= np.divide(1.0, R[c, c], out=np.zeros_like(left), where=R[c, c] > 0)
    n = A_t.shape[-1]
    return Q.transpose(3, 2, 1, 0).reshape(n, -1, 3), R.transpose(2, 0, 1).copy()


def place_points(
    ties: EliminatedTies, turn_shift: np.ndarray, pointing: np.ndarray, pairs: np.ndarray
) -> np.ndarray:
    """Corrections (n, 3) of the group's points, relative to what their base stop does to them.

    `pairs` (k, n) took the observations; corrections of the orientations are those of all.
    """
    group = ties.group
    x = pointing[pairs].transpose(1, 0, 2).reshape(group.points, -1)
    if posed := STOP_UNKNOWNS * group.slots[-1]:
        others, base = turn_shift[group.stops[:, 1:]], turn_shift[group.stops[:, 0]]
        carried = ties.T[:, :posed, group.relative :] @ base[:, :, None]
        moved = others.reshape(len(base), -1) + carried[:, :, 0]
        x = np.concatenate([moved[group.signature], x], axis=1)
    return _back_substitute(ties.R, ties.b1 - (ties.A1 @ x[:, :, None])[:, :, 0])


def _back_substitute(R: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve R x = right for many upper triangles; nothing along what the images do not feel."""
    x = np.zeros_like(right)
    for i in (2, 1, 0):
        known = (R[:, i, i + 1 :] * x[:, i + 1 :]).sum(axis=1)
        felt = R[:, i, i] > 0
        np.divide(right[:, i] - known, R[:, i, i], out=x[:, i], where=felt)
    return x


def inverse_of(R: np.ndarray) -> np.ndarray:
    """R^-1 of many upper triangles; NaN where the images do not feel some direction."""
    columns = [_back_substitute(R, np.tile(unit, (len(R), 1))) for unit in np.eye(3)]
    inverse = np.stack(columns, axis=-1)
    inverse[(np.diagonal(R, axis1=1, axis2=2) <= 0).any(axis=1)] = np.nan
    return inverse
