"""The radial polynomial that CAHVOR and CAHVORE share, its inverse and where it may be used.

A point at the distance chi from the distortion axis (a tangent for CAHVOR, an angle-like quantity
for CAHVORE) is imaged at the distance

    chi' = chi (1 + R0 + R1 chi^2 + R2 chi^4).

Beyond the first zero of d(chi')/d(chi) = 1 + R0 + 3 R1 chi^2 + 5 R2 chi^4 the polynomial turns
back: points far outside the field would reappear in the image. They have no image.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import PerPoint, Vector3
from solmap.photogrammetry.errors import CameraError

NEWTON_STEPS = 50
NEWTON_STOP = 1e-14
"""Relative; JPL stops at 1e-8, which costs a round trip 7e-8 px."""


def check_radial(r: Vector3) -> None:
    """Refuse a polynomial that mirrors or collapses the image on its axis."""
    if not 1.0 + r[0] > 0:
        raise CameraError(f"R0 = {r[0]:g} of a camera model: the scale 1 + R0 must be above zero")


def largest_square(r: Vector3) -> float:
    """Square of the largest chi that the polynomial maps uniquely; infinity if it never turns."""
    linear, quadratic, constant = 3.0 * r[1], 5.0 * r[2], 1.0 + r[0]
    if quadratic == 0.0:
        with np.errstate(over="ignore"):
            return float(-constant / linear) if linear < 0 else np.inf
    discriminant = linear * linear - 4.0 * quadratic * constant
    if discriminant < 0:
        return np.inf
    # Stable for tiny quadratic terms: the roots are q / quadratic and constant / q.
    q = -0.5 * (linear + np.copysign(np.sqrt(discriminant), linear))
    with np.errstate(over="ignore"):
        roots = [root for root in (q / quadratic, constant / q if q else np.inf) if root > 0]
    return float(min(roots, default=np.inf))


def undistorted(distorted: PerPoint, r: Vector3) -> PerPoint:
    """Solve chi (1 + R0 + R1 chi^2 + R2 chi^4) = chi' by Newton's method; NaN where it fails.

    Where the polynomial is far from linear Newton may leave the branch; such rows are NaN, too.
    """
    limit = np.sqrt(largest_square(r))
    chi = np.minimum(distorted / (1.0 + r[0]), 0.999 * limit)
    step = np.zeros_like(chi)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(NEWTON_STEPS):
            square = chi * chi
            slope = 1.0 + r[0] + square * (3.0 * r[1] + square * 5.0 * r[2])
            value = chi * (1.0 + r[0] + square * (r[1] + square * r[2]))
            step = (value - distorted) / slope
            chi = np.clip(chi - step, 0.5 * chi, np.minimum(2.0 * chi, limit))
            if not np.any(np.abs(step) > NEWTON_STOP * chi):
                break
    settled = np.abs(step) <= 1e-10 * np.maximum(chi, NEWTON_STOP)
    return np.where(settled, chi, np.nan)
