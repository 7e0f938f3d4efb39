"""Orthophotos of stops merged to one of a region, without visible seams.

Brightness differs between stops with the light, the exposure and the stretch of what was seen:
every stop has one gain and one offset, so that stops agree where they overlap
(`brightness.balance`). What a stop is worth in a cell falls with the square of the distance from
its cameras, as the density of their pixels does, and to nothing at the edge of what it shows; its
share is

    w ~ (worth / greatest worth)^k,     sum of all w = 1

as for the views of one stop (`mosaic`), so that the nearest stop speaks for almost every cell and
two change over within a narrow band.
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
"""Distance within which a stop is worth no more: its own ground begins there."""
HOLES_M = 0.2
"""Gaps in what a stop shows up to which no edge is seen."""


@dataclass(frozen=True, slots=True)
class MergingParams:
    """How to merge the orthophotos of stops."""

    cell_m: CellSize = 0.02
    """Side of a cell: two cells of a stop's orthophoto, and no finer than the coarsest of them."""
    feather_m: Metres = 1.0
    """Width over which the edge of what a stop shows fades."""

    def __post_init__(self) -> None:
        if not self.feather_m >= self.cell_m > 0:
            raise TerrainError(
                f"edges fade over at least a cell of {self.cell_m} m, not {self.feather_m} m"
            )

    @property
    def halo(self) -> int:
        """Cells around a block that its own cells depend on."""
        return int(np.ceil((self.feather_m + 2 * HOLES_M) / self.cell_m)) + 1


@dataclass(frozen=True, slots=True, eq=False)
class StopPicture:
    """What a stop shows of a block, and where the stop is."""

    place: tuple[float, float]
    """East and north of its cameras, metres."""
    brightness: Raster
    """Balanced; NaN where it shows nothing."""


def merge_block(
    stops: Sequence[StopPicture], grid: MapGrid, params: MergingParams
) -> Float32[np.ndarray, "rows cols"]:
    """Brightness of a block, all of whose stops have its grid; NaN where none shows anything."""
    worth = np.stack([_worth(stop, grid, params) for stop in stops])
    greatest = worth.max(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (worth / greatest) ** np.float32(SHARPNESS)
    share[~(share >= LEAST_SHARE)] = 0
    total = share.sum(axis=0)
    merged = np.zeros(grid.shape, np.float32)
    for part, stop in zip(share, stops, strict=True):
        cv2.accumulateProduct(np.nan_to_num(stop.brightness), part, merged)
    return np.where(greatest > 0, merged / np.maximum(total, LEAST_SHARE), np.float32(np.nan))


def _worth(stop: StopPicture, grid: MapGrid, params: MergingParams) -> Raster:
    shown = np.isfinite(stop.brightness)
    east, north = grid.centres()
    square = np.square(east[None, :] - stop.place[0]) + np.square(north[:, None] - stop.place[1])
    hole = np.ones((2 * round(HOLES_M / 2 / params.cell_m) + 1,) * 2, np.uint8)
    area = cv2.morphologyEx(shown.astype(np.uint8), cv2.MORPH_CLOSE, hole)
    inside = cv2.distanceTransform(area, cv2.DIST_L2, 3) * np.float32(params.cell_m)
    fade = np.clip(inside / np.float32(params.feather_m), 0, 1)
    return np.where(shown, fade / np.maximum(square, NEAREST_M**2), 0).astype(np.float32)
