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
from solmap.photogrammetry.matching.kernels import fit_offsets, fit_parallax
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

UNKNOWNS = 8
"""Shift of two, affine change of four, brightness and contrast."""

STIFFNESS = 1e-6
"""Relative addition to the diagonal, so that a patch without texture has a solution."""

LONGEST_STRETCH = 0.2
"""Largest change of shape in one step."""

RIM = 2
"""Cells around a patch needed by slopes of fourth order."""

TINY = 1e-9
"""Contrast treated as zero."""


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


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """Linear equations of n patches of m cells at one approximation, and their solution."""

    solution: Float64[np.ndarray, "n 8"]
    residual: Float64[np.ndarray, "n m"]
    variance: PerPoint
    """Cofactor of the shift, the mean of both axes."""

    @classmethod
    def of(
        cls,
        templates: Float64[np.ndarray, "n a a"],
        drawn: Float64[np.ndarray, "n b b"],
        x: Float64[np.ndarray, "m 2"],
    ) -> _Step:
        """Solve for the motion of resampled search patches; with means of zero, and a rim."""
        n, (u, v) = len(templates), x.T
        gain = templates.std(axis=(1, 2)) / np.maximum(_core(drawn).std(axis=(1, 2)), TINY)
        drawn = drawn * gain[:, None, None]
        along, down, w = (g.reshape(n, -1) for g in (*_slopes(drawn), _core(drawn)))
        columns = (along, down, along * u, along * v, down * u, down * v, w, np.ones_like(w))
        design = np.stack(columns, axis=-1)
        scale = np.maximum(np.sqrt((design**2).mean(axis=1)), TINY)
        design /= scale[:, None]
        normal = design.swapaxes(1, 2) @ design + STIFFNESS * len(x) * np.eye(UNKNOWNS)
        difference = templates.reshape(n, -1) - w
        found = np.linalg.solve(normal, design.swapaxes(1, 2) @ difference[:, :, None])
        residual = difference - (design @ found)[:, :, 0]
        cofactors = np.diagonal(np.linalg.inv(normal), axis1=1, axis2=2) / scale**2
        return cls(found[:, :, 0] / scale, residual, cofactors[:, :2].mean(axis=1))

    @property
    def moves(self) -> tuple[np.ndarray, np.ndarray]:
        """Shifts (n, 2) and affine changes (n, 2, 2), limited in length."""
        change = np.clip(self.solution[:, 2:6], -LONGEST_STRETCH, LONGEST_STRETCH)
        return np.clip(self.solution[:, :2], -1, 1), change.reshape(-1, 2, 2)

    @property
    def sigma(self) -> PerPoint:
        """Standard deviation of the shift."""
        n, m = self.residual.shape
        side = round(m**0.5)
        sigma0 = np.sqrt((self.residual**2).sum(axis=1) / (m - UNKNOWNS))
        factor = correlation_factor(self.residual.reshape(n, side, side))
        return sigma0 * np.sqrt(self.variance * factor)


def fit_patches(
    templates: Float32[np.ndarray, "n a a"],
    searches: Float32[np.ndarray, "n b b"],
    start: Float64[np.ndarray, "n 2"],
    iterations: int,
) -> PatchFits:
    """Fit every template to its search patch, from approximate shifts."""
    half = templates.shape[1] // 2
    x, wide = _cells(half), _cells(half + RIM)
    a = templates - templates.mean(axis=(1, 2), keepdims=True, dtype=np.float64)
    shift, affine = start.copy(), np.tile(np.eye(2), (len(start), 1, 1))
    for _ in range(iterations):
        step = _Step.of(a, _draw(searches, shift, affine, wide), x)
        e, E = step.moves
        moved = (affine @ e[:, :, None])[:, :, 0]
        shift, affine = shift + moved, affine @ (np.eye(2) + E)
    w = _core(_draw(searches, shift, affine, wide))
    energy = np.sqrt((a**2).sum(axis=(1, 2)) * (w**2).sum(axis=(1, 2)))
    correlation = (a * w).sum(axis=(1, 2)) / np.maximum(energy, TINY)
    return PatchFits(shift, step.sigma, affine, correlation, np.abs(moved).max(axis=1))


def _cells(half: int) -> Float64[np.ndarray, "m 2"]:
    """(column, row) of the cells of a patch, from its middle."""
    row, column = np.mgrid[-half : half + 1, -half : half + 1]
    return np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)


def _core(patches: Float64[np.ndarray, "n b b"]) -> Float64[np.ndarray, "n a a"]:
    """Patches without their rim."""
    return patches[:, RIM:-RIM, RIM:-RIM]


def _slopes(patches: Float64[np.ndarray, "n b b"]) -> tuple[np.ndarray, np.ndarray]:
    """Slopes along columns and down rows, without the rim: (8 (w+1 - w-1) - (w+2 - w-2)) / 12."""
    along, down = patches[:, RIM:-RIM], patches[:, :, RIM:-RIM]
    return (
        (8 * (along[:, :, 3:-1] - along[:, :, 1:-3]) - along[:, :, 4:] + along[:, :, :-4]) / 12,
        (8 * (down[:, 3:-1] - down[:, 1:-3]) - down[:, 4:] + down[:, :-4]) / 12,
    )


def correlation_factor(residuals: Float64[np.ndarray, "n a a"]) -> PerPoint:
    """Number of correlated neighbouring residuals that are equivalent to one.

    Smoothed and interpolated patches leave correlated residuals; for a first-order process (1 + r)
    / (1 - r) of them, along each axis, have the information of one.
    """
    power = np.maximum((residuals**2).mean(axis=(1, 2)), 1e-12)
    along = (residuals[:, :, 1:] * residuals[:, :, :-1]).mean(axis=(1, 2)) / power
    down = (residuals[:, 1:] * residuals[:, :-1]).mean(axis=(1, 2)) / power
    along, down = (np.clip(r, 0.0, 0.9) for r in (along, down))
    return (1 + along) / (1 - along) * (1 + down) / (1 - down)


def _draw(
    searches: Float32[np.ndarray, "n s s"],
    shift: Float64[np.ndarray, "n 2"],
    affine: Float64[np.ndarray, "n 2 2"],
    x: Float64[np.ndarray, "m 2"],
) -> Float64[np.ndarray, "n b b"]:
    """Search patches on the moved grid, with the mean within their rim subtracted."""
    n, size, _ = searches.shape
    at = x @ affine.swapaxes(1, 2) + (shift + (size - 1) / 2)[:, None]
    at = np.clip(at, 1.0, size - 2.001)
    corner = np.floor(at).astype(np.int64)
    u, v = np.moveaxis(at - corner, -1, 0)
    flat = searches.reshape(-1)
    base = np.arange(n)[:, None] * size * size + corner[:, :, 1] * size + corner[:, :, 0]
    b00, b01, b10, b11 = (flat[base + o].astype(np.float64) for o in (0, 1, size, size + 1))
    grey = (b00 * (1 - u) + b01 * u) * (1 - v) + (b10 * (1 - u) + b11 * u) * v
    side = round(len(x) ** 0.5)
    grey = grey.reshape(n, side, side)
    return grey - _core(grey).mean(axis=(1, 2), keepdims=True)
