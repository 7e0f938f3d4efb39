"""Grey values of any range converted to an image of eight bits."""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import EightBits, Float, GreyImage, Mask

BLACK_AND_WHITE_PERCENT = (0.5, 99.5)
"""Percentiles of the brightness of maps, panoramas and models that are shown as black and white."""

SAMPLE = 50_000
"""Least number of pixels, evenly spread, that determine the percentiles of an image."""


def stretch(
    image: GreyImage, mask: Mask, low_percent: float = 1.0, high_percent: float = 99.0
) -> EightBits:
    """The image between two percentiles of its usable pixels; of all where none is usable.

    Outliers (specular pixels, dust) beyond the percentiles do not darken the rest.
    """
    usable = image[mask] if mask.any() else image.ravel()
    some = usable[:: max(1, usable.size // SAMPLE)]
    low, high = np.percentile(some, [low_percent, high_percent]).tolist()
    scaled = (image - low) * (255.0 / max(high - low, 1e-6))
    return np.clip(scaled, 0, 255, out=scaled).astype(np.uint8)


def black_and_white(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Values shown as black and as white: two percentiles, never equal; (0, 1) without values."""
    low, high = np.percentile(values, BLACK_AND_WHITE_PERCENT) if len(values) else (0.0, 1.0)
    return float(low), float(max(high, low + 1e-6))
