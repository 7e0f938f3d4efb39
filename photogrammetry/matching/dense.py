"""Dense parallax of a pair: semi-global matching, checked both ways, then refined by least squares.

1. Semi-global matching (Hirschmüller 2008, OpenCV's StereoSGBM) of the locally normalised images
   from left to right and, mirrored, from right to left. A parallax stays where both agree within
   a pixel, where it is part of a larger surface, and where the texture exceeds the noise.
2. Its values crowd at whole pixels (pixel locking). They are smoothed without crossing depth edges
   and then corrected by Lucas-Kanade steps in one dimension, for all pixels at once: with the left
   slope g and the residual r = R(x - p(x, y), y) - L(x, y) under the parallax of each pixel,

       dp = (sum g r - sum g sum r / n) / (sum g^2 - (sum g)^2 / n)

   summed over a window. Each pixel of the window being shifted by its own parallax, the window
   follows the slope of the ground, and a neighbour beyond a depth edge brings no parallax across.
3. The residuals after the last step give sigma^2 = s0^2 / (sum g^2 - (sum g)^2 / n).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from photogrammetry.arrays import GreyImage, ParallaxMap
from photogrammetry.matching.normalisation import eight_bit, locally_normalised, noise_level
from photogrammetry.matching.records import EpipolarImages
from photogrammetry.matching.sampling import along_rows, row_coefficients, row_slope
from photogrammetry.matching.semi_global import (
    SemiGlobalParams,
    matched_both_ways,
    without_speckle,
)
from photogrammetry.matching.sparse import largest_parallax_px

SMALLEST_SIGMA_PX = 0.03
"""What interpolation and the calibration of the stereo bar leave in the best of texture."""


@dataclass(frozen=True, slots=True)
class DenseParams:
    """How every pixel is matched."""

    nearest_range_m: float = 1.2
    """Nearest ground, as in sparse matching: sets the search."""
    least_parallax_px: int = -2
    """Parallax of infinity less what an error of the stereo bar of 0.1 degrees may take off."""
    normalisation_px: int = 31
    """Window of the local normalisation, odd: wider than any correlation window."""
    semi_global: SemiGlobalParams = field(default_factory=SemiGlobalParams)
    window_px: int = 9
    """Window of the refinement, odd; triangular weights make its effective width about 6."""
    steps: int = 3
    """Lucas-Kanade steps."""
    smoothing_px: float = 2.0
    """Standard deviation in space of the smoothing that undoes pixel locking, which recurs with
    every pixel of parallax: level ground changes by one in some seven rows of a Navcam image."""
    edge_px: float = 1.0
    """Standard deviation in parallax of that smoothing: what differs by more is another surface."""
    texture: float = 3.0
    """Least energy of the slope in a small window, in terms of what noise alone would give."""
    largest_sigma_px: float = 0.5
    """Parallaxes less precise than this are left out."""
    least_correlation: float = 0.5
    """Of the refinement windows after the last step; chance agreement of noise stays below."""


@dataclass(frozen=True, slots=True, eq=False)
class DenseMatches:
    """Parallax of every pixel that was matched, with its standard deviation."""

    parallax_px: ParallaxMap
    sigma_px: ParallaxMap


def match_densely(images: EpipolarImages, params: DenseParams | None = None) -> ParallaxMap:
    """Parallax on the grid of the left epipolar image; NaN where not matched."""
    return match_densely_with_sigma(images, params).parallax_px


def match_densely_with_sigma(
    images: EpipolarImages, params: DenseParams | None = None
) -> DenseMatches:
    """Parallax and its standard deviation on the grid of the left epipolar image."""
    params = params or DenseParams()
    grey = [
        locally_normalised(image, mask, params.normalisation_px, noise_level(image, mask))
        for image, mask in ((images.left, images.left_mask), (images.right, images.right_mask))
    ]
    largest = int(np.ceil(largest_parallax_px(images.geometry, params.nearest_range_m)))
    rough = matched_both_ways(
        eight_bit(grey[0]),
        eight_bit(grey[1]),
        (images.left_mask, images.right_mask),
        (params.least_parallax_px, largest),
        params.semi_global,
    )
    return refined(grey, rough, params)


def refined(grey: list[GreyImage], rough: ParallaxMap, params: DenseParams) -> DenseMatches:
    """Parallax refined at all pixels at once, where texture and precision allow."""
    left, right = grey
    coefficients = row_coefficients(right)
    slope = row_slope(row_coefficients(left))
    parallax = smoothed(rough, params)
    for _ in range(params.steps - 1):
        step, _, _ = _step(left, coefficients, slope, parallax, params)
        parallax = smoothed(parallax + step, params)
    step, sigma, correlation = _step(left, coefficients, slope, parallax, params)
    parallax = parallax + step
    good = (sigma <= params.largest_sigma_px) & (correlation >= params.least_correlation)
    good &= np.abs(parallax - rough) <= 1.5  # noqa: PLR2004 - further off, the window saw another surface
    good &= parallax > 0
    parallax = without_speckle(np.where(good, parallax, np.float32(np.nan)), params.semi_global)
    return DenseMatches(parallax, np.where(np.isfinite(parallax), sigma, np.float32(np.nan)))


def smoothed(parallax: ParallaxMap, params: DenseParams) -> ParallaxMap:
    """Parallax smoothed within surfaces: a bilateral filter to which gaps are infinitely far."""
    known = np.isfinite(parallax)
    filled = np.where(known, parallax, np.float32(-1e4))
    out = cv2.bilateralFilter(filled, -1, params.edge_px, params.smoothing_px)
    return np.where(known, out, np.float32(np.nan))


def _step(
    left: GreyImage,
    coefficients: GreyImage,
    slope: GreyImage,
    parallax: ParallaxMap,
    params: DenseParams,
) -> tuple[ParallaxMap, ParallaxMap, GreyImage]:
    """Correction of the parallax, its standard deviation, and the correlation of the windows."""
    known = np.isfinite(parallax)
    grid = np.indices(parallax.shape, dtype=np.float32)
    right = along_rows(coefficients, grid[1] - np.where(known, parallax, 0), grid[0])
    r = np.where(known, right - left, 0)
    g = np.where(known, slope, 0)

    def total(values: GreyImage) -> GreyImage:
        half = params.window_px // 2 + 1
        once = cv2.blur(values, (half, half), borderType=cv2.BORDER_CONSTANT)
        return cv2.blur(once, (half, half), borderType=cv2.BORDER_CONSTANT) * half**2

    n = np.maximum(total(known.astype(np.float32)), np.float32(1e-3))
    sum_g, sum_r = total(g), total(r)
    energy = np.maximum(total(g * g) - sum_g * sum_g / n, np.float32(1e-6))
    step = (total(g * r) - sum_g * sum_r / n) / energy
    variance = np.maximum(total(r * r) - sum_r * sum_r / n, 0) / n
    sigma = np.sqrt(variance / energy)
    l2 = total(np.where(known, left * left, 0)) / n
    correlation = 1 - variance / np.maximum(2 * l2, np.float32(1e-6))
    return np.clip(step, -1, 1), sigma, correlation
