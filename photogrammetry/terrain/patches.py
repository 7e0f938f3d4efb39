"""A patch of a terrain model as images are laid over it: its ground, its normals, what was seen.

Patches reach one cell beyond their block, so that what is interpolated goes on from one
block to the next. Coordinates are counted from the patch's own origin: single precision then
resolves a hundredth of a millimetre wherever on the map it lies.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Bool, Float32, Raster, Vector3
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm

MARGIN = 1
"""Cells around a block that its interpolation reaches into."""
CARRIED = 2
"""Cells that elevations are carried on beyond what was seen."""


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """The terrain of a block of cells, with a margin around."""

    seen: Bool[np.ndarray, "block_rows block_cols"]
    """Cells of the block, without margin, that have an elevation."""
    origin: Vector3
    """East, north and up that `ground` is counted from, metres."""
    ground: Float32[np.ndarray, "3 rows cols"]
    """East, north, up; up is NaN where there is no ground near."""
    normal: Float32[np.ndarray, "3 rows cols"]

    @classmethod
    def of(cls, dtm: Dtm, place: MapGrid, normal_baseline_m: float) -> Patch:
        """The patch of a terrain model at a block of its own cells."""
        row = round((dtm.grid.north - place.north) / dtm.grid.cell_m)
        col = round((place.west - dtm.grid.west) / dtm.grid.cell_m)
        half = max(1, round((normal_baseline_m / place.cell_m - 1) / 2))
        reach = MARGIN + half + CARRIED
        window = _window(dtm.elevation, row, col, place.shape, reach)
        origin = np.array([place.west, place.north, _level(window)])
        elevation = _carried_on(window - np.float32(origin[2]))
        wide = slice(reach - MARGIN, MARGIN - reach)
        east = (np.arange(-MARGIN, place.cols + MARGIN) + 0.5) * place.cell_m
        north = (np.arange(-MARGIN, place.rows + MARGIN) + 0.5) * -place.cell_m
        ground = np.empty((3, len(north), len(east)), np.float32)
        ground[0], ground[1], ground[2] = east, north[:, None], elevation[wide, wide]
        seen = np.isfinite(window[reach:-reach, reach:-reach])
        normal = _normals(elevation, place.cell_m, half)[:, wide, wide]
        return cls(seen, origin, ground, normal)

    def sphere(self) -> tuple[Vector3, float]:
        """Middle and radius of a sphere around the patch's ground: east, north, up, metres."""
        low, high = np.nanmin(self.ground[2]), np.nanmax(self.ground[2])
        first = np.array([self.ground[0, 0, 0], self.ground[1, 0, 0], low], dtype=np.float64)
        last = np.array([self.ground[0, 0, -1], self.ground[1, -1, 0], high], dtype=np.float64)
        return self.origin + (first + last) / 2, float(np.linalg.norm(last - first)) / 2

    def from_camera(self, camera: Vector3) -> Float32[np.ndarray, "3 rows cols"]:
        """The ground as counted from a camera (east, north, up)."""
        return self.ground - (camera - self.origin).astype(np.float32)[:, None, None]


def _level(elevation: Raster) -> float:
    known = elevation[np.isfinite(elevation)]
    return float(known[0]) if known.size else 0.0


def _window(
    raster: Raster, row: int, col: int, shape: tuple[int, int], reach: int
) -> Float32[np.ndarray, "window_rows window_cols"]:
    """A window of the raster, widened by `reach` to all sides; NaN outside the raster."""
    row, col = row - reach, col - reach
    window = np.full((shape[0] + 2 * reach, shape[1] + 2 * reach), np.nan, dtype=np.float32)
    top, left = max(0, row), max(0, col)
    bottom = min(raster.shape[0], row + window.shape[0])
    right = min(raster.shape[1], col + window.shape[1])
    window[top - row : bottom - row, left - col : right - col] = raster[top:bottom, left:right]
    return window


def _carried_on(elevation: Raster) -> Raster:
    """Elevations carried on beyond what was seen, so that interpolation reaches its edge."""
    known = np.isfinite(elevation)
    if known.all():
        return elevation
    size = (2 * CARRIED + 1, 2 * CARRIED + 1)
    sums = cv2.boxFilter(np.where(known, elevation, np.float32(0)), -1, size, normalize=False)
    count = cv2.boxFilter(known.astype(np.float32), -1, size, normalize=False)
    around = sums / np.where(count > 0.5, count, np.float32(np.nan))  # noqa: PLR2004 - counts
    return np.where(known, elevation, around)


def _normals(elevation: Raster, cell_m: float, half: int) -> Float32[np.ndarray, "3 rows cols"]:
    """Unit normals (east, north, up) of planes through the cells up to `half` cells away.

    The sums of `surface.gradients` without its care for missing cells: these have been filled.
    """
    steps = np.arange(-half, half + 1, dtype=np.float32)
    slope = steps / np.float32((steps**2).sum() * cell_m)
    level = np.full_like(steps, 1 / len(steps))
    filled = np.nan_to_num(elevation)
    east = cv2.sepFilter2D(filled, cv2.CV_32F, slope, level, borderType=cv2.BORDER_REPLICATE)
    north = cv2.sepFilter2D(filled, cv2.CV_32F, level, -slope, borderType=cv2.BORDER_REPLICATE)
    upright = 1 / np.sqrt(1 + east * east + north * north)
    return np.stack([-east * upright, -north * upright, upright])
