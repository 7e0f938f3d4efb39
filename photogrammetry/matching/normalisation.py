"""Local normalisation of grey values, for matchers that need eight bits or equal brightness.

Each pixel is given as its distance from the mean of its surroundings in units of their standard
deviation, (I - m) / sqrt(s^2 + (k n)^2), with the noise n of the image in the denominator, so that
faint texture of a 12-bit image fills the eight bits and mere noise, as in the sky, does not.
The noise is estimated from second differences (Immerkær 1996), by their median absolute value, so
that edges do not count.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import GreyImage, Mask, Picture

CONTRAST = 40.0
"""Grey levels of eight bits per local standard deviation: three to either side fit."""

NOISE_FLOOR = 2.0
"""Standard deviations of noise that count as no contrast."""


def noise_level(image: GreyImage, mask: Mask) -> float:
    """Standard deviation of the noise of a grey value, where texture does not hide it.

    The calmest twentieth of all blocks is taken: ground is textured nearly everywhere. Where even
    these are textured the noise comes out too large.
    """
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
    rough = np.abs(cv2.filter2D(image, -1, kernel))
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    if not inner.any():
        return 0.0
    share = np.where(inner, rough, np.float32(0))
    blocks = cv2.blur(share, (17, 17)) / np.maximum(
        cv2.blur(inner.astype(np.float32), (17, 17)), 1e-6
    )
    return float(np.sqrt(np.pi / 2) * np.percentile(blocks[inner][::7], 5))


@dataclass(frozen=True, slots=True, eq=False)
class NormalisedImage:
    """Grey values in units of their local contrast; 0 where not usable."""

    grey: GreyImage
    mask: Mask
    noise: GreyImage
    """Standard deviation of the noise, in the same units."""


def locally_normalised(image: GreyImage, mask: Mask, window_px: int) -> NormalisedImage:
    """Distance of each pixel from its local mean, in local standard deviations."""
    size = (window_px, window_px)
    noise = noise_level(image, mask)
    share = np.maximum(cv2.blur(mask.astype(np.float32), size), np.float32(1e-6))
    centre = float(image[mask].mean()) if mask.any() else 0.0
    grey = np.where(mask, image - np.float32(centre), np.float32(0))
    mean = cv2.blur(grey, size) / share
    variance = np.maximum(cv2.blur(grey * grey, size) / share - mean * mean, 0)
    spread = np.sqrt(variance + np.float32((NOISE_FLOOR * noise) ** 2 + 1e-12))
    normalised = np.where(mask, (grey - mean) / spread, np.float32(0))
    return NormalisedImage(normalised, mask, np.float32(noise) / spread)


def eight_bit(normalised: GreyImage) -> Picture:
    """Normalised grey values about 128."""
    return cv2.convertScaleAbs(np.clip(normalised * CONTRAST + 128, 0, 255))
