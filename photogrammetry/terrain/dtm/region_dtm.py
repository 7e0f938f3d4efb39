"""One terrain model of a region from the models of many stops, block by block.

A stop gives the elevation h_i of a cell with two kinds of error: an independent one (matching,
roughness), sigma_i, and that of its pose, s_i, common to neighbouring cells. Stops are averaged
with

    w_i = t_i^2 / <sigma_i^2 + s_i^2>

where <> is the mean over some cells around, so that noise does not mix two stops cell by cell, and
t_i decreases from one to zero within `feather_m` of the edge of the stop's map, so that there is no
step at it. Independent errors average out; those of poses may be correlated between stops, and are
treated as fully correlated:

    sigma^2 = c sum(w_i^2 sigma_i^2) / (sum w_i)^2 + (sum(w_i s_i) / sum w_i)^2

where c >= 1 is the ratio of the stops' disagreement to their standard deviations. The disagreement
is also a separate layer. Ground that no stop has mapped is OCCLUDED where some stop marks it so.

Where there is far ground only, it is fused in its own larger cells and interpolated.

Stops are grouped into regions in the order of the traverse. A stop joins the region before it when
its ground overlaps that of one of the region's stops and the region does not grow beyond the
largest side; else a new region begins. So a longer traverse changes the last region at most.

The differences of any two stops over their common ground are counted in classes whose limits grow
by two percent, because the values of all cells of a large region would fill the memory; a median or
percentile from these counts is accurate to one percent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.ranges import MOST_SIDE, CellSize, Metres
from solmap.photogrammetry.terrain.dtm.grid import Bounds, MapGrid, overlap, union
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.dtm.resampling import finer_dtm, merge_classes, repeat

NO_STOP = np.float32(np.nan)
LEAST_TAPER = 0.01
"""Fraction of its weight that the outermost cell of a stop keeps where no other covers it."""
HOLES_M = 0.5
"""Gaps within a stop's ground that do not count as edges: the widest that it bridges."""
TINY_M2 = 1e-8
"""Lower limit of the variance: a tenth of a millimetre squared."""

Stack = Float32[np.ndarray, "stops rows cols"]
Places = Float32[np.ndarray, "stops 2"]
CELLS_ALONG_FAR = 2
"""Cells of maps along one of far ground, where nothing finer is known: half as wide, they show what
is interpolated between its cells."""
LEAST, GROWTH, CLASSES = 1e-4, 1.02, 800
"""From a tenth of a millimetre to beyond a hundred metres; the same numbers are used for sigmas."""


@dataclass(frozen=True, slots=True)
class RegionParams:
    """How to join the terrain models of stops."""

    cell_m: CellSize = 0.08
    """Side of a cell: two cells of a stop's model, and a quarter of the memory."""
    feather_m: Metres = 2.0
    """Width over which a stop's weight decreases at its edge: some spacings of the last lines."""
    largest_m: Metres = 700.0
    """Side of the largest region: that of the paper's, 690 x 640 m. A longer traverse has more."""

    def __post_init__(self) -> None:
        if not self.feather_m >= self.cell_m:
            raise TerrainError(
                f"feather_m must be at least a cell of {self.cell_m} m, not {self.feather_m} m"
            )
        if self.largest_m > MOST_SIDE * self.cell_m:
            raise TerrainError(
                f"a region of {self.largest_m} m has more than {MOST_SIDE} cells of "
                f"{self.cell_m} m a side: give larger cells or smaller regions"
            )

    @property
    def halo(self) -> int:
        """Margin of a block in cells on which its own cells depend."""
        return int(np.ceil((self.feather_m + 2 * HOLES_M) / self.cell_m)) + 1

    def wider(self, factor: int) -> RegionParams:
        """The same in cells `factor` times as wide."""
        cell_m = self.cell_m * factor
        return replace(self, cell_m=cell_m, feather_m=max(self.feather_m, cell_m))


@dataclass(frozen=True, slots=True, eq=False)
class StopTerrain:
    """A stop's terrain model in a block, and the stop's position."""

    number: int
    """Number among all stops of the region."""
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
    """Largest difference between two stops; NaN where fewer than two have mapped the cell."""
    seam_sigmas: Raster
    """Differences at seams in standard deviations of the difference."""


def fuse_block(stops: Sequence[StopTerrain], params: RegionParams) -> RegionBlock:
    """Fuse the models of some stops in one block; its grid is that of all their models."""
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
        merge_classes([stop.dtm.ground for stop in stops]),
        pose_m,
    )
    seam_m, seam_sigmas = _seams(height, own + np.square(pose))
    return RegionBlock(dtm, _nearest(stops, known, grid), seam_m, seam_sigmas)


def finer_block(block: RegionBlock, factor: int) -> RegionBlock:
    """The same in `factor` times finer cells."""
    rest = (block.nearest, block.seam_m, block.seam_sigmas)
    return RegionBlock(finer_dtm(block.dtm, factor), *(repeat(layer, factor) for layer in rest))


def _stack(layers: Sequence[Raster]) -> Stack:
    return np.stack(layers).astype(np.float32)


