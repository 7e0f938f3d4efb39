"""One terrain model of a region from the models of many stops, block by block.

What a stop says of a cell is its elevation h_i with two kinds of error: its own (matching,
roughness), sigma_i, and that of its pose, s_i, which neighbouring cells share. Stops are averaged
with

    w_i = t_i^2 / <sigma_i^2 + s_i^2>

where <> is the mean over some cells around, so that noise does not make patchwork of two stops, and
t_i falls from one to nothing within `feather_m` of the edge of what the stop has mapped, so that no
step shows where it ends. Own errors average out, those of poses may be shared by stops that hang on
one another, and are taken as if they were:

    sigma^2 = c sum(w_i^2 sigma_i^2) / (sum w_i)^2 + (sum(w_i s_i) / sum w_i)^2

where c >= 1 is what the stops' disagreement is over what they state. The disagreement itself is a
layer of its own. Ground that no stop has mapped is OCCLUDED where some stop found it hidden.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.grid import MapGrid
from solmap.photogrammetry.terrain.records import Dtm, GroundClass

NO_STOP = np.float32(np.nan)
LEAST_TAPER = 0.01
"""Share of its weight that the outermost cell of a stop keeps where it is the only one."""
TINY_M2 = 1e-8
"""Least variance: a tenth of a millimetre squared."""

Stack = Float32[np.ndarray, "stops rows cols"]
Places = Float32[np.ndarray, "stops 2"]


@dataclass(frozen=True, slots=True)
class RegionParams:
    """How to join the terrain models of stops."""

    cell_m: float = 0.08
    """Side of a cell: two cells of a stop's model, and a quarter of the memory."""
    feather_m: float = 2.0
    """Width over which a stop's edge fades: some spacings of the lines that end it."""
    holes_m: float = 0.5
    """Gaps within a stop's ground up to which no edge is seen: the widest that it bridges."""
    largest_m: float = 700.0
    """Side of the largest region: that of the paper's, 690 x 640 m. A longer traverse has more."""

    def __post_init__(self) -> None:
        if not self.feather_m >= self.cell_m:
            raise TerrainError(
                f"edges fade over at least a cell of {self.cell_m} m, not {self.feather_m} m"
            )

    @property
    def halo(self) -> int:
        """Cells around a block that its own cells depend on."""
        return int(np.ceil((self.feather_m + 2 * self.holes_m) / self.cell_m)) + 1


@dataclass(frozen=True, slots=True, eq=False)
class StopTerrain:
    """A stop's terrain model in a block, and where the stop is."""

    number: int
    """Among all stops of the region."""
    place: tuple[float, float]
    """East and north, metres."""
    dtm: Dtm


@dataclass(frozen=True, slots=True, eq=False)
class RegionBlock:
    """The fused cells of a block."""

    dtm: Dtm
    nearest: Raster
    """Number of the nearest stop that has mapped the cell; NaN where none has."""
    seam_m: Raster
    """Largest difference between what two stops say; NaN where fewer than two say anything."""
    seam_sigmas: Raster
    """The same in standard deviations of the difference."""


def fuse_block(stops: Sequence[StopTerrain], params: RegionParams) -> RegionBlock:
    """Join what some stops say of one block; its grid is that of all their models."""
    grid = stops[0].dtm.grid
    height = _stack([stop.dtm.elevation for stop in stops])
    known = np.isfinite(height)
    pose = np.nan_to_num(_stack([_pose_sigma(stop.dtm) for stop in stops]))
    variance = np.nan_to_num(np.square(_stack([stop.dtm.sigma_m for stop in stops])))
    own = np.maximum(variance - np.square(pose), np.float32(TINY_M2))
    weight = _weights(known, own + np.square(pose), params)
    total = weight.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = weight / total
        level = np.sum(share * np.where(known, height, 0), axis=0)
        level[total == 0] = np.nan
        off = np.where(known, np.square(height - level) / (own + np.square(pose)), 0)
        redundancy = np.maximum(1, known.sum(axis=0) - 1).astype(np.float32)
        excess = off.sum(axis=0) / redundancy
        own_m2 = np.sum(np.square(share) * own, axis=0) * np.maximum(1, excess)
        pose_m = np.sum(share * pose, axis=0)
    dtm = Dtm(
        grid,
        level,
        np.sqrt(own_m2 + np.square(pose_m)),
        _stack([stop.dtm.observations for stop in stops]).sum(axis=0),
        _best_class([stop.dtm.ground for stop in stops]),
        pose_m,
    )
    seam_m, seam_sigmas = _seams(height, own + np.square(pose))
    return RegionBlock(dtm, _nearest(stops, known, grid), seam_m, seam_sigmas)


def _stack(layers: Sequence[Raster]) -> Stack:
    return np.stack(layers).astype(np.float32)


def _pose_sigma(dtm: Dtm) -> Raster:
    return np.zeros_like(dtm.elevation) if dtm.pose_sigma_m is None else dtm.pose_sigma_m


