"""Contours drawn into a tile, at any interval.

Elevations are smoothed as for the contours that are made once (`terrain.contours`). With the
elevation h of a pixel and the gradient |h'| a pixel, its distance from the nearest contour is

    d = |h - i rint(h / i)| / |h'|        i the interval

pixels, to first order, and a line w pixels wide covers max(0, min(1, w / 2 + 1/2 - d)) of it.
Every fifth contour is drawn wider, as on printed maps. Lines are left out where they would touch:
with less than three pixels between contours.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from solmap.gis_server.rendering.looks import Look
from solmap.gis_server.rendering.patches import Patch
from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.terrain.relief.contours import (
    ContourParams,
    interval_by_relief,
    smoothed,
)
from solmap.products.model import Layer

_PARAMS = ContourParams()
_LINE_PX, _INDEX_PX = 1.0, 2.0
_LEVEL = 1e-6
"""Rise a pixel, in intervals, below which ground is level and has no contour."""
_CROWDED = 1 / 3
"""Rise a pixel, in intervals, above which contours would touch."""


def smoothing_m(cell_m: float) -> float:
    """Standard deviation of the Gaussian: that of contours, or one pixel where that is more."""
    return max(_PARAMS.smoothing_m, cell_m)


def contour_margin(cell_m: float) -> int:
    """Cells around a tile that its contours depend on."""
    return math.ceil(4.0 * smoothing_m(cell_m) / cell_m) + 1


def interval_of(layer: Layer, look: Look) -> float:
    """The interval asked for, or one that suits the layer's relief."""
    if look.interval_m is not None:
        return look.interval_m
    low, high = layer.range or (0.0, 1.0)
    return interval_by_relief(np.array([low, high]), _PARAMS.contours_wanted)


def contour_cover(patch: Patch, interval_m: float) -> np.ndarray:
    """How much of every pixel lines cover, 0 to 255."""
    sigma_m = smoothing_m(patch.cell_m)
    smooth = smoothed(patch.values, patch.cell_m, sigma_m, _PARAMS.min_share)
    return _cover(patch.interpolated(smooth) / np.float32(interval_m))


def _cover(height: Raster) -> np.ndarray:
    """Cover by lines of whole heights, of all pixels but the outer ones, which are dropped."""
    east = (height[1:-1, 2:] - height[1:-1, :-2]) / 2
    south = (height[2:, 1:-1] - height[:-2, 1:-1]) / 2
    own = height[1:-1, 1:-1]
    rise = np.hypot(east, south)
    number = np.rint(own)
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.abs(own - number) / rise
        fifths = number / _PARAMS.index_every
        is_index = fifths == np.rint(fifths)
        width = np.where(is_index, np.float32(_INDEX_PX), np.float32(_LINE_PX))
        cover = np.clip(width / 2 + np.float32(0.5) - distance, 0.0, 1.0)
        spaced = np.where(is_index, rise / _PARAMS.index_every, rise) < _CROWDED
    drawn = (rise > _LEVEL) & spaced
    return cv2.convertScaleAbs(np.where(drawn, cover, np.float32(0)), alpha=255.0)
