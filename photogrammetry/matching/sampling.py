"""Grey values between pixels: the cubic B-spline through all samples.

With the coefficients c of a row, c * (1, 4, 1)/6 = I, the value at x = i + f is a weighted mean of
c[i-1] .. c[i+2]. Each two of them are fetched by one linear interpolation (Sigg & Hadwiger 2005),

    I(x) = g0 c(i - 1 + w1/g0) + g1 c(i + 1 + w3/g1),     g0 = w0 + w1,  g1 = w2 + w3,

which is as exact as the sum of four; in two directions four fetches stand for sixteen. At a pixel
the slope of the spline is (c[i+1] - c[i-1]) / 2.

The coefficients come from the inverse of (1, 4, 1)/6, sqrt(3) z^|k| with z = sqrt(3) - 2 (Unser
1999), which is cut off where single precision no longer sees it.
"""

from __future__ import annotations

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, GreyImage

SampleGrid = Float32[np.ndarray, "rows cols"]
REACH = 14
"""Pixels after which z^|k| is below 1e-8."""
_INVERSE = (np.sqrt(3) * (np.sqrt(3) - 2) ** np.abs(np.arange(-REACH, REACH + 1))).astype(
    np.float32
)
STRIP = 32
"""Rows sampled at a time: what is needed of them stays in the processor's cache."""


def coefficients_of(image: GreyImage) -> GreyImage:
    """Spline coefficients of an image, in both directions; mirrored at its borders."""
    return cv2.sepFilter2D(image, cv2.CV_32F, _INVERSE, _INVERSE, borderType=cv2.BORDER_REFLECT_101)


def row_coefficients(image: GreyImage) -> GreyImage:
    """Spline coefficients of every row."""
    return cv2.sepFilter2D(
        image, cv2.CV_32F, _INVERSE, np.ones(1, np.float32), borderType=cv2.BORDER_REFLECT_101
    )


def row_slope(coefficients: GreyImage) -> GreyImage:
    """Derivative of the grey values along the row, at the pixels."""
    return cv2.filter2D(coefficients, -1, np.array([[-0.5, 0.0, 0.5]], np.float32))


def along_rows(coefficients: GreyImage, x: SampleGrid, y: SampleGrid) -> SampleGrid:
    """Grey values at (x, y), where y holds whole rows."""
    g, first, second = _fetches(x)
    return _mixed(g, _fetched(coefficients, first, y), _fetched(coefficients, second, y))


def at_points(coefficients: GreyImage, x: SampleGrid, y: SampleGrid) -> SampleGrid:
    """Grey values at (x, y)."""
    values = np.empty_like(x)
    for row in range(0, len(x), STRIP):
        part = slice(row, row + STRIP)
        g_x, left, right = _fetches(x[part])
        g_y, above, below = _fetches(y[part])
        upper = _mixed(g_x, *(_fetched(coefficients, u, above) for u in (left, right)))
        lower = _mixed(g_x, *(_fetched(coefficients, u, below) for u in (left, right)))
        values[part] = _mixed(g_y, upper, lower)
    return values


def _mixed(share: SampleGrid, first: SampleGrid, second: SampleGrid) -> SampleGrid:
    return second + share * (first - second)


def _fetches(x: SampleGrid) -> tuple[SampleGrid, SampleGrid, SampleGrid]:
    """Weight of the first of two fetches, and where both are made."""
    i = np.floor(x)
    f = x - i
    rest, square = 1 - f, f * f
    w0, w3 = rest * rest * rest / 6, square * f / 6
    g0 = w0 + np.float32(2 / 3) - square + 3 * w3
    return g0, i - w0 / g0, i + 1 + w3 / (1 - g0)


def _fetched(coefficients: GreyImage, x: SampleGrid, y: SampleGrid) -> SampleGrid:
    return cv2.remap(coefficients, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
