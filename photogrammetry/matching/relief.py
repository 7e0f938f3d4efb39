"""What relief within the matching window adds to the standard deviation of a match.

Least squares finds the parallax of the plane that fits the window best. The ground at its middle
leaves that plane, by far more than noise lets the plane be wrong where the texture is good. How far
shows when the same points are matched again with windows of half the width: beyond noise,

    e^2 = (p_half - p)^2 - (sigma_half^2 - sigma^2)

is the relief that the whole window takes out and the half one does not (the noise of an estimate
from a part of the data, less the one from all of it, has the difference of their variances). Ground
is rough at every scale, its height differences growing with distance like d^H; what is below the
half window is e^2 times 2^-2H, and so on, in all e^2 / (1 - 2^-2H) = 2 e^2 with H = 1/2 (between
rubble and rolling plains). One difference says little of its expectation, so that of the
neighbours joins in.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from solmap.photogrammetry.arrays import ImagePoints, PerPoint
from solmap.photogrammetry.matching.least_squares import LeastSquaresMatcher, RefinedParallax
from solmap.photogrammetry.robust import MAD_TO_SIGMA

BELOW_HALF = 2.0
"""Relief below the whole window over that between the half and the whole one, H = 1/2."""

LARGEST_PX = 1.0
"""Difference that is taken for a point the half window lost; more would be a blunder."""


@dataclass(frozen=True, slots=True)
class ReliefParams:
    """How relief within the window is estimated."""

    neighbours: int = 25
    """Matches whose median difference tells of the relief around: known to a fifth."""
    own_weight: float = 0.15
    """Weight of a match's own difference against that median: one draw against some six, as the
    relief of neighbours differs by half from place to place."""


def sigma_with_relief(
    matcher: LeastSquaresMatcher,
    points: ImagePoints,
    refined: RefinedParallax,
    params: ReliefParams,
) -> PerPoint:
    """Standard deviation, pixels, of refined parallaxes as those of the ground at the points."""
    if not len(points):
        return refined.sigma_px
    half = matcher.params.window_px // 2 | 1
    narrow = matcher.with_params(replace(matcher.params, window_px=half)).refine(
        points.astype(np.int32), refined.parallax_px
    )
    difference = np.where(narrow.settled, narrow.parallax_px - refined.parallax_px, LARGEST_PX)
    squared = np.minimum(difference**2, LARGEST_PX**2)
    noise = narrow.sigma_px**2 - refined.sigma_px**2
    nearest = KDTree(points).query(points, k=min(params.neighbours, len(points)))[1]
    nearest = nearest.reshape(len(points), -1)
    around = MAD_TO_SIGMA**2 * np.median(squared[nearest], axis=1) - np.median(
        noise[nearest], axis=1
    )
    relief = (1 - params.own_weight) * around + params.own_weight * (squared - noise)
    return np.sqrt(refined.sigma_px**2 + BELOW_HALF * np.maximum(relief, 0))
