"""Interest points: the Förstner operator (Förstner & Gülch 1987).

With the gradient (g_x, g_y) summed over a window with Gaussian weights, the normal matrix of
locating the window by least squares is N = sum [[g_x g_x, g_x g_y], [g_x g_y, g_y g_y]], and

    w = det N / tr N          (large: the error ellipse is small)
    q = 4 det N / (tr N)^2    (near 1: the ellipse is round, the window is not an edge)

A point is a local maximum of w with w above a fraction of its mean and q above a limit. Its
sub-pixel position is the intersection of all gradient lines of the window, N x = sum (g g') x_i.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import GreyImage, ImagePoints, Int32, Mask, PerPoint
from solmap.photogrammetry.matching.kernels import foerstner
from solmap.photogrammetry.ranges import Count, FactorOrZero, OddPixels, Share, WholePixels

WINDOW_SIGMAS = 4.0
"""Width of the window in standard deviations of its weights: at its edge they are 0.14."""


SEPARATION_PX = 3
"""Radius within which only the strongest point is kept: about half the window."""


@dataclass(frozen=True, slots=True)
class FoerstnerParams:
    """How interest points are chosen; defaults by Förstner & Gülch 1987 and Di et al. 2008."""

    window_px: OddPixels = 7
    """Window over which gradients are summed; odd. 5 to 7 in the original."""
    smallest_roundness: Share = 0.5
    """Limit of q: 0.5 to 0.75 in the original."""
    smallest_weight: FactorOrZero = 0.5
    """Limit of w as a fraction of its mean over the image: 0.5 to 1.5 in the original."""
    count: Count = 5000
    """Points per image (Di et al. 2008, section 5)."""
    cell_px: WholePixels = 64
    """Cell of which the strongest points are taken in turn, so that points are spread over the
    image."""


@dataclass(frozen=True, slots=True, eq=False)
class InterestPoints:
    """Interest points, strongest first within the count."""

    pixels: Int32[np.ndarray, "n 2"]
    """(sample, line) of the maximum."""
    weight: PerPoint

    def __len__(self) -> int:
        return len(self.pixels)


def interest_points(
    image: GreyImage, mask: Mask, params: FoerstnerParams, margin_px: int = 0
) -> InterestPoints:
    """Interest points whose surroundings of `margin_px` are usable."""
    gx, gy = _gradient(image)
    xx, xy, yy = (_window_sum(a * b, params.window_px) for a, b in ((gx, gx), (gx, gy), (gy, gy)))
    w, q = foerstner(xx, xy, yy)
    usable = _usable_with_margin(mask, max(margin_px, params.window_px // 2 + 1))
    if not usable.any():
        return InterestPoints(np.empty((0, 2), np.int32), np.empty(0))
    around = np.ones((2 * SEPARATION_PX + 1,) * 2, np.uint8)
    peak = usable & (w >= cv2.dilate(np.where(usable, w, 0), around)) & (w > 0)
    peak &= (w > params.smallest_weight * float(w[usable].mean())) & (q > params.smallest_roundness)
    line, sample = np.nonzero(peak)
    kept = strongest_by_cell(
        np.column_stack([sample, line]).astype(float), w[line, sample], params.cell_px, params.count
    )
    pixels = np.column_stack([sample, line]).astype(np.int32)[kept]
    return InterestPoints(pixels, w[pixels[:, 1], pixels[:, 0]].astype(np.float64))


def strongest_by_cell(
    points: ImagePoints, strength: np.ndarray, cell_px: int, count: int
) -> np.ndarray:
    """Indices of at most `count` points: the strongest of each cell, then the second, and so on."""
    cell = np.floor(points / cell_px).astype(np.int64)
    key = cell[:, 1] * (cell[:, 0].max(initial=0) + 1) + cell[:, 0]
    order = np.lexsort((-strength, key))
    starts = np.r_[True, key[order][1:] != key[order][:-1]] if len(order) else np.empty(0, bool)
    rank = np.arange(len(order)) - np.maximum.accumulate(np.where(starts, np.arange(len(order)), 0))
    by_rank = np.lexsort((-strength[order], rank))
    return order[by_rank[:count]]


def _window_sum(product: GreyImage, window_px: int) -> GreyImage:
    return cv2.GaussianBlur(product, (window_px, window_px), window_px / WINDOW_SIGMAS)


def _usable_with_margin(mask: Mask, margin_px: int) -> Mask:
    """Where a square of `margin_px` around a pixel is usable and inside the image."""
    kernel = np.ones((2 * margin_px + 1,) * 2, np.uint8)
    eroded = cv2.erode(mask.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return eroded > 0


def subpixel_places(
    image: GreyImage, pixels: Int32[np.ndarray, "n 2"], params: FoerstnerParams
) -> ImagePoints:
    """Where the gradient lines of the windows about pixels meet; the pixel if that is outside."""
    half = params.window_px // 2
    dy, dx = (w.ravel() for w in np.mgrid[-half : half + 1, -half : half + 1])
    at = (pixels[:, 1, None] + dy, pixels[:, 0, None] + dx)
    x, y = (gradient[at].astype(np.float64) for gradient in _gradient(image))
    weight = np.exp(-0.5 * (dx**2 + dy**2) / (params.window_px / WINDOW_SIGMAS) ** 2)
    normal = np.einsum("nik,k,njk->nij", np.stack([x, y], 1), weight, np.stack([x, y], 1))
    across = weight * (x * dx + y * dy)
    right = np.stack([(x * across).sum(axis=1), (y * across).sum(axis=1)], axis=1)
    shift = np.linalg.solve(normal, right[:, :, None])[:, :, 0] if len(pixels) else right
    return pixels + np.where(np.abs(shift).max(axis=1, keepdims=True) <= half, shift, 0.0)


def _gradient(image: GreyImage) -> tuple[GreyImage, GreyImage]:
    """Slopes along the row and down the column."""
    return (
        cv2.Scharr(image, cv2.CV_32F, 1, 0, scale=1 / 32),
        cv2.Scharr(image, cv2.CV_32F, 0, 1, scale=1 / 32),
    )
