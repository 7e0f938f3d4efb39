"""Preview images of terrain products: red, green, blue and opacity."""

from __future__ import annotations

import cv2
import numpy as np

from solmap.photogrammetry.arrays import EightBits, Raster
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.relief.slope import HillshadeParams, hillshade

CLASS_COLOURS = {
    GroundClass.UNSEEN: (0, 0, 0, 0),
    GroundClass.MEASURED: (68, 119, 170, 255),
    GroundClass.INTERPOLATED: (238, 204, 102, 255),
    GroundClass.OCCLUDED: (102, 17, 0, 255),
}
"""Blue, yellow and dark red: distinguishable by everyone."""
DARKEST = 0.35
"""Fraction of its colour that ground in shade keeps."""


def relief_figure(dtm: Dtm, shading: HillshadeParams, max_side: int = 1024) -> EightBits:
    """Elevation in colour, lit by a sun; transparent where unknown."""
    small = slice(None, None, step_for(dtm.elevation.shape, max_side))
    elevation, light = (
        dtm.elevation[small, small],
        hillshade(dtm.elevation, dtm.grid.cell_m, shading)[small, small],
    )
    known = np.isfinite(elevation)
    low, high = np.percentile(elevation[known], (2, 98)) if known.any() else (0.0, 1.0)
    grey = _stretch(elevation, float(low), float(high))
    colour = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)[..., ::-1]
    shade = DARKEST + (1 - DARKEST) * np.where(np.isfinite(light), light, np.sin(np.pi / 4))
    rgb = np.clip(colour * shade[..., None], 0, 255).astype(np.uint8)
    return np.dstack([rgb, _opacity(known)])


def class_figure(dtm: Dtm, max_side: int = 1024) -> EightBits:
    """The classes of cells (origin of their elevation), in colours."""
    small = slice(None, None, step_for(dtm.ground.shape, max_side))
    table = np.zeros((256, 4), dtype=np.uint8)
    for ground, colour in CLASS_COLOURS.items():
        table[ground] = colour
    return table[dtm.ground[small, small]]


def step_for(shape: tuple[int, ...], max_side: int) -> int:
    """Step in cells such that no side of a preview is longer than `max_side`."""
    return max(1, -(-max(shape) // max_side))


def _stretch(values: Raster, low: float, high: float) -> EightBits:
    """Values between black and white as eight bits; 0 where unknown."""
    share = (values - low) / max(high - low, 1e-9)
    return np.clip(np.nan_to_num(share) * 255, 0, 255).astype(np.uint8)


def _opacity(known: np.ndarray) -> EightBits:
    return np.where(known, 255, 0).astype(np.uint8)
