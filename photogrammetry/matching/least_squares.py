"""Least-squares matching of a left window in the right image, along the epipolar line.

The window of the left image around a pixel (x0, y0) is related to the right image by five
parameters: a parallax p that varies linearly over the window, as on a plane, and a change of
brightness and contrast,

    L(x0 + dx, y0 + dy) + v = k0 + k1 R(x0 + dx - p - a dx - b dy, y0 + dy)

(Ackermann 1984; Grün 1985, with the shift across the line taken out: rows correspond exactly). The
normal matrix is built from the slopes of the left window, which do not change from one step to
the next (Baker & Matthews 2004), and its inverse times the residual variance is the covariance,

    sigma_p^2 = s0^2 (N^-1)_pp,      s0^2 = v'v / (n - 5).

Neighbouring residuals are correlated, because resampling spreads the noise of a pixel over its
neighbours; `CORRELATION` widens sigma by that. It is the sigma of the plane in the window: that of
the ground at its middle is wider by relief (`relief`).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Flags, GreyImage, Int32, PerPoint
from solmap.photogrammetry.matching.sampling import along_rows, row_coefficients, row_slope

PARAMETERS = 5

CHUNK = 2048
"""Windows at a time: bounds memory, and OpenCV samples no more than 32767 rows at once."""

CORRELATION = 1.2
"""Ratio of the true to the formal sigma: cubic splines at random sub-pixel places pass noise of
neighbours on with a correlation of about 0.2, each residual having two such neighbours in its row
and two in its column."""


@dataclass(frozen=True, slots=True)
class LeastSquaresParams:
    """How windows are refined."""

    window_px: int = 15
    """Side of the square window, odd: the one of the correlation (Di et al. 2008, section 5)."""
    steps: int = 8
    """Most Gauss-Newton steps; three to five are usual."""
    settled_px: float = 0.005
    """A step below this ends the iteration: a tenth of the precision that can be had."""
    furthest_px: float = 1.5
    """A point that moves further has left the maximum it started from."""


@dataclass(frozen=True, slots=True, eq=False)
class RefinedParallax:
    """Result of least-squares matching, one row a point."""

    parallax_px: PerPoint
    sigma_px: PerPoint
    correlation: PerPoint
    """Normalised cross-correlation of the left window and the fitted right one."""
    slope: np.ndarray
    """(n, 2): change of parallax per pixel along samples and along lines."""
    settled: Flags


class LeastSquaresMatcher:
    """Refines parallaxes between two images; keeps what does not depend on the points."""

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
        """Take the window of other parameters."""
        self.params = params
        half = params.window_px // 2
        dy, dx = np.mgrid[-half : half + 1, -half : half + 1]
        self.dx, self.dy = dx.ravel().astype(np.int32), dy.ravel().astype(np.int32)

    def refine(self, pixels: Int32[np.ndarray, "n 2"], parallax_px: PerPoint) -> RefinedParallax:
        """Parallax of left pixels, whose windows lie inside the image, from approximate values."""
        if not len(pixels):
            nothing = np.empty(0)
            return RefinedParallax(nothing, nothing, nothing, np.empty((0, 2)), nothing > 0)
        parts = [
            self._refine_chunk(pixels[i : i + CHUNK], parallax_px[i : i + CHUNK])
            for i in range(0, len(pixels), CHUNK)
        ]
        return RefinedParallax(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def _refine_chunk(
        self, pixels: np.ndarray, start_px: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        x, y = pixels[:, 0, None] + self.dx, pixels[:, 1, None] + self.dy
        left = _centred(self.left[y, x])
        design = self._design(self.left_slope[y, x])
        inverse = np.linalg.inv(np.einsum("nki,nkj->nij", design, design) + _tiny(design))
        geometry = np.zeros((len(pixels), 3))  # parallax, its slope along samples and along lines
        geometry[:, 0] = start_px
        fitted = np.zeros_like(left)
        settled = np.zeros(len(pixels), dtype=bool)
        moving = np.ones(len(pixels), dtype=bool)
        for _ in range(self.params.steps):
            fitted[moving] = self._right_windows(
                x[moving], y[moving], geometry[moving], left[moving]
            )
            residual = left[moving] - fitted[moving]
            step = np.einsum(
                "nij,nkj,nk->ni", inverse[moving][:, :3], design[moving], residual, optimize=True
            )
            geometry[moving] += step
            far = np.abs(geometry[:, 0] - start_px) > self.params.furthest_px
            settled[moving] = np.abs(step[:, 0]) < self.params.settled_px
            moving &= ~settled & ~far
            if not moving.any():
                break
        else:
            far = np.abs(geometry[:, 0] - start_px) > self.params.furthest_px
        variance = ((left - fitted) ** 2).sum(axis=1) / (left.shape[1] - PARAMETERS)
        sigma = CORRELATION * np.sqrt(variance * inverse[:, 0, 0])
        energy = np.sqrt((left**2).sum(axis=1) * (fitted**2).sum(axis=1))
        correlation = (left * fitted).sum(axis=1) / np.maximum(energy, 1e-12)
        return geometry[:, 0], sigma, correlation, geometry[:, 1:], settled & ~far

    def _design(self, slope: np.ndarray) -> np.ndarray:
        """Derivatives of the residual by (p, a, b); the mean is taken out of each column.

        Moving the right window by dp changes the prediction by -R_x dp, and R_x is taken from the
        left window. Taking out the mean stands for the brightness k0.
        """
        columns = -np.stack([slope, slope * self.dx, slope * self.dy], axis=2).astype(np.float64)
        return columns - columns.mean(axis=1, keepdims=True)

    def _right_windows(
        self, x: np.ndarray, y: np.ndarray, geometry: np.ndarray, left: np.ndarray
    ) -> np.ndarray:
        """Right windows at the present parallax, brightness and contrast fitted to the left."""
        p, a, b = geometry.T[:, :, None]
        sample = (x - p - a * self.dx - b * self.dy).astype(np.float32)
        right = _centred(along_rows(self.right_coefficients, sample, y.astype(np.float32)))
        energy = np.maximum((right**2).sum(axis=1, keepdims=True), 1e-12)
        return right * ((left * right).sum(axis=1, keepdims=True) / energy)


def _centred(windows: np.ndarray) -> np.ndarray:
    windows = windows.astype(np.float64)
    return windows - windows.mean(axis=1, keepdims=True)


def _tiny(design: np.ndarray) -> np.ndarray:
    """Enough on the diagonal that a window without texture has an inverse, and a huge sigma."""
    scale = 1e-9 * np.einsum("nki,nki->n", design, design)[:, None, None] + 1e-12
    return scale * np.eye(design.shape[2])
