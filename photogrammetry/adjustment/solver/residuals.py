"""Residuals of an adjustment, their redundancy, and covariances of points.

With the cofactors of the whitened residuals (see `elimination`) the standardised residual of a
coordinate, and the test of a whole observation (sample, line and parallax together, because a wrong
match is wrong in all of them; Teunissen 1985), are

    w_i = v_i / sqrt(q_ii),      q_ii = redundancy number, the share of an error that shows in v_i
    T = sqrt(v' Q_vv^-1 v)       chi distributed; a blunder g shifts it by sqrt(g' Q_vv g)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import Sights, State, Views
from solmap.photogrammetry.adjustment.model.small_matrices import (
    Matrices,
    Vectors,
    cross_matrices,
    cross_matrix,
    inverses_by_component,
    product,
    transform,
)
from solmap.photogrammetry.adjustment.solver.elimination import EliminatedTies, symmetric
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.robust import MAD_TO_SIGMA

UNCHECKED = 1e-6
"""Redundancy number below which it is rounding error: no other observation checks the
coordinate."""

CERTAIN = 2.0
"""Deviations of a spread or count up to this many standard deviations are not significant."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of all observations; NaN and 0 for those outside the adjustment."""

    standardised: np.ndarray
    redundancy: np.ndarray
    test: np.ndarray
    """T of every observation; zero where no other observation checks it."""

    def spread(self, rows: np.ndarray) -> float:
        """max(1, robust spread of standardised residuals), as far as it is significant.

        1.17 / sqrt(n) is the standard deviation of the spread of n residuals.
        """
        rows = np.flatnonzero(rows)
        w, free = np.abs(self.standardised[rows]), float(self.redundancy[rows].sum())
        w = w[np.isfinite(w)]
        sure = 1.0 - CERTAIN * 1.17 / np.sqrt(max(free, 1.0))
        return max(1.0, sure * float(MAD_TO_SIGMA * np.median(w))) if len(w) else 1.0


