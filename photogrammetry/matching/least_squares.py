"""Least-squares matching of windows: along the epipolar line, by a shift, and by an affine map.

**Along the epipolar line** (`LeastSquaresMatcher`). The window of the left image around a pixel
(x0, y0) is related to the right image by five parameters: a parallax p that varies linearly over
the window, as on a plane, and a change of brightness and contrast,

    L(x0 + dx, y0 + dy) + v = k0 + k1 R(x0 + dx - p - a dx - b dy, y0 + dy)

(Ackermann 1984; Grün 1985, without the shift across the line: rows correspond exactly). The normal
matrix is built from the slopes of the left window, which do not change from one step to the next
(Baker & Matthews 2004), and its inverse times the residual variance is the covariance,

    sigma_p^2 = s0^2 (N^-1)_pp,      s0^2 = v'v / (n - 5).

Neighbouring residuals are correlated, because resampling spreads the noise of a pixel over its
neighbours; `CORRELATION` enlarges sigma accordingly. It is the sigma of the plane in the window:
that of the ground at its middle is larger because of relief (`stereo.sparse`).

**By a shift along and across** (`match_offsets`), with the slopes of the left window as well.

**By an affine map** (`fit_patches`). With grey values a of a template and b of a wider search
patch, over cells x around the middle,

    a(x) + v = r_0 + r_1 b(A x + d)                                               (Gruen 1985)

is solved for the shift d, the affine matrix A and the radiometry r_0, r_1. In each step the search
patch is resampled with the present approximation, w(x) = b(A x + d), and its remaining small motion
is estimated,

    a - r_1 w + v = r_0 + (dr_1) w + r_1 (grad w)' (e + E x),     d <- d + A e,     A <- A (I + E).

The slopes are odd differences of w about the middle, of fourth order, so that slopes of texture of
a few cells are not underestimated. They must be odd: a slope that contains the grey value it is
multiplied with, like the difference of two neighbours, biases the shift by n^2 (2 u - 1) /
(slope)^2 for the noise n at the fraction u of a cell. Started at whole cells, this shifted every
match in the same direction: by 0.05 px in rendered images of Mars, 3 cm of range at 12 m. The
standard deviation of d is sigma0 sqrt(Q_dd), with as many observations as are independent.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import (
    Flags,
    Float32,
    Float64,
    GreyImage,
    Int32,
    PerPoint,
)
from solmap.photogrammetry.matching.kernels import fit_affine, fit_offsets, fit_parallax
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.resampling import (
    row_coefficients,
    row_slope,
    spline_coefficients,
)
from solmap.photogrammetry.ranges import Few, OddPixels

OFFSET_STEPS = 6
"""Gauss-Newton steps of a shift; three to five are usual."""

CORRELATION = 1.2
"""Ratio of the true to the formal sigma: cubic splines at random sub-pixel positions correlate the
noise of neighbours by about 0.2; each residual has two such neighbours in its row and two in its
column."""

LONGEST_STRETCH = 0.2
"""Largest change of shape in one step."""

SETTLED_PX = 0.005
"""Step that ends the iteration: a tenth of the attainable precision."""


FURTHEST_PX = 1.5
"""Largest movement of a point; beyond it, it has left its initial maximum."""


@dataclass(frozen=True, slots=True)
class LeastSquaresParams:
    """How windows are refined."""

    window_px: OddPixels = 15
    """Side of the square window, odd: that of the correlation (Di et al. 2008, section 5)."""
    steps: Few = 8
    """Most Gauss-Newton steps; three to five are usual."""


@dataclass(frozen=True, slots=True, eq=False)
class RefinedParallax:
    """Result of least-squares matching, one row per point."""

    parallax_px: PerPoint
    sigma_px: PerPoint
    correlation: PerPoint
    """Normalised cross-correlation of the left window and the fitted right one."""
    slope: np.ndarray
    """(n, 2): change of parallax per pixel along samples and along lines."""
    settled: Flags


class LeastSquaresMatcher:
    """Refines parallaxes between two images; precomputes data independent of the points."""

    def __init__(self, left: GreyImage, right: GreyImage, params: LeastSquaresParams) -> None:
        self.left = left
        self.right_coefficients = row_coefficients(right)
        self.left_slope = row_slope(row_coefficients(left))
        self.use(params)

    def with_params(self, params: LeastSquaresParams) -> LeastSquaresMatcher:
        """A matcher of the same images with another window."""
        other = copy(self)
        other.use(params)
        return other

    def use(self, params: LeastSquaresParams) -> None:
        """Use the window of other parameters."""
        self.params = params

    def refine(self, pixels: Int32[np.ndarray, "n 2"], parallax_px: PerPoint) -> RefinedParallax:
        """Parallax of left pixels with windows inside the image, from approximate values."""
        limits = (self.params.window_px // 2, self.params.steps, SETTLED_PX, FURTHEST_PX)
        images = (self.left, self.left_slope, self.right_coefficients)
        found = fit_parallax(*images, np.ascontiguousarray(pixels), parallax_px, limits)
        p, a, b, variance, cofactor, correlation, settled = np.ascontiguousarray(found.T)
        sigma = CORRELATION * np.sqrt(variance * cofactor)
        return RefinedParallax(p, sigma, correlation, np.column_stack([a, b]), settled > 0)


def match_offsets(
    images: EpipolarImages, pixels: np.ndarray, start: np.ndarray, window_px: int
) -> np.ndarray:
    """Shift of each left window in the right image, along samples and lines; NaN if not found."""
    found = fit_offsets(
        images.left,
        spline_coefficients(images.right),
        np.ascontiguousarray(pixels),
        start,
        (window_px // 2, OFFSET_STEPS),
    )
    offset, step = found[:, :2], found[:, 2:]
    lost = (np.abs(offset - start) > 2).any(axis=1) | (np.abs(step) > 0.05).any(axis=1)  # noqa: PLR2004
    return np.where(lost[:, None], np.nan, offset)


@dataclass(frozen=True, slots=True, eq=False)
class PatchFits:
    """Positions of n templates in their search patches, in cells from the middle."""

    shift: Float64[np.ndarray, "n 2"]
    """Column and row."""
    sigma: PerPoint
    """Standard deviation of the shift, the mean of both axes."""
    affine: Float64[np.ndarray, "n 2 2"]
    correlation: PerPoint
    last_step: PerPoint
    """Movement in the last iteration: the larger of both axes."""


def fit_patches(
    templates: Float32[np.ndarray, "n a a"],
    searches: Float32[np.ndarray, "n b b"],
    start: Float64[np.ndarray, "n 2"],
    iterations: int,
) -> PatchFits:
    """Fit every template to its search patch, from approximate shifts."""
    found = fit_affine(templates, searches, start, (iterations, LONGEST_STRETCH))
    shift, affine = found[:, :2], found[:, 3:7].reshape(-1, 2, 2)
    return PatchFits(shift, found[:, 2], affine, found[:, 7], found[:, 8])
