"""Pieces of an orthophoto as textures of meshes, read at the size that is wanted and no larger."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from rasterio.enums import Resampling
from rasterio.windows import Window

from solmap.photogrammetry.arrays import Picture
from solmap.products.formats.raster.raster import grid_of, open_raster

_BLED_PX = 4
"""How far the edge of what was seen is carried on: the reach of filtering and of two mipmaps."""
_BLANK = 128
"""Grey of ground that no image shows."""
_TINY = 1e-6
"""Part of a cell that decimal fractions may be off."""
Bounds = tuple[float, float, float, float]


def read_texture(path: Path, bounds: Bounds, max_px: int) -> tuple[Picture, Bounds]:
    """An orthophoto within (west, south, east, north), and the bounds of its outer pixels' edges.

    It is shrunk until its longest side is at most `max_px` pixels. Ground that was not seen is
    grey, but for a few pixels along its edge that carry on what is beside them.
    """
    with open_raster(path) as dataset:
        grid = grid_of(dataset)
        west, south, east, north = bounds
        first_col = math.floor((west - grid.west) / grid.cell_m + _TINY)
        first_row = math.floor((grid.north - north) / grid.cell_m + _TINY)
        cols = max(1, math.ceil((east - grid.west) / grid.cell_m - _TINY) - first_col)
        rows = max(1, math.ceil((grid.north - south) / grid.cell_m - _TINY) - first_row)
        shrink = max(1.0, max(rows, cols) / max_px)
        shape = (max(1, round(rows / shrink)), max(1, round(cols / shrink)))
        stored = dataset.read(
            1,
            window=Window(first_col, first_row, cols, rows),
            boundless=True,
            out_shape=shape,
            resampling=Resampling.average,
        )
    return _bled(stored), grid.part(first_row, first_col, rows, cols).bounds


def _bled(grey: Picture) -> Picture:
    """The picture with seen pixels carried on into unseen ones (0), and grey beyond."""
    reach = np.ones((2 * _BLED_PX + 1,) * 2, np.uint8)
    carried = np.where(grey > 0, grey, cv2.dilate(grey, reach))
    return np.where(carried > 0, carried, np.uint8(_BLANK)).astype(np.uint8)
