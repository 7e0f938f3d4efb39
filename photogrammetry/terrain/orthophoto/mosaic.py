"""Project views to patches of a terrain model and blend them.

A patch contains the ground of one block of cells, its normals, and which cells are known. It
extends one cell beyond its block, so that interpolation is continuous from one block to the next.
Coordinates are relative to the patch's own origin: single precision then resolves a hundredth of a
millimetre anywhere on the map.

Every view has a weight w in a cell, by its quality (`view_sampling`) relative to that of the best
view,

    w ~ (quality / best quality)^k, sum of all w = 1,

so that for large k almost every cell is from one view, with transitions of some twenty pixels: no
visible seams and no double images. Weights below `LEAST_SHARE` are ignored.

Image coordinates, weights and widths of cells in pixels are computed at the cells of the terrain
model and interpolated between them: across a terrain cell of 0.04 m at 2 m distance the curvature
of the perspective is 0.03 px. A view's image is sampled only in the part of a block where it has
weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt16

from solmap.photogrammetry.arrays import Bool, Float32, Raster, Vector3
from solmap.photogrammetry.planes import filled_gradients
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.orthophoto.view_sampling import ProjectedCells, ViewSampler

MARGIN = 1
"""Cells around a block that its interpolation needs."""
NORMAL_BASELINE_M = 0.2
"""Baseline of the normals for incidence: includes rocks, averages noise."""
SHARPNESS = 8.0
"""Exponent k: a view of three quarters of the best quality has a tenth of its weight."""
CARRIED = 2
"""Cells by which elevations are extrapolated beyond known ground."""
NO_SOURCE = np.iinfo(np.uint16).max
"""Source index of cells without a view."""
LEAST_SHARE = np.float32(1 / 64)
"""Smallest weight used: with 8 bits per pixel, smaller ones change no grey value by two."""
FineBlock = Float32[np.ndarray, "bands fine_rows fine_cols"]
"""Brightness of a block in cells of the orthophoto, band by band."""
Sources = UInt16[np.ndarray, "block_rows block_cols"]
"""Index of the view with the largest weight; `NO_SOURCE` where there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainPatch:
    """The terrain of a block of cells, with a margin around."""

    seen: Bool[np.ndarray, "block_rows block_cols"]
    """Cells of the block, without margin, that have an elevation."""
    origin: Vector3
    """Origin of `ground` (east, north, up), metres."""
    ground: Float32[np.ndarray, "3 rows cols"]
    """East, north, up; up is NaN where no ground is near."""
    normal: Float32[np.ndarray, "3 rows cols"]

    @classmethod
    def of(cls, dtm: Dtm, place: MapGrid) -> TerrainPatch:
        """The patch of a terrain model at a block of its own cells."""
        row = round((dtm.grid.north - place.north) / dtm.grid.cell_m)
        col = round((place.west - dtm.grid.west) / dtm.grid.cell_m)
        half = max(1, round((NORMAL_BASELINE_M / place.cell_m - 1) / 2))
        reach = MARGIN + half + CARRIED
        window = _window(dtm.elevation, row, col, place.shape, reach)
        origin = np.array([place.west, place.north, _level(window)])
        elevation = _extrapolate(window - np.float32(origin[2]))
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
        """The ground relative to a camera (east, north, up)."""
        return self.ground - (camera - self.origin).astype(np.float32)[:, None, None]


def _level(elevation: Raster) -> float:
    known = elevation[np.isfinite(elevation)]
    return float(known[0]) if known.size else 0.0


def _window(
    raster: Raster, row: int, col: int, shape: tuple[int, int], reach: int
) -> Float32[np.ndarray, "window_rows window_cols"]:
    """A window of the raster, extended by `reach` on all sides; NaN outside the raster."""
    row, col = row - reach, col - reach
    window = np.full((shape[0] + 2 * reach, shape[1] + 2 * reach), np.nan, dtype=np.float32)
    top, left = max(0, row), max(0, col)
    bottom = min(raster.shape[0], row + window.shape[0])
    right = min(raster.shape[1], col + window.shape[1])
    window[top - row : bottom - row, left - col : right - col] = raster[top:bottom, left:right]
    return window


def _extrapolate(elevation: Raster) -> Raster:
    """Elevations extrapolated beyond known ground, so that interpolation covers its edge."""
    known = np.isfinite(elevation)
    if known.all():
        return elevation
    size = (2 * CARRIED + 1, 2 * CARRIED + 1)
    sums = cv2.boxFilter(np.where(known, elevation, np.float32(0)), -1, size, normalize=False)
    count = cv2.boxFilter(known.astype(np.float32), -1, size, normalize=False)
    around = sums / np.where(count > 0.5, count, np.float32(np.nan))  # noqa: PLR2004 - counts
    return np.where(known, elevation, around)


def _normals(elevation: Raster, cell_m: float, half: int) -> Float32[np.ndarray, "3 rows cols"]:
    """Unit normals (east, north, up) of planes through the cells up to `half` cells away."""
    east, north = filled_gradients(elevation, cell_m, half)
    upright = 1 / np.sqrt(1 + east * east + north * north)
    return np.stack([-east * upright, -north * upright, upright])


