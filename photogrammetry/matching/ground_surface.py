"""The ground that a stop measured, as a surface without gaps to draw patches over."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Raster
from solmap.photogrammetry.matching.birds_eye import BirdsEyeView

FILL_CELLS = (1.0, 3.0, 8.0)
"""Gaps are filled from neighbours within these standard deviations, nearest first."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundSurface:
    """Elevation around a stop in its level frame, without gaps near what was measured."""

    cell_m: float
    elevation: Raster

    @classmethod
    def of(cls, view: BirdsEyeView) -> GroundSurface:
        """Fill the gaps between the measured cells of a bird's-eye view."""
        seen = np.isfinite(view.elevation)
        value = np.nan_to_num(view.elevation)
        filled = view.elevation.copy()
        for sigma in FILL_CELLS:
            density = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), sigma)
            mean = cv2.GaussianBlur(value, (0, 0), sigma) / np.maximum(density, 1e-6)
            near = np.isnan(filled) & (density > 0.02)  # noqa: PLR2004 - something within 2 sigma
            filled[near] = mean[near]
        known = np.isfinite(filled)
        inner = cv2.erode(known.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        smooth = cv2.medianBlur(np.where(known, filled, 0).astype(np.float32), 5)
        return cls(view.cell_m, np.where(inner, smooth, filled).astype(np.float32))

    def at(self, north: np.ndarray, east: np.ndarray) -> Float32[np.ndarray, "rows cols"]:
        """Elevation at places of the level frame, NaN where unknown."""
        if not north.size:
            return np.zeros(north.shape, np.float32)
        half = self.elevation.shape[0] / 2 - 0.5
        col = (east / self.cell_m + half).astype(np.float32)
        row = (half - north / self.cell_m).astype(np.float32)
        return cv2.remap(
            self.elevation,
            col,
            row,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        ).astype(np.float32)