def _weights(known: np.ndarray, variance: Stack, params: RegionParams) -> Stack:
    """Weight of every stop in every cell; 0 where it says nothing."""
    weight = np.zeros_like(variance)
    side = 2 * round(params.feather_m / 4 / params.cell_m) + 1
    hole = np.ones((2 * round(params.holes_m / 2 / params.cell_m) + 1,) * 2, dtype=np.uint8)
    for k, (cells, m2) in enumerate(zip(known, variance, strict=True)):
        if not cells.any():
            continue
        count = cv2.blur(cells.astype(np.float32), (side, side))
        mean = cv2.blur(np.where(cells, m2, np.float32(0)), (side, side)) / np.maximum(count, 1e-6)
        area = cv2.morphologyEx(cells.astype(np.uint8), cv2.MORPH_CLOSE, hole)
        inside = cv2.distanceTransform(area, cv2.DIST_L2, 3) * np.float32(params.cell_m)
        taper = np.clip(inside / np.float32(params.feather_m), LEAST_TAPER, 1)
        weight[k][cells] = (np.square(taper) / np.maximum(mean, np.float32(TINY_M2)))[cells]
    return weight


def _best_class(classes: Sequence[np.ndarray]) -> np.ndarray:
    """Measured before interpolated; without an elevation occluded, if any says so."""
    found = np.zeros_like(classes[0])
    for ground in (GroundClass.OCCLUDED, GroundClass.INTERPOLATED, GroundClass.MEASURED):
        found[np.any([one == ground for one in classes], axis=0)] = ground
    return found


def _nearest(stops: Sequence[StopTerrain], known: np.ndarray, grid: MapGrid) -> Raster:
    """Number of the stop nearest to each cell among those that know it."""
    east, north = grid.centres()
    best = np.full(grid.shape, np.inf, dtype=np.float32)
    nearest = np.full(grid.shape, NO_STOP)
    for stop, cells in zip(stops, known, strict=True):
        away = np.hypot(east[None, :] - stop.place[0], north[:, None] - stop.place[1])
        closer = cells & (away < best)
        best[closer], nearest[closer] = away[closer], stop.number
    return nearest


def _seams(height: Stack, variance: Stack) -> tuple[Raster, Raster]:
    """Largest difference between two stops in every cell, in metres and in its deviations."""
    shape = height.shape[1:]
    metres, sigmas = (np.full(shape, np.nan, dtype=np.float32) for _ in range(2))
    for i in range(len(height)):
        for j in range(i):
            apart = np.abs(height[i] - height[j])
            np.fmax(metres, apart, out=metres)
            np.fmax(sigmas, apart / np.sqrt(variance[i] + variance[j]), out=sigmas)
    return metres, sigmas


def coarser_dtm(dtm: Dtm, factor: int) -> Dtm:
    """A terrain model with cells `factor` times as wide; its errors are as large as they were.

    Neighbouring cells share matches, so that their mean is hardly better than one of them.
    """
    if factor == 1:
        return dtm
    grid = dtm.grid
    if grid.rows % factor or grid.cols % factor:
        raise TerrainError(f"{grid.shape} cells cannot be joined {factor} by {factor}")
    known = _parts(np.isfinite(dtm.elevation), factor)
    count = known.sum(axis=(1, 3))

    def mean(layer: np.ndarray) -> np.ndarray:
        sums = np.where(known, _parts(layer, factor), 0).sum(axis=(1, 3))
        with np.errstate(invalid="ignore", divide="ignore"):
            return (sums / count).astype(np.float32)

    pose = None if dtm.pose_sigma_m is None else mean(dtm.pose_sigma_m)
    parts = _parts(dtm.ground, factor)
    quarters = [parts[:, i, :, j] for i in range(factor) for j in range(factor)]
    return Dtm(
        MapGrid(grid.west, grid.north, grid.cell_m * factor, *count.shape),
        mean(dtm.elevation),
        np.sqrt(mean(np.square(dtm.sigma_m))),
        _parts(dtm.observations, factor).sum(axis=(1, 3)),
        _best_class(quarters),
        pose,
    )


def finer_dtm(dtm: Dtm, factor: int) -> Dtm:
    """A terrain model with cells a `factor`-th as wide: elevations bilinear, all else repeated."""

    def repeated(layer: np.ndarray) -> np.ndarray:
        return layer.repeat(factor, axis=0).repeat(factor, axis=1)

    grid = dtm.grid
    wide = (grid.cols * factor, grid.rows * factor)
    smooth = cv2.resize(dtm.elevation, wide, interpolation=cv2.INTER_LINEAR)
    elevation = repeated(dtm.elevation)
    elevation = np.where(np.isfinite(smooth), smooth, elevation)
    return Dtm(
        MapGrid(grid.west, grid.north, grid.cell_m / factor, wide[1], wide[0]),
        elevation,
        repeated(dtm.sigma_m),
        repeated(dtm.observations) / np.float32(factor**2),
        repeated(dtm.ground),
        None if dtm.pose_sigma_m is None else repeated(dtm.pose_sigma_m),
    )


def _parts(layer: np.ndarray, factor: int) -> np.ndarray:
    rows, cols = layer.shape
    return layer.reshape(rows // factor, factor, cols // factor, factor)
