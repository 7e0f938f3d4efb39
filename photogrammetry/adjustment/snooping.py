"""Data snooping: which observations cannot be what they claim (Baarda 1968).

With the cofactors of the whitened residuals (see `elimination`) the standardised residual of a
coordinate is

    w_i = v_i / sqrt(q_ii),      q_ii = redundancy number, the share of an error that shows in v_i

and an observation (left point and parallax together) is suspected of being a blunder where any
|w_i| exceeds the critical value times max(1, s), s the robust spread (1.48 median |w|) of all of
them: where matching promised more than it held, every residual is large, and that is a finding
for sigma0 rather than a thousand blunders. In each tie point only the worst observation is taken
out a round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photogrammetry.adjustment.collinearity import (
    Observations,
    State,
    misclosures,
    partials,
)
from photogrammetry.adjustment.elimination import EliminatedTies, inverse_of
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.problem import Problem
from photogrammetry.adjustment.rotations import cross_matrix

UNCHECKED = 1e-6
"""A redundancy number below this is rounding: nothing checks the coordinate."""

LINEAR = 0.1
"""A prediction tells something only while its depth is known to a tenth: within, errors propagate
linearly."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of all observations; NaN and 0 for those outside the adjustment."""

    standardised: np.ndarray
    redundancy: np.ndarray
    point_covariances: np.ndarray

    @property
    def scale(self) -> float:
        """max(1, robust spread of the standardised residuals)."""
        w = np.abs(self.standardised[np.isfinite(self.standardised)])
        return max(1.0, float(1.4826 * np.median(w))) if len(w) else 1.0


def residuals(
    problem: Problem, state: State, ties: tuple[EliminatedTies, ...], inverse: np.ndarray
) -> Residuals:
    """Standardised residuals, redundancy numbers and covariances of tie points."""
    observations = problem.observations
    n = len(observations)
    w, r = np.full((n, 3), np.nan), np.zeros((n, 3))
    C = np.full((observations.points, 3, 3), np.nan)
    for tie in ties:
        group, number = tie.group, tie.group.signature
        Z = inverse[problem.pattern.indices(group.blocks, group.local)]
        relative = (tie.T @ Z @ tie.T.mT)[number]
        free = 1.0 - (tie.Q**2).sum(axis=2)
        q = np.clip(free - ((tie.A @ relative) * tie.A).sum(axis=2), 0.0, 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            standard = np.where(q > UNCHECKED, tie.b / np.sqrt(q), np.nan)
        rows = group.rows.T
        w[rows], r[rows] = standard.reshape(*rows.shape, 3), q.reshape(*rows.shape, 3)
        numbers = observations.point[rows[:, 0]]
        arm = state.points[numbers] - state.centres[group.stops[number, 0]]
        C[numbers] = _point_covariances(tie, arm, Z[number])
    unmeasured = observations.weight == 0
    w[unmeasured], r[unmeasured] = np.nan, 0.0
    return Residuals(w, r, C)


def _point_covariances(tie: EliminatedTies, arm: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Covariances of points: what their images leave open, and what their base stop carries over.

    dX = M x_b + R^-1 (noise - Q' A_o x), with `arm` the way from the base stop to the point.
    """
    R_inverse = inverse_of(tie.R)
    G = -R_inverse @ tie.A1 @ tie.T[tie.group.signature]
    G[:, :, -6:-3] -= cross_matrix(arm)
    G[:, :, -3:] += np.eye(3)
    return R_inverse @ R_inverse.mT + G @ Z @ G.mT


def suspects(problem: Problem, found: Residuals, params: AdjustmentParams) -> np.ndarray:
    """Numbers of the observations to take out: the worst of each tie point beyond the critical."""
    observations: Observations = problem.observations
    worst = np.nanmax(np.nan_to_num(np.abs(found.standardised)), axis=1, initial=0.0)
    rows = np.flatnonzero(worst > params.critical_value * found.scale)
    rows = rows[np.argsort(-worst[rows], kind="stable")]
    _, first = np.unique(observations.point[rows], return_index=True)
    return rows[first]


def joint_covariances(problem: Problem, inverse: np.ndarray) -> np.ndarray:
    """(pairs, 9, 9) of turn and shift of the stop and pointing of the pair; zero where held."""
    unknowns = problem.unknowns
    local = unknowns.columns(np.arange(len(unknowns.pair_stop)))
    stops = np.repeat(unknowns.pair_stop[:, None], local.shape[1], axis=1).astype(np.int64)
    return inverse[problem.pattern.indices(stops, local)]


def single_sightings(
    observations: Observations, state: State, rows: np.ndarray, joint: np.ndarray
) -> np.ndarray:
    """Covariance of points placed by one stereo observation each."""
    A_o, A_t = partials(state, observations, rows)
    back = np.linalg.inv(A_t)
    C = np.zeros((len(rows), 3, 3))
    diagonal = 1.0 / observations.weight[rows] ** 2
    C[:, range(3), range(3)] = diagonal
    total = C + A_o @ joint[observations.pair[rows]] @ A_o.swapaxes(1, 2)
    return back @ total @ back.swapaxes(1, 2)


def reinstated(
    problem: Problem,
    state: State,
    found: Residuals,
    used: np.ndarray,
    inverse: np.ndarray,
    params: AdjustmentParams,
) -> np.ndarray:
    """Numbers of observations set aside that fit after all.

    An observation that was left out is predicted from the point that the others give; it comes back
    when its misclosure is within the critical value of what both uncertainties explain.
    """
    observations = problem.observations
    joint = joint_covariances(problem, inverse)
    C = found.point_covariances.copy()
    alone = used & observations.is_stereo
    alone[problem.rows] = False
    single = np.flatnonzero(alone)
    C[observations.point[single]] = single_sightings(observations, state, single, joint)
    rows = np.flatnonzero(~used & observations.is_stereo)
    point = observations.point[rows]
    rows = rows[
        np.isfinite(C[point]).all(axis=(1, 2)) & np.isfinite(state.points[point]).all(axis=1)
    ]
    if not len(rows):
        return rows
    l = misclosures(state, observations, rows)
    A_o, A_t = partials(state, observations, rows)
    S = A_o @ joint[observations.pair[rows]] @ A_o.swapaxes(1, 2)
    S += A_t @ C[observations.point[rows]] @ A_t.swapaxes(1, 2)
    S[:, range(3), range(3)] += 1.0 / observations.weight[rows] ** 2
    l_finite = np.nan_to_num(l, nan=np.inf)
    with np.errstate(invalid="ignore"):
        misfit = (l_finite * np.linalg.solve(S, l_finite[:, :, None])[:, :, 0]).sum(axis=1)
    parallax = observations.measured[rows, 2] - l[:, 2]
    sharp = np.sqrt(np.maximum(S[:, 2, 2], 0.0)) < LINEAR * parallax
    small = misfit < (params.critical_value * found.scale) ** 2
    return rows[np.isfinite(l).all(axis=1) & sharp & small]
