"""The spread of residuals among which some are blunders."""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import Float

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def robust_sigma(residuals: Float[np.ndarray, "*shape"]) -> float:
    """Standard deviation about zero by the median absolute residual, in its unit; 0 of none."""
    return MAD_TO_SIGMA * float(np.median(np.abs(residuals))) if residuals.size else 0.0