@dataclass(frozen=True, slots=True, eq=False)
class ViewShares:
    """The views of a patch's cells, and their weights."""

    views: Sequence[int]
    """Their numbers."""
    cells: list[ProjectedCells]
    weights: list[Raster]
    shown: Bool[np.ndarray, "rows cols"]
    """Cells in which any view has weight."""

    def sources(self, seen: Bool[np.ndarray, "block_rows block_cols"]) -> Sources:
        """The view with the largest weight in every cell of the block, without margin."""
        inner = (slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN))
        source = np.full(seen.shape, NO_SOURCE, np.uint16)
        if self.weights:
            best = np.argmax([weight[inner] for weight in self.weights], axis=0)
            shown = seen & self.shown[inner]
            source[shown] = np.array(self.views, np.uint16)[best[shown]]
        return source


def view_shares(samplers: Sequence[ViewSampler], patch: TerrainPatch, cell_m: float) -> ViewShares:
    """The weight of every view in the cells of a patch."""
    middle, radius_m = patch.sphere()
    numbers, projected = [], []
    for number, sampler in enumerate(samplers):
        if sampler.may_show(middle, radius_m):
            ground = patch.from_camera(sampler.camera)
            cells = sampler.project(ground, patch.normal, cell_m)
            if cells.worth.any():
                numbers.append(number)
                projected.append(cells)
    if not projected:
        return ViewShares((), [], [], np.zeros(patch.ground.shape[1:], dtype=bool))
    worth = np.stack([cells.worth for cells in projected])
    best = worth.max(axis=0)
    weight = (worth / np.where(best > 0, best, 1)) ** np.float32(SHARPNESS)
    weight[weight < LEAST_SHARE] = 0
    weight /= np.maximum(weight.sum(axis=0), LEAST_SHARE)
    return ViewShares(numbers, projected, list(weight), best > 0)


def blend(
    samplers: Sequence[ViewSampler],
    patch: TerrainPatch,
    shared: ViewShares,
    cell_m: float,
    ratio: int,
) -> FineBlock:
    """Brightness of a block in cells of `cell_m`, `ratio` per terrain cell.

    NaN where no view shows the ground.
    """
    rows, cols = patch.seen.shape
    fine = np.zeros((len(samplers[0].bands), rows * ratio, cols * ratio), np.float32)
    for number, cells, weight in zip(shared.views, shared.cells, shared.weights, strict=True):
        _add(fine, samplers[number], cells, weight, cell_m)
    return _without_hidden(fine, patch, shared, ratio)


def _part(weight: Raster) -> tuple[int, int, int, int]:
    """First row, one after the last, first column, one after the last with weight.

    Relative to the block, without its margin.
    """
    return *_span(np.any(weight, axis=1)), *_span(np.any(weight, axis=0))


def _span(touched: Bool[np.ndarray, " n"]) -> tuple[int, int]:
    """First and one after the last row or column, of the block and with a neighbour either side."""
    where = np.flatnonzero(touched)
    if not len(where):
        return 0, 0
    first, last = int(where[0]) - MARGIN, int(where[-1]) - MARGIN
    return max(0, first - 1), min(len(touched) - 2 * MARGIN, last + 2)


def _add(
    fine: FineBlock, sampler: ViewSampler, cells: ProjectedCells, weight: Raster, cell_m: float
) -> None:
    """Add a view's weighted brightness to a block, where the view has weight."""
    top, bottom, left, right = _part(weight)
    if not (bottom > top and right > left):
        return
    ratio = fine.shape[1] // (weight.shape[0] - 2 * MARGIN)
    wide = (slice(top, bottom + 2 * MARGIN), slice(left, right + 2 * MARGIN))
    width = np.sqrt(cells.density[wide]) * np.float32(cell_m)
    level = np.log2(np.maximum(width, 1))
    levels = _finer(level, ratio) if level.any() else None
    sample, line, share = (_finer(r[wide], ratio) for r in (cells.sample, cells.line, weight))
    part = fine[:, top * ratio : bottom * ratio, left * ratio : right * ratio]
    for number, band in enumerate(part):
        cv2.accumulateProduct(sampler.brightness(sample, line, levels, number), share, band)


def _without_hidden(
    fine: FineBlock, patch: TerrainPatch, shared: ViewShares, ratio: int
) -> FineBlock:
    """NaN where the ground is unknown or not visible, and full weight at the edges of that."""
    if patch.seen.all() and shared.shown.all():
        return fine
    size = (patch.seen.shape[1] * ratio, patch.seen.shape[0] * ratio)
    nothing = np.float32(np.nan)
    total = _finer(shared.shown.astype(np.float32), ratio)
    np.copyto(total, nothing, where=total < 0.5)  # noqa: PLR2004 - more hidden than shown
    seen = np.where(patch.seen, np.float32(1), nothing)
    total *= cv2.resize(seen, size, interpolation=cv2.INTER_NEAREST)
    fine /= total
    return fine


def _finer(raster: Raster, ratio: int) -> Float32[np.ndarray, "fine_rows fine_cols"]:
    """A raster with margin, interpolated `ratio` times finer, without the margin."""
    size = (raster.shape[1] * ratio, raster.shape[0] * ratio)
    fine = cv2.resize(raster, size, interpolation=cv2.INTER_LINEAR)
    edge = MARGIN * ratio
    return fine[edge:-edge, edge:-edge]
