"""An orbital image drawn where it truly lies."""

from __future__ import annotations

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.orbital.records import Correction, OrbitalImage
from solmap.photogrammetry.orbital.search import samples_of
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

STRIP = 2048
"""Rows and columns looked up at a time; OpenCV takes fewer than 32768."""


def placed(image: OrbitalImage, grid: MapGrid, correction: Correction | None) -> Raster:
    """The image on a grid of the map, moved by a correction; NaN beyond it."""
    out = np.full(grid.shape, np.nan, dtype=np.float32)
    known = np.isfinite(image.brightness)
    layers = np.where(known, image.brightness, 0.0).astype(np.float32), known.astype(np.float32)
    east, north = grid.centres()
    for top in range(0, grid.rows, STRIP):
        for left in range(0, grid.cols, STRIP):
            part = np.s_[top : top + STRIP, left : left + STRIP]
            true_east, true_north = np.meshgrid(east[part[1]], north[part[0]])
            samples = samples_of(image.grid, *_claimed(true_east, true_north, correction))
            value, weight = (cv2.remap(layer, *samples, cv2.INTER_LINEAR) for layer in layers)
            with np.errstate(invalid="ignore", divide="ignore"):
                out[part] = np.where(np.asarray(weight) > 0.5, value / weight, np.nan)  # noqa: PLR2004
    return out


def _claimed(
    east: np.ndarray, north: np.ndarray, correction: Correction | None
) -> tuple[np.ndarray, np.ndarray]:
    """Where the georeference puts what truly lies at places: `Correction.apply` undone."""
    if correction is None:
        return east, north
    c, s = (f(np.radians(correction.rotation_deg)) for f in (np.cos, np.sin))
    centre_e, centre_n = correction.centre_m
    de = east - centre_e - correction.east_m
    dn = north - centre_n - correction.north_m
    return centre_e + c * de + s * dn, centre_n - s * de + c * dn
