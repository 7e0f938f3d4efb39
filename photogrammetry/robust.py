"""Robust statistics: spread and weights of residuals that include blunders."""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import Float, PerPoint

MAD_TO_SIGMA = 1.4826
"""Ratio of the standard deviation of a normal distribution to its median absolute deviation."""


def robust_sigma(residuals: Float[np.ndarray, "*shape"]) -> float:
    """Standard deviation about zero by the median absolute residual, in its unit; 0 if empty."""
    return MAD_TO_SIGMA * float(np.median(np.abs(residuals))) if residuals.size else 0.0


def geman_mcclure_weights(residuals: PerPoint, scale: float) -> PerPoint:
    """Weights 1 / (1 + (r / 2s)^2)^2 of residuals, 1 for none and a quarter at twice the scale."""
    return 1.0 / (1.0 + (residuals / (2.0 * scale)) ** 2) ** 2
