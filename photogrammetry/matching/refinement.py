"""Parallax of all pixels at once, corrected by least squares in one dimension.

Values of semi-global matching crowd at whole pixels (pixel locking). They are smoothed without
crossing depth edges and then corrected by Lucas-Kanade steps: with the slope g of the left image
and the residual r = R(x - p(x, y), y) - L(x, y) under the parallax of each pixel,

    dp = (sum g r - sum g sum r / n) / E,     E = sum g^2 - (sum g)^2 / n,     sigma^2 = s0^2 / E

summed over a window with weights that fall off to its edge (a box applied twice), the residual
variance s0^2 coming from the same window. Each pixel being shifted by its own parallax, the window
follows the slope of the ground, and a neighbour beyond a depth edge brings no parallax across.

A pixel can be matched where slopes exceed what noise alone makes of them. White noise of variance
n^2 gives the slope of a cubic spline 1.39 n^2, the mean of (3 sin w / (2 + cos w))^2 over all
frequencies w, and a residual 2 n^2. So the noise is known twice: from the image as a whole, which
is too much in shadows, and from the residuals around, which is too much where the surface is rough.
The smaller of the two is held against the slopes.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from photogrammetry.arrays import GreyImage, Mask, ParallaxMap
from photogrammetry.matching.normalisation import NormalisedImage
from photogrammetry.matching.sampling import along_rows, row_coefficients, row_slope

SLOPE_NOISE = 1.39
"""Variance of the spline's slope over that of white noise."""


@dataclass(frozen=True, slots=True)
class RefinementParams:
    """How the parallax of every pixel is refined and judged."""

    box_px: int = 5
    """Side of the box, odd, that is applied twice: the window is 9 pixels wide, and half of its
    weight lies within 5, about the block of semi-global matching."""
    steps: int = 3
    """Lucas-Kanade steps."""
    smoothing_px: float = 2.0
    """Standard deviation in space of the smoothing that undoes pixel locking, which recurs with
    every pixel of parallax: level ground changes by one in some seven rows of a Navcam image."""
    edge_px: float = 1.0
    """Standard deviation in parallax of that smoothing: what differs by more is another surface."""
    furthest_px: float = 1.5
    """A pixel that moves further from its first parallax has slid to another surface."""
    texture: float = 2.0
    """Least energy of the slope, in units of what noise alone would give: as much texture as noise.
    Below that even the whole window leaves 0.2 px; the sky stays at 1."""
    texture_px: int = 5
    """Window of that energy, odd: small, so that the horizon lends no texture to the sky."""
    largest_sigma_px: float = 0.5
    """Parallaxes less precise than this are left out."""
    least_correlation: float = 0.6
    """Of the windows after the last step; chance agreement of noise stays below."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How the windows about all pixels agree under a parallax."""

    step_px: ParallaxMap
    """Correction that least squares asks for."""
    sigma_px: ParallaxMap
    correlation: GreyImage
    textured: Mask


class PixelwiseMatcher:
    """Fits of two locally normalised images under a parallax map."""

    def __init__(
        self, left: NormalisedImage, right: NormalisedImage, params: RefinementParams
    ) -> None:
        self.left = left.grey
        self.noise = left.noise
        self.slope = row_slope(row_coefficients(left.grey))
        self.right_coefficients = row_coefficients(right.grey)
        self.params = params
        grid = np.indices(left.grey.shape, dtype=np.float32)
        self.lines, self.samples = grid[0], grid[1]

    def refine(self, rough: ParallaxMap) -> tuple[ParallaxMap, ParallaxMap]:
        """Refined parallax where it can be trusted, and its standard deviation."""
        parallax = self.smoothed(rough)
        for _ in range(self.params.steps - 1):
            parallax = self.smoothed(parallax + self.fit(parallax).step_px)
        fit = self.fit(parallax)
        parallax = parallax + fit.step_px
        good = (fit.sigma_px <= self.params.largest_sigma_px) & fit.textured & (parallax > 0)
        good &= fit.correlation >= self.params.least_correlation
        good &= np.abs(parallax - rough) <= self.params.furthest_px
        nothing = np.float32(np.nan)
        return np.where(good, parallax, nothing), np.where(good, fit.sigma_px, nothing)

    def smoothed(self, parallax: ParallaxMap) -> ParallaxMap:
        """Parallax smoothed within surfaces: a bilateral filter to which gaps are far away."""
        known = np.isfinite(parallax)
        filled = np.where(known, parallax, np.float32(-1e4))
        out = cv2.bilateralFilter(filled, -1, self.params.edge_px, self.params.smoothing_px)
        return np.where(known, out, np.float32(np.nan))

    def fit(self, parallax: ParallaxMap) -> Fit:
        """How well the images agree under a parallax, and what would improve it."""
        known = np.isfinite(parallax)
        sample = self.samples - np.where(known, parallax, np.float32(0))
        right = along_rows(self.right_coefficients, sample, self.lines)
        r = np.where(known, right - self.left, np.float32(0))
        g = np.where(known, self.slope, np.float32(0))
        n = np.maximum(self._summed(known.astype(np.float32)), np.float32(1e-3))
        sum_g, sum_r, gg, rr = self._summed(g), self._summed(r), g * g, r * r
        energy = np.maximum(self._summed(gg) - sum_g * sum_g / n, np.float32(1e-6))
        variance = np.maximum(self._summed(rr) - sum_r * sum_r / n, 0) / n
        l = np.where(known, self.left, np.float32(0))
        sum_l = self._summed(l)
        contrast = np.maximum(self._summed(l * l) - sum_l * sum_l / n, 0) / n
        return Fit(
            step_px=np.clip((self._summed(g * r) - sum_g * sum_r / n) / energy, -1, 1),
            sigma_px=np.sqrt(variance / energy),
            correlation=1 - variance / np.maximum(2 * contrast, np.float32(1e-6)),
            textured=self._has_texture(gg, rr),
        )

    def _has_texture(self, gg: GreyImage, rr: GreyImage) -> Mask:
        window = (self.params.texture_px, self.params.texture_px)
        noise = np.minimum(cv2.blur(rr, window) / 2, self.noise * self.noise)
        return cv2.blur(gg, window) > np.float32(self.params.texture * SLOPE_NOISE) * noise

    def _summed(self, values: GreyImage) -> GreyImage:
        box = (self.params.box_px, self.params.box_px)
        once = cv2.blur(values, box, borderType=cv2.BORDER_CONSTANT)
        return cv2.blur(once, box, borderType=cv2.BORDER_CONSTANT) * np.float32(box[0] * box[1])
