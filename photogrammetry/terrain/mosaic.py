"""Views laid over a patch of terrain and blended.

Every view has a share w of a cell, by its worth (see `looks`) against that of the best view there,

    w ~ (worth / greatest worth)^k,     sum of all w = 1,

so that for large k one view alone speaks for almost every cell, and two of equal worth change over
within some twenty pixels: no seam, and no room for ghosts. Shares below `LEAST_SHARE` are left out.

Image coordinates, shares and widths of cells in pixels are found at the cells of the terrain model
and interpolated between them: across a terrain cell of 0.04 m at 2 m distance the curvature of the
perspective is 0.03 px. Only the part of a block where a view has a share is looked up in its image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt16

from solmap.photogrammetry.arrays import Bool, Float32, Raster
from solmap.photogrammetry.terrain.looks import Look, Sight
from solmap.photogrammetry.terrain.patches import MARGIN, Patch

NO_SOURCE = np.iinfo(np.uint16).max
"""Source index of cells that no view shows."""
LEAST_SHARE = np.float32(1 / 64)
"""A view that counts for less is left out: with 8 bits a pixel, it moves no grey value by two."""

FineBlock = Float32[np.ndarray, "bands fine_rows fine_cols"]
"""Brightness of a block in cells of the orthophoto, band by band."""
Sources = UInt16[np.ndarray, "block_rows block_cols"]
"""Index of the view that counts most; `NO_SOURCE` where there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Shares:
    """Which views show the cells of a patch, and what each counts for."""

    looks: Sequence[int]
    sights: list[Sight]
    weights: list[Raster]
    shown: Bool[np.ndarray, "rows cols"]
    """Where any view counts."""

    def sources(self, seen: Bool[np.ndarray, "block_rows block_cols"]) -> Sources:
        """The view that counts most for every cell of the block, without margin."""
        inner = (slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN))
        source = np.full(seen.shape, NO_SOURCE, np.uint16)
        if self.weights:
            best = np.argmax([weight[inner] for weight in self.weights], axis=0)
            shown = seen & self.shown[inner]
            source[shown] = np.array(self.looks, np.uint16)[best[shown]]
        return source


def shares(
    looks: Sequence[Look], patch: Patch, cell_m: float, sharpness: float, tolerance_px: float
) -> Shares:
    """What every view counts for in the cells of a patch."""
    middle, radius_m = patch.sphere()
    numbers, sights = [], []
    for number, look in enumerate(looks):
        if look.may_show(middle, radius_m):
            ground = patch.from_camera(look.camera)
            sight = look.sight(ground, patch.normal, tolerance_px, cell_m)
            if sight.worth.any():
                numbers.append(number)
                sights.append(sight)
    if not sights:
        return Shares((), [], [], np.zeros(patch.ground.shape[1:], dtype=bool))
    worth = np.stack([sight.worth for sight in sights])
    best = worth.max(axis=0)
    weight = (worth / np.where(best > 0, best, 1)) ** np.float32(sharpness)
    weight[weight < LEAST_SHARE] = 0
    weight /= np.maximum(weight.sum(axis=0), LEAST_SHARE)
    return Shares(numbers, sights, list(weight), best > 0)


def blended(
    looks: Sequence[Look], patch: Patch, shared: Shares, cell_m: float, ratio: int
) -> FineBlock:
    """Brightness of a block in cells of `cell_m`, `ratio` to a terrain cell.

    NaN where no view shows the ground.
    """
    rows, cols = patch.seen.shape
    fine = np.zeros((len(looks[0].bands), rows * ratio, cols * ratio), np.float32)
    for number, sight, weight in zip(shared.looks, shared.sights, shared.weights, strict=True):
        _add(fine, looks[number], sight, weight, cell_m)
    return _without_hidden(fine, patch, shared, ratio)


def _part(weight: Raster) -> tuple[int, int, int, int]:
    """First row, one after the last, first column, one after the last that a weight touches.

    Counted in the block, without its margin.
    """
    return *_span(np.any(weight, axis=1)), *_span(np.any(weight, axis=0))


def _span(touched: Bool[np.ndarray, " n"]) -> tuple[int, int]:
    """First and one after the last row or column, of the block and with a neighbour either side."""
    where = np.flatnonzero(touched)
    if not len(where):
        return 0, 0
    first, last = int(where[0]) - MARGIN, int(where[-1]) - MARGIN
    return max(0, first - 1), min(len(touched) - 2 * MARGIN, last + 2)


def _add(fine: FineBlock, look: Look, sight: Sight, weight: Raster, cell_m: float) -> None:
    """Add a view's weighted brightness to a block, where the view counts for something."""
    top, bottom, left, right = _part(weight)
    if not (bottom > top and right > left):
        return
    ratio = fine.shape[1] // (weight.shape[0] - 2 * MARGIN)
    wide = (slice(top, bottom + 2 * MARGIN), slice(left, right + 2 * MARGIN))
    width = np.sqrt(sight.density[wide]) * np.float32(cell_m)
    level = np.log2(np.maximum(width, 1))
    levels = _finer(level, ratio) if level.any() else None
    sample, line, share = (_finer(r[wide], ratio) for r in (sight.sample, sight.line, weight))
    part = fine[:, top * ratio : bottom * ratio, left * ratio : right * ratio]
    for number, band in enumerate(part):
        cv2.accumulateProduct(look.brightness(sample, line, levels, number), share, band)


def _without_hidden(fine: FineBlock, patch: Patch, shared: Shares, ratio: int) -> FineBlock:
    """NaN where the ground was not seen or is not shown, and full weight at the edges of that."""
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
