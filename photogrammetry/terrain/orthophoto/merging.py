"""Merge orthophotos of stops into one of a region, without visible seams.

Brightness differs between stops by light, exposure and stretch: every stop gets a gain and an
offset, so that stops agree where they overlap (`brightness.balance`). The quality of a stop in a
cell decreases with the square of the distance from its cameras, like the density of their pixels,
and to zero at the edge of its orthophoto; its weight is

    w ~ (quality / best quality)^k, sum of all w = 1

as for the views of one stop (`mosaic`), so that almost every cell is from its nearest stop, with
narrow transitions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.ranges import CellSize, Metres
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.orthophoto.mosaic import LEAST_SHARE, SHARPNESS

NEAREST_M = 1.0
"""Distance below which the quality is constant: the ground at the stop itself."""
HOLES_M = 0.2
"""Gaps in a stop's orthophoto that do not count as edges."""


@dataclass(frozen=True, slots=True)
class MergingParams:
    """How to merge the orthophotos of stops."""

    cell_m: CellSize = 0.02
    """Side of a cell: two cells of a stop's orthophoto, and no finer than the coarsest of them."""
    feather_m: Metres = 1.0
    """Width over which a stop's weight decreases at its edge."""

    def __post_init__(self) -> None:
        if not self.feather_m >= self.cell_m > 0:
            raise TerrainError(
                f"feather_m must be at least a cell of {self.cell_m} m, not {self.feather_m} m"
            )

    @property
    def halo(self) -> int:
        """Margin of a block in cells on which its own cells depend."""
        return int(np.ceil((self.feather_m + 2 * HOLES_M) / self.cell_m)) + 1


@dataclass(frozen=True, slots=True, eq=False)
class StopImagery:
    """The orthophoto of a stop in a block, and the stop's position."""

    place: tuple[float, float]
    """East and north of its cameras, metres."""
    brightness: Raster
    """Balanced; NaN where there is none."""


def merge_block(
    stops: Sequence[StopImagery], grid: MapGrid, params: MergingParams
) -> Float32[np.ndarray, "rows cols"]:
    """Brightness of a block, all of whose stops have its grid; NaN where no stop has any."""
    if len(stops) == 1:
        return stops[0].brightness
    worth = [_worth(stop, grid, params) for stop in stops]
    greatest = np.maximum.reduce(worth)
    total, merged = (np.zeros(grid.shape, np.float32) for _ in range(2))
    for stop, own in zip(stops, worth, strict=True):
        with np.errstate(invalid="ignore"):
            share = cv2.pow(own / greatest, SHARPNESS)
        share[~(share >= LEAST_SHARE)] = 0
        total += share
        cv2.accumulateProduct(np.nan_to_num(stop.brightness), share, merged)
    return np.where(greatest > 0, merged / np.maximum(total, LEAST_SHARE), np.float32(np.nan))


def _worth(stop: StopImagery, grid: MapGrid, params: MergingParams) -> Raster:
    shown = np.isfinite(stop.brightness)
    away = (axis - middle for axis, middle in zip(grid.centres(), stop.place, strict=True))
    east_m2, north_m2 = (np.square(axis).astype(np.float32) for axis in away)
    square = east_m2[None, :] + north_m2[:, None]
    hole = np.ones((2 * round(HOLES_M / 2 / params.cell_m) + 1,) * 2, np.uint8)
    area = cv2.morphologyEx(shown.astype(np.uint8), cv2.MORPH_CLOSE, hole)
    inside = cv2.distanceTransform(area, cv2.DIST_L2, 3) * np.float32(params.cell_m)
    fade = np.clip(inside / np.float32(params.feather_m), 0, 1)
    fade[~shown] = 0
    return fade / np.maximum(square, np.float32(NEAREST_M**2))
