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

from photogrammetry.adjustment.collinearity import Observations
from photogrammetry.adjustment.elimination import EliminatedTies, cofactors
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.solver import Problem

UNCHECKED = 1e-6
"""A redundancy number below this is rounding: nothing checks the coordinate."""


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


def residuals(problem: Problem, ties: tuple[EliminatedTies, ...], inverse: np.ndarray) -> Residuals:
    """Standardised residuals, redundancy numbers and covariances of tie points."""
    observations = problem.observations
    n = len(observations)
    w, r = np.full((n, 3), np.nan), np.zeros((n, 3))
    C = np.full((observations.points, 3, 3), np.nan)
    for tie in ties:
        group = tie.group
        k = group.seen
        Z = cofactors(tie.places, inverse, group)
        Q2 = tie.Q[:, :, 3:]
        inner = np.eye(3 * k - 3) - tie.A @ Z @ tie.A.swapaxes(1, 2)
        q = np.clip(((Q2 @ inner) * Q2).sum(axis=2), 0.0, 1.0)
        v = (Q2 @ tie.b[:, :, None])[:, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            standard = np.where(q > UNCHECKED, v / np.sqrt(q), np.nan)
        w[group.rows], r[group.rows] = standard.reshape(-1, k, 3), q.reshape(-1, k, 3)
        numbers = observations.point[group.rows[:, 0]]
        C[numbers] = _point_covariances(tie, Z)
    unmeasured = observations.weight == 0
    w[unmeasured], r[unmeasured] = np.nan, 0.0
    return Residuals(w, r, C)


def _point_covariances(tie: EliminatedTies, Z: np.ndarray) -> np.ndarray:
    inner = np.eye(3) + tie.A1 @ Z @ tie.A1.swapaxes(1, 2)
    try:
        R_inverse = np.linalg.inv(tie.R)
    except np.linalg.LinAlgError:
        R_inverse = np.linalg.pinv(tie.R)
    return R_inverse @ inner @ R_inverse.swapaxes(1, 2)


def suspects(problem: Problem, found: Residuals, params: AdjustmentParams) -> np.ndarray:
    """Numbers of the observations to take out: the worst of each tie point beyond the critical."""
    observations: Observations = problem.observations
    worst = np.nanmax(np.nan_to_num(np.abs(found.standardised)), axis=1, initial=0.0)
    rows = np.flatnonzero(worst > params.critical_value * found.scale)
    rows = rows[np.argsort(-worst[rows], kind="stable")]
    _, first = np.unique(observations.point[rows], return_index=True)
    return rows[first]
