"""Robust rigid alignment of two stops by the tie points that both triangulated.

    sum_i w_i e_i' S_i^-1 e_i                    e_i = X_i - (R Y_i + t)

with X_i and Y_i the point as triangulated at each of the two stops and S_i the sum of their
covariances, the second rotated. Wrong ties are down-weighted by graduated non-convexity (Yang et
al. 2020) with the truncated least-squares loss: w_i = 1 below, 0 above, and in between

    w_i = g sqrt(mu (mu + 1)) / r_i - mu,        r_i^2 = e_i' S_i^-1 e_i,  g the gate

with mu raised from nearly convex to the step function. No random sampling: the same network gives
the same initial values. Without an initial value the motion is found in closed form (Kabsch 1976),
with the covariances as scalar weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.model.small_matrices import (
    cross_matrix,
    inverses,
    rotation_of_vector,
)
from solmap.photogrammetry.arrays import Float64

GROSS = 4.0
"""The gate of ties in the alignment of two stops, in standard deviations (99.9 % of the chi
distribution, three degrees of freedom): ties beyond it do not enter the first adjustment."""
GROWTH = 2.0
"""Factor by which the loss is sharpened in each round; the publication uses 1.4, for far more
blunders."""
ROUNDS = 60
"""Most rounds; 31 are needed where the largest misfit is a thousand gates."""
HALF = 0.5
"""Weights converge to 0 or 1; this threshold separates the two."""
SHARP = 1e3
"""Final mu: weights between 0 and 1 remain only within 0.1 % of the gate."""


@dataclass(frozen=True, slots=True, eq=False)
class RigidPoints:
    """The same points as triangulated at two stops, with covariances."""

    X: Float64[np.ndarray, "n 3"]
    S_X: Float64[np.ndarray, "n 3 3"]
    Y: Float64[np.ndarray, "n 3"]
    S_Y: Float64[np.ndarray, "n 3 3"]

    def misfit(self, R: Float64[np.ndarray, "3 3"], t: Float64[np.ndarray, " 3"]) -> Misfit:
        """Distance of the points after the second stop is rotated and shifted."""
        turned = self.Y @ R.T
        return Misfit(self.X - turned - t, inverses(self.S_X + R @ self.S_Y @ R.T), turned)


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """The misfit of points at one motion."""

    e: Float64[np.ndarray, "n 3"]
    """X - (R Y + t)."""
    P: Float64[np.ndarray, "n 3 3"]
    """Inverse of its covariance."""
    turned: Float64[np.ndarray, "n 3"]
    """R Y."""

    @property
    def standardised(self) -> Float64[np.ndarray, " n"]:
        """Misfit of every point in its own standard deviations."""
        return np.sqrt((self.e * (self.P @ self.e[:, :, None])[:, :, 0]).sum(axis=1))

    def normals(self, weights: Float64[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix and right-hand side of (turn, shift) from the left."""
        A = np.empty((len(self.e), 3, 6))
        A[:, :, :3], A[:, :, 3:] = -cross_matrix(self.turned), np.eye(3)
        PA = (self.P @ A * weights[:, None, None]).reshape(-1, 6)
        return A.reshape(-1, 6).T @ PA, self.e.ravel() @ PA


@dataclass(frozen=True, slots=True, eq=False)
class TruncatedLoss:
    """The truncated least-squares loss at its present sharpness."""

    weights: Float64[np.ndarray, " n"]
    """Weights of squared misfits, 0 to 1."""
    mu: float = 0.0
    """Sharpness; zero before the first misfits are known."""
    is_settled: bool = False
    """Whether further sharpening would change nothing."""

    def sharpen(self, r: Float64[np.ndarray, " n"], gate: float) -> TruncatedLoss:
        """The loss one round sharper, for the standardised misfits `r` of the last weights."""
        mu = self.mu * GROWTH if self.mu else _first_sharpness(r, gate)
        with np.errstate(divide="ignore"):
            weights = np.clip(gate * np.sqrt(mu * (mu + 1)) / r - mu, 0.0, 1.0)
        same = r.max() <= gate and np.abs(weights - self.weights).max() < 1.0 / SHARP
        return TruncatedLoss(weights, mu, bool(mu >= SHARP or same))


def _first_sharpness(r: np.ndarray, gate: float) -> float:
    """Initial sharpness: nearly convex for the largest misfit."""
    return gate**2 / max(2 * float(r.max()) ** 2 - gate**2, 1e-9)


def closed_form_motion(points: RigidPoints, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least-squares rigid motion with one weight per point."""
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
    R, t = closed_form_motion(points, 1.0 / size)
    misfit = points.misfit(R, t)
    for _ in range(ROUNDS):
        R, t = _gauss_newton_step(misfit, R, t, loss.weights)
        misfit = points.misfit(R, t)
        loss = loss.sharpen(misfit.standardised, gate)
        if loss.is_settled:
            break
    R, t = _gauss_newton_step(misfit, R, t, loss.weights)
    return R, t, points.misfit(R, t).normals(loss.weights)[0], loss.weights


def _gauss_newton_step(
    misfit: Misfit, R: np.ndarray, t: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """One Gauss-Newton step from a motion and its misfit."""
    N, n = misfit.normals(weights)
    x = np.linalg.solve(N + 1e-12 * np.trace(N) * np.eye(6) + np.eye(6) * 1e-12, n)
    turn = rotation_of_vector(x[:3])
    return turn @ R, t + x[3:]
