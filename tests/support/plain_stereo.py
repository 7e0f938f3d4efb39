"""OpenCV's StereoSGBM as its documentation sets it up, to compare dense parallax with."""

import cv2
import numpy as np

from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.stereo.sparse import largest_parallax_px
from solmap.photogrammetry.stretching import stretch


def plain_opencv(images: EpipolarImages, nearest_m: float = 1.2, uniqueness: int = 5) -> np.ndarray:
    """Parallax of the left image, over the range that the nearest ground needs; NaN: none."""
    count = 16 * int(np.ceil((largest_parallax_px(images.geometry, nearest_m) + 2) / 16))
    left, right = (
        cv2.copyMakeBorder(stretch(image, mask), 0, 0, count, 0, cv2.BORDER_REPLICATE)
        for image, mask in ((images.left, images.left_mask), (images.right, images.right_mask))
    )
    matcher = cv2.StereoSGBM.create(
        0, count, 5, 200, 800, 1, uniquenessRatio=uniqueness, speckleWindowSize=100, speckleRange=2
    )
    found = matcher.compute(left, right)[:, count:]
    return np.where(found > 0, found / np.float32(16), np.float32(np.nan))


def wrong_and_filled(
    parallax: np.ndarray, truth: np.ndarray, visible: np.ndarray, limit_px: float = 1.0
) -> tuple[float, float]:
    """Share of the parallaxes that is wrong by more than a limit, and share of what both see."""
    known = visible & np.isfinite(parallax)
    wrong = np.abs(parallax - truth)[known] > limit_px
    return float(wrong.mean()), float(known.sum() / visible.sum())


def plainly_wrong_at(
    fill: float,
    images: EpipolarImages,
    truth: np.ndarray,
    visible: np.ndarray,
    nearest_m: float,
    limit_px: float = 1.0,
) -> float:
    """Share of StereoSGBM that is wrong when its best cost must win by so much that it fills that.

    Raises:
        ValueError: it fills less or more at any uniqueness.
    """
    found = [
        wrong_and_filled(plain_opencv(images, nearest_m, uniqueness), truth, visible, limit_px)
        for uniqueness in range(0, 80, 10)
    ]
    wrong, filled = np.array(sorted(found, key=lambda one: one[1])).T
    if not filled[0] <= fill <= filled[-1]:
        raise ValueError(f"StereoSGBM fills {filled[0]:.2f} to {filled[-1]:.2f}, not {fill:.2f}")
    return float(np.interp(fill, filled, wrong))
