"""Grey values between pixels along a row: the cubic B-spline through the samples of each row.

With the coefficients c of a row, c * (1, 4, 1)/6 = I, the value at x = i + f is a weighted mean of
c[i-1] .. c[i+2]. Each two of them are fetched by one linear interpolation (Sigg & Hadwiger 2005),

    I(x) = g0 c(i - 1 + w1/g0) + g1 c(i + 1 + w3/g1),     g0 = w0 + w1,  g1 = w2 + w3,

which is as exact as the sum of four. At a pixel the slope of the spline is (c[i+1] - c[i-1]) / 2.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from photogrammetry.arrays import Float32, GreyImage

SampleGrid = Float32[np.ndarray, "rows cols"]


def row_coefficients(image: GreyImage) -> GreyImage:
    """Spline coefficients of every row."""
    return ndimage.spline_filter1d(image, 3, axis=1, output=np.float32, mode="mirror")


def row_slope(coefficients: GreyImage) -> GreyImage:
    """Derivative of the grey values along the row, at the pixels."""
    return cv2.filter2D(coefficients, -1, np.array([[-0.5, 0.0, 0.5]], np.float32))


def along_rows(coefficients: GreyImage, x: SampleGrid, y: SampleGrid) -> SampleGrid:
    """Grey values at (x, y), where y holds whole rows."""
    i = np.floor(x)
    f = x - i
    w0 = (1 - f) ** 3 / 6
    w1 = (4 - 6 * f**2 + 3 * f**3) / 6
    w3 = f**3 / 6
    g0 = w0 + w1
    g1 = 1 - g0
    first = cv2.remap(
        coefficients, i - 1 + w1 / g0, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
    )
    second = cv2.remap(
        coefficients, i + 1 + w3 / g1, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
    )
    return g0 * first + g1 * second