def residuals(problem: Problem, ties: tuple[EliminatedTies, ...], inverse: np.ndarray) -> Residuals:
    """Standardised residuals, redundancy numbers and tests."""
    observations = problem.observations
    n = len(observations)
    w, r, T = np.full((n, 3), np.nan), np.zeros((n, 3)), np.zeros(n)
    for tie, places in zip(ties, problem.places, strict=True):
        counts, rows = tie.group.counts.ravel(), tie.group.rows.ravel()
        C = cofactors(tie, inverse[places]).reshape(3, 3, -1)
        v = tie.residuals
        if not counts.all():
            C, v, rows = C[:, :, counts], v[:, counts], rows[counts]
        q = np.clip(C[range(3), range(3)], 0.0, 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            w[rows] = np.where(q > UNCHECKED, v / np.sqrt(q), np.nan).T
        r[rows], T[rows] = q.T, _tests(v, C)
    unmeasured = observations.weight == 0
    w[unmeasured], r[unmeasured] = np.nan, 0.0
    return Residuals(w, r, T)


def cofactors(tie: EliminatedTies, triangle: np.ndarray) -> np.ndarray:
    """Q_vv of the three coordinates of each observation of a group, (3, 3, k, n).

    `triangle` are the cofactors of its active columns, row by row of the lower triangle, by
    signature.
    """
    group, shape = tie.group, (tie.group.points, tie.group.seen, 3, -1)
    Z = tie.relative_cofactors(triangle)
    if group.is_shared:
        Z = Z[group.signature]
    A = tie.free[:, :, : group.relative]
    # with the many along the last axis: for matrices so small that is faster than one by one
    by_component = (part.reshape(shape).transpose(2, 1, 3, 0).copy() for part in (A, A @ Z))
    C = np.einsum("aicn,bicn->abin", *by_component)
    Q = tie.basis.mT.reshape(shape).transpose(2, 1, 3, 0).copy()
    C += np.einsum("aidn,bidn->abin", Q, Q)
    np.negative(C, out=C)
    C[range(3), range(3)] += 1.0
    return C


def _tests(v: Vectors, C: Matrices) -> np.ndarray:
    """T of residuals; an unchecked observation has no residual and does not count."""
    sure = C + UNCHECKED * np.eye(3)[:, :, None]
    weighted = transform(inverses_by_component(sure), v)
    return np.sqrt(np.maximum(np.einsum("cn,cn->n", v, weighted), 0.0))


def point_covariances(
    problem: Problem, state: State, ties: tuple[EliminatedTies, ...], inverse: np.ndarray
) -> np.ndarray:
    """Covariances of points: from their images, and from the pose of their base stop.

    dX = M x_b + R^-1 (noise - Q' A_o x), with `arm` the vector from the base stop to the point. NaN
    for points outside the adjustment.
    """
    C = np.full((problem.observations.points, 3, 3), np.nan)
    for tie, places in zip(ties, problem.places, strict=True):
        group, active = tie.group, tie.group.active
        numbers = problem.observations.point[group.rows[0]]
        base = group.stops[group.signature, 0] if group.is_shared else group.stops[:, 0]
        arm, back = state.points[numbers] - state.centres[base], tie.inverse_triangle
        noise = np.einsum("ijn,kjn->nik", back, back)
        noise[~tie.is_determined] = np.nan
        G = np.zeros((group.points, 3, group.local.shape[1]))
        np.matmul(-back.transpose(2, 0, 1).copy(), tie.along[:, :, :active], out=G[:, :, :active])
        G[:, :, -6:-3] -= cross_matrix(arm)
        G[:, :, -3:] += np.eye(3)
        Z = _base_and_active(problem, tie, inverse, places)
        C[numbers] = G @ (Z[group.signature] if group.is_shared else Z) @ G.mT + noise
    return C


def _base_and_active(
    problem: Problem, tie: EliminatedTies, inverse: np.ndarray, places: np.ndarray
) -> np.ndarray:
    """Cofactors of all absolute columns of a group, signature by signature."""
    group = tie.group
    if not group.slots[-1]:  # seen from one stop: no pose is active
        return inverse[problem.pattern.own(group.stops[:, 0], group.local)]
    return symmetric(inverse[places], group.active)


def joint_covariances(problem: Problem, inverse: np.ndarray) -> np.ndarray:
    """(pairs, 9, 9) of rotation and shift of the stop and pointing of the pair; zero where held."""
    unknowns = problem.unknowns
    local = unknowns.columns(np.arange(len(unknowns.pair_stop)))
    return inverse[problem.pattern.own(unknowns.pair_stop, local)]


def pair_covariances(views: Views, joint: np.ndarray) -> np.ndarray:
    """(pairs, 6, 6) of rotation vector and origin of every pair in the LSL, from `joint`.

    The mast rotates the pair's frame, and moves its origin about the mast head.
    """
    masts, to_lsl = views.masts(), views.pairs[:9].reshape(3, 3, -1).swapaxes(0, 1)
    arm, lever = views.arm(views.pairs[9:12], views.stop), transform(to_lsl, masts[:3])
    by_pointing = product(to_lsl, masts[3:].reshape(3, 3, -1))
    J = np.zeros((len(joint), 6, 9))
    J[:, :3, :3] = J[:, 3:, 3:6] = np.eye(3)
    J[:, 3:, :3] = -cross_matrix(arm.T)
    J[:, :3, 6:] = by_pointing.transpose(2, 0, 1)
    J[:, 3:, 6:] = -product(cross_matrices(lever), by_pointing).transpose(2, 0, 1)
    return J @ joint @ J.mT


def single_sighting_covariances(views: Views, sights: Sights, of_pair: np.ndarray) -> np.ndarray:
    """Covariances of points placed by one stereo observation each; `of_pair` those of the pairs.

    The point moves rigidly with its pair. The noise of the image adds depth over focal length per
    pixel along the image axes, and depth / (f B) times that along the line of sight.
    """
    table = np.take(views.pairs[:14], sights.pair, axis=1)
    right, down, axis, origin = table[:12].reshape(4, 3, -1)
    arm = np.take(views.points, sights.point, axis=1) - origin
    across, along = (depth := np.einsum("im,im->m", axis, arm)) / table[12], depth / table[13]
    noise = np.stack([right, down, arm]) / sights.weight[:, None]
    noise[:2] *= across
    noise[2] *= along / table[12]
    G = np.empty((len(sights), 3, 6))
    G[:, :, :3], G[:, :, 3:] = -cross_matrix(arm.T), np.eye(3)
    carried = G @ of_pair[sights.pair] @ G.mT
    return carried + np.einsum("dim,djm->ijm", noise, noise).transpose(2, 0, 1)
