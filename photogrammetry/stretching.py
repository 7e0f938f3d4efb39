"""Grey values of any range converted to an image of eight bits."""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import EightBits, Float, GreyImage, Mask

BLACK_AND_WHITE_PERCENT = (0.5, 99.5)
"""Percentiles of the brightness of maps, panoramas and models that are shown as black and white."""


def stretch(
    image: GreyImage, mask: Mask, low_percent: float = 1.0, high_percent: float = 99.0
) -> EightBits:
    """The image between two percentiles of its usable pixels; of all where none is usable.

    Outliers (specular pixels, dust) beyond the percentiles do not darken the rest.
    """
    usable = image[mask] if mask.any() else image.ravel()
    low, high = np.percentile(usable, [low_percent, high_percent])
    scaled = (image - low) * (255.0 / max(high - low, 1e-6))
    return np.clip(scaled, 0, 255).astype(np.uint8)


def black_and_white(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Values shown as black and as white: two percentiles, never equal; (0, 1) without values."""
    low, high = np.percentile(values, BLACK_AND_WHITE_PERCENT) if len(values) else (0.0, 1.0)
    return float(low), float(max(high, low + 1e-6))