def _pose_sigma(dtm: Dtm) -> Raster:
    return np.zeros_like(dtm.elevation) if dtm.pose_sigma_m is None else dtm.pose_sigma_m


def _weights(known: np.ndarray, variance: Stack, params: RegionParams) -> Stack:
    """Weight of every stop in every cell; 0 where it has no elevation."""
    weight = np.zeros_like(variance)
    side = 2 * round(params.feather_m / 4 / params.cell_m) + 1
    hole = np.ones((2 * round(HOLES_M / 2 / params.cell_m) + 1,) * 2, dtype=np.uint8)
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


def _nearest(stops: Sequence[StopTerrain], known: np.ndarray, grid: MapGrid) -> Raster:
    """Number of the stop nearest to each cell among those that have mapped it."""
    east, north = grid.centres()
    best = np.full(grid.shape, np.inf, dtype=np.float32)
    nearest = np.full(grid.shape, NO_STOP)
    for stop, cells in zip(stops, known, strict=True):
        away = np.hypot(east[None, :] - stop.place[0], north[:, None] - stop.place[1])
        closer = cells & (away < best)
        best[closer], nearest[closer] = away[closer], stop.number
    return nearest


def _seams(height: Stack, variance: Stack) -> tuple[Raster, Raster]:
    """Largest difference between two stops in every cell, in metres and standard deviations."""
    shape = height.shape[1:]
    metres, sigmas = (np.full(shape, np.nan, dtype=np.float32) for _ in range(2))
    for i in range(len(height)):
        for j in range(i):
            apart = np.abs(height[i] - height[j])
            np.fmax(metres, apart, out=metres)
            np.fmax(sigmas, apart / np.sqrt(variance[i] + variance[j]), out=sigmas)
    return metres, sigmas


def regions_of(stops: Sequence[Bounds], largest_m: float) -> list[list[int]]:
    """The regions of a traverse, each as the numbers of its stops."""
    regions: list[list[int]] = []
    for number, bounds in enumerate(stops):
        last = [stops[k] for k in regions[-1]] if regions else []
        joins = any(overlap(bounds, other) for other in last)
        if joins and _side_m([*last, bounds]) <= largest_m:
            regions[-1].append(number)
        else:
            regions.append([number])
    return regions


def _side_m(stops: Sequence[Bounds]) -> float:
    west, south, east, north = union(stops)
    return max(east - west, north - south)


@dataclass(frozen=True, slots=True)
class Seam:
    """The disagreement between two stops."""

    stops: tuple[int, int]
    """Their numbers in the region."""
    cells: int
    mean_m: float
    """Median height of the second minus the first."""
    median_m: float
    p90_m: float
    median_sigmas: float
    p90_sigmas: float


@dataclass(slots=True, eq=False)
class _Counts:
    metres: np.ndarray = field(default_factory=lambda: np.zeros(CLASSES, dtype=np.int64))
    sigmas: np.ndarray = field(default_factory=lambda: np.zeros(CLASSES, dtype=np.int64))
    signed_m: float = 0.0


@dataclass(slots=True, eq=False)
class SeamCounter:
    """Counts the differences between stops, block by block."""

    counts: dict[tuple[int, int], _Counts] = field(default_factory=dict)

    def add(
        self, stops: Sequence[StopTerrain], inside: tuple[slice, slice], times: int = 1
    ) -> None:
        """Count the cells `inside` a block, each so many `times`."""
        for one, other in combinations(stops, 2):
            self._add((one.number, other.number), one.dtm, other.dtm, inside, times)

    def _add(
        self,
        pair: tuple[int, int],
        one: Dtm,
        other: Dtm,
        inside: tuple[slice, slice],
        times: int,
    ) -> None:
        apart = other.elevation[inside] - one.elevation[inside]
        both = np.isfinite(apart)
        if not both.any():
            return
        apart = apart[both]
        sigma = np.hypot(one.sigma_m[inside][both], other.sigma_m[inside][both])
        counts = self.counts.setdefault(pair, _Counts())
        counts.signed_m += times * float(apart.sum(dtype=np.float64))
        counts.metres += times * _histogram(np.abs(apart))
        counts.sigmas += times * _histogram(np.abs(apart) / sigma)

    def seams(self) -> tuple[Seam, ...]:
        """The disagreement of every two stops with common ground."""
        return tuple(
            Seam(
                pair,
                int(counts.metres.sum()),
                round(counts.signed_m / int(counts.metres.sum()), 4),
                *(
                    round(_percentile(values, share), 4)
                    for values in (counts.metres, counts.sigmas)
                    for share in (0.5, 0.9)
                ),
            )
            for pair, counts in sorted(self.counts.items())
        )


def _histogram(values: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        at = np.log(values / LEAST) / np.log(GROWTH)
    return np.bincount(np.clip(at, 0, CLASSES - 1).astype(np.int64), minlength=CLASSES)


def _percentile(counts: np.ndarray, share: float) -> float:
    """The value below which a fraction of the counted ones lies."""
    reached = np.cumsum(counts)
    at = int(np.searchsorted(reached, share * reached[-1]))
    return float(LEAST * GROWTH ** (at + 0.5))
