"""The gradient of the plane through a cell and its eight neighbours, fast.

Where all nine are known the plane of least squares (`terrain.planes`) is a sum of neighbours,

    g_e = (sum of the three to the east - sum of the three to the west) / 6 cells
    g_n = (sum of the three to the north - sum of the three to the south) / 6 cells

which takes a hundredth of the time. Only where some of the nine are missing a plane is fitted, with
the same normal equations and the same demands on the cells as there.
"""

from __future__ import annotations

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Bool, Float32, Raster
from solmap.photogrammetry.terrain.planes import LEAST_SPREAD, Gradients

_STEP = np.array([-1.0, 0.0, 1.0], np.float32)
_ONES = np.ones(3, np.float32)
_AROUND = np.array([(n, e) for n in (1, 0, -1) for e in (-1, 0, 1)], np.float32)
"""Steps to the north and to the east of the nine cells, row by row."""
_MIN_SHARE = 0.5
_FULL_SPREAD = 6.0
"""Second moment of nine cells in either direction."""


def nine_cell_gradients(elevation: Raster, cell_m: float) -> Gradients:
    """Rise per metre towards east and north; NaN where unknown and in the outermost cells."""
    known = np.isfinite(elevation)
    found = np.full((2, *elevation.shape), np.nan, np.float32)
    if not known.any():
        return found
    heights = elevation - elevation[known][0]  # single precision is finest near 0
    all_nine = cv2.erode(known.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    for axis, (across, down) in zip(found, ((_STEP, _ONES), (_ONES, -_STEP)), strict=True):
        sums = cv2.sepFilter2D(heights, cv2.CV_32F, across, down)
        np.divide(sums, np.float32(6 * cell_m), out=axis, where=all_nine)
    row, col = np.nonzero((known & ~all_nine)[1:-1, 1:-1])
    if len(row):
        found[:, row + 1, col + 1] = _fitted(_nine(heights, row, col)) / np.float32(cell_m)
    found[:, [0, -1], :] = found[:, :, [0, -1]] = np.nan
    return found


def _nine(heights: Raster, row: np.ndarray, col: np.ndarray) -> Float32[np.ndarray, "9 n"]:
    """The nine cells from (row, col) on, over the one in the middle."""
    down, right = np.divmod(np.arange(9), 3)
    nine = heights[row + down[:, None], col + right[:, None]]
    return nine - nine[4]


def _fitted(nine: Float32[np.ndarray, "9 n"]) -> Float32[np.ndarray, "2 n"]:
    """Rise a cell of the planes through what is known; NaN where that holds none."""
    known: Bool[np.ndarray, "9 n"] = np.isfinite(nine)
    m, h = known.astype(np.float32), np.where(known, nine, np.float32(0))
    n, e = _AROUND[:, :1], _AROUND[:, 1:]
    S_1, S_e, S_n, S_h = (sums.sum(axis=0) for sums in (m, m * e, m * n, m * h))
    C_ee = (m * e * e).sum(axis=0) - S_e**2 / S_1
    C_en = (m * e * n).sum(axis=0) - S_e * S_n / S_1
    C_nn = (m * n * n).sum(axis=0) - S_n**2 / S_1
    C_eh = (m * e * h).sum(axis=0) - S_e * S_h / S_1
    C_nh = (m * n * h).sum(axis=0) - S_n * S_h / S_1
    thinnest = (C_ee + C_nn) / 2 - np.sqrt((C_ee - C_nn) ** 2 / 4 + C_en**2)
    fits = (_MIN_SHARE * len(m) <= S_1) & (thinnest > LEAST_SPREAD * _FULL_SPREAD)
    with np.errstate(invalid="ignore", divide="ignore"):
        gradient = np.stack([C_nn * C_eh - C_en * C_nh, C_ee * C_nh - C_en * C_eh])
        gradient /= C_ee * C_nn - C_en**2
    return np.where(fits, gradient, np.float32(np.nan)).astype(np.float32)
