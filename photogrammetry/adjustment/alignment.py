"""Rigid alignment of what two stops have of the same points, wrong ties weighed down.

    sum_i w_i e_i' S_i^-1 e_i                    e_i = X_i - (R Y_i + t)

with X_i and Y_i the two places of a point and S_i the sum of their covariances, the second one
turned. Wrong ties are weighed down by graduated non-convexity (Yang et al. 2020) with the truncated
least-squares loss: w_i = 1 below, 0 above, and in between

    w_i = g sqrt(mu (mu + 1)) / r_i - mu,        r_i^2 = e_i' S_i^-1 e_i,  g the gate

with mu raised from nearly convex to the step function. No random sampling: the same network gives
the same start. Without an initial value the motion is found in closed form (Kabsch 1976), with the
covariances as mere scales.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photogrammetry.adjustment.rotations import cross_matrix, rotation_of_vector
from photogrammetry.adjustment.sightings import inverses
from photogrammetry.arrays import Float64

GROWTH = 2.0
"""Factor by which the loss is sharpened a round; 1.4 in the publication, for far more blunders."""
ROUNDS = 60
"""At most: it takes 31 where the greatest misfit is a thousand gates."""
HALF = 0.5
"""Weights end at 0 or 1; this tells them apart."""
SHARP = 1e3
"""Where mu ends: weights between 0 and 1 are then left only within 0.1 % of the gate."""


@dataclass(frozen=True, slots=True, eq=False)
class RigidPoints:
    """The same points as two stops have them, with covariances."""

    X: Float64[np.ndarray, "n 3"]
    S_X: Float64[np.ndarray, "n 3 3"]
    Y: Float64[np.ndarray, "n 3"]
    S_Y: Float64[np.ndarray, "n 3 3"]

    def misfit(
        self, R: Float64[np.ndarray, "3 3"], t: Float64[np.ndarray, " 3"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """X - (R Y + t), and the inverse of its covariance."""
        return self.X - self.Y @ R.T - t, inverses(self.S_X + R @ self.S_Y @ R.T)

    def standardised(self, R: np.ndarray, t: np.ndarray) -> Float64[np.ndarray, " n"]:
        """Misfit of every point in its own standard deviations."""
        e, P = self.misfit(R, t)
        return np.sqrt((e * (P @ e[:, :, None])[:, :, 0]).sum(axis=1))

    def normals(
        self, R: np.ndarray, t: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix and right-hand side of (turn, shift) from the left."""
        e, P = self.misfit(R, t)
        turned = self.Y @ R.T
        A = np.concatenate(
            [-cross_matrix(turned), np.broadcast_to(np.eye(3), (len(e), 3, 3))], axis=2
        )
        PA = P @ A * weights[:, None, None]
        return A.reshape(-1, 6).T @ PA.reshape(-1, 6), e.ravel() @ PA.reshape(-1, 6)


@dataclass(frozen=True, slots=True, eq=False)
class TruncatedLoss:
    """The truncated least-squares loss, as far as it is sharpened by now."""

    weights: Float64[np.ndarray, " n"]
    """Of squared misfits, 0 to 1."""
    mu: float = 0.0
    """How sharp it is; zero before the first misfits are known."""
    is_settled: bool = False
    """Whether further sharpening would change nothing."""

    def sharpened(self, r: Float64[np.ndarray, " n"], gate: float) -> TruncatedLoss:
        """The loss a round sharper, for standardised misfits `r` that the weights led to."""
        mu = self.mu * GROWTH if self.mu else _first_sharpness(r, gate)
        with np.errstate(divide="ignore"):
            weights = np.clip(gate * np.sqrt(mu * (mu + 1)) / r - mu, 0.0, 1.0)
        same = r.max() <= gate and np.abs(weights - self.weights).max() < 1.0 / SHARP
        return TruncatedLoss(weights, mu, bool(mu >= SHARP or same))


def _first_sharpness(r: np.ndarray, gate: float) -> float:
    """Where the sharpening begins: nearly convex for the greatest misfit."""
    return gate**2 / max(2 * float(r.max()) ** 2 - gate**2, 1e-9)


def closed_form(points: RigidPoints, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rigid motion of least squares with one weight a point."""
    w = weights / weights.sum()
    middle_x, middle_y = w @ points.X, w @ points.Y
    U, _, Vt = np.linalg.svd((points.X - middle_x).T @ ((points.Y - middle_y) * w[:, None]))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return R, middle_x - R @ middle_y


def rigid_motion(
    points: RigidPoints, gate: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rotation, translation, information, and the weight (0..1) of each point."""
    size = np.trace(points.S_X, axis1=1, axis2=2) + np.trace(points.S_Y, axis1=1, axis2=2)
    loss = TruncatedLoss(np.ones(len(size)))
    R, t = closed_form(points, 1.0 / size)
    for _ in range(ROUNDS):
        R, t = _turned(points, R, t, loss.weights)
        loss = loss.sharpened(points.standardised(R, t), gate)
        if loss.is_settled:
            break
    R, t = _turned(points, R, t, loss.weights)
    return R, t, points.normals(R, t, loss.weights)[0], loss.weights


def _turned(
    points: RigidPoints, R: np.ndarray, t: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """One Gauss-Newton step."""
    N, n = points.normals(R, t, weights)
    x = np.linalg.solve(N + 1e-12 * np.trace(N) * np.eye(6) + np.eye(6) * 1e-12, n)
    turn = rotation_of_vector(x[:3])
    return turn @ R, t + x[3:]
