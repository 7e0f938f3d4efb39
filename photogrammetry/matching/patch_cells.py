"""The cells of a patch of ground that two images are drawn on.

With the ellipses C_1 and C_2 that a pixel of either covers on the ground (`ground_patches`), C_1 =
L L' and L^-1 C_2 L^-T = V diag(l) V', cells G = L V diag(sqrt(max(1, l))) are as large as the pixel
of either in every direction.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import Float64, PerPoint

LONGEST = 4.0
"""Cells are so many times as long as wide at most: a narrower strip holds too little."""


def common_cells(
    one: Float64[np.ndarray, "n 2 2"], other: Float64[np.ndarray, "n 2 2"], square_m: float
) -> Float64[np.ndarray, "n 2 2"]:
    """G of cells as large as the pixels of two images, C_1 and C_2, in every direction.

    Cells that are no longer than `square_m` are square, longer ones narrower in turn, at least of
    that area; NaN where either C is not finite.
    """
    cells = np.full(one.shape, np.nan)
    good = np.isfinite(one).all(axis=(1, 2)) & np.isfinite(other).all(axis=(1, 2))
    root = np.linalg.cholesky(one[good])
    back = np.linalg.inv(root)
    stretch, axes = np.linalg.eigh(back @ other[good] @ np.swapaxes(back, 1, 2))
    both = root @ axes * np.sqrt(np.maximum(stretch, 1.0))[:, None, :]
    left, size, _ = np.linalg.svd(both)
    length = size[:, 0]
    size[:, 1] = np.maximum(size[:, 1], np.minimum(length, square_m**2 / length))
    size[:, 1] = np.maximum(size[:, 1], length / LONGEST)
    cells[good] = left * size[:, None, :]
    return cells


def no_finer(cells: Float64[np.ndarray, "n 2 2"], finest_m: float) -> Float64[np.ndarray, "n 2 2"]:
    """Cells whose sides are no shorter than the finest."""
    sides = np.maximum(np.linalg.norm(cells, axis=1), 1e-9)
    return cells * (np.maximum(sides, finest_m) / sides)[:, None, :]


def smallest_stretch(maps: Float64[np.ndarray, "n 2 2"]) -> PerPoint:
    """The smaller singular value of 2 x 2 matrices: |det| over the larger one."""
    power = (maps**2).sum(axis=(1, 2)) / 2
    area = np.abs(maps[:, 0, 0] * maps[:, 1, 1] - maps[:, 0, 1] * maps[:, 1, 0])
    larger = np.sqrt(power + np.sqrt(np.maximum(power**2 - area**2, 0.0)))
    return area / np.maximum(larger, 1e-12)
