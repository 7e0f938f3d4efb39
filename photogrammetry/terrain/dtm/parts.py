"""Terrain models in parts: those that hold elevations, with the margin that a window needs.

A region with far ground has fifty million cells, few of which are known, and most of these repeat
larger ones. What is computed from it part by part takes memory and time for the known ones only, in
cells that show all there is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np

from solmap.photogrammetry.arrays import Int32, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.dtm.resampling import (
    CoarseRaster,
    FineRaster,
    coarse_grid,
    coarse_means,
    finer,
)

STRIP = 2
"""Rows of blocks in a part: 35 MB at a stop's width."""
TINY = 1e-9
"""Rounding of a margin in cells."""
Window = tuple[slice, slice]
"""Rows and columns."""


@runtime_checkable
class Terrain(Protocol):
    """A terrain model that can be read in parts: a `Dtm`, or a file."""

    @property
    def grid(self) -> MapGrid:
        """Grid of the whole model."""
        ...

    def block_steps(self) -> Int32[np.ndarray, "block_rows block_cols"]:
        """Side of the largest cells that show all of a block, in cells; 0 without elevations."""
        ...

    def part(self, rows: slice, cols: slice) -> Dtm:
        """A window of the model; with a step, in cells that many times as wide."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A part of a terrain model and the margin around it."""

    own: Window
    """Its cells in the whole model."""
    inner: Window
    """Place of the block in `dtm`."""
    dtm: Dtm
    step: int
    """Side of the cells of `dtm`, in cells of the whole model."""

    @property
    def grid(self) -> MapGrid:
        """The grid of its own part of `dtm`."""
        return self.dtm.grid.window(*self.inner)

    def own_values(self, values: Raster) -> FineRaster:
        """Its own cells of the whole model, of values in those of `dtm`."""
        rows, cols = (slice(side.start * self.step, side.stop * self.step) for side in self.inner)
        return finer(values, self.step)[rows, cols]


def seen_parts(terrain: Terrain, margin_m: float = 0.0) -> Iterator[Part]:
    """The parts that together hold all elevations, with a margin around each.

    A part is a run of blocks in some rows; it begins and ends on whole blocks.
    """
    (rows, cols), steps = terrain.grid.shape, terrain.block_steps()
    for first in range(0, len(steps), STRIP):
        top, bottom = first * BLOCK, min((first + STRIP) * BLOCK, rows)
        for start, stop, step in _runs(_finest(steps[first : first + STRIP])):
            left, right = start * BLOCK, min(stop * BLOCK, cols)
            margin = step * math.ceil(margin_m / (step * terrain.grid.cell_m) - TINY)
            above, before = max(0, top - margin), max(0, left - margin)
            around = (
                slice(above, min(bottom + margin, rows), step),
                slice(before, min(right + margin, cols), step),
            )
            dtm = terrain.part(*around)
            inner = (
                slice((top - above) // step, -((above - bottom) // step)),
                slice((left - before) // step, -((before - right) // step)),
            )
            if np.isfinite(dtm.elevation[inner]).any():
                yield Part((slice(top, bottom), slice(left, right)), inner, dtm, step)


def _finest(steps: Int32[np.ndarray, "block_rows block_cols"]) -> Int32[np.ndarray, " block_cols"]:
    """The finest steps in some rows of blocks; 0 where none has an elevation."""
    unseen = np.iinfo(steps.dtype).max
    finest = np.where(steps > 0, steps, unseen).min(axis=0)
    return np.where(finest < unseen, finest, 0)


def _runs(steps: Int32[np.ndarray, " n"]) -> Iterator[tuple[int, int, int]]:
    """Start, end and step of every run of equal steps above 0."""
    ends = np.flatnonzero(np.diff(np.r_[0, steps, 0])).tolist()
    for start, stop in pairwise(ends):
        if steps[start]:
            yield start, stop, int(steps[start])


def coarse_elevation(terrain: Terrain, cell_m: float) -> tuple[CoarseRaster, MapGrid]:
    """Mean elevation of larger cells, and their grid; NaN where too few cells are known."""
    coarse = coarse_grid(terrain.grid, cell_m)
    whole = np.full(coarse.shape, np.nan, np.float32)
    for part in seen_parts(terrain):
        own, means = coarse_means(part.dtm.elevation, part.grid, coarse)
        whole[own] = means
    return whole, coarse


def manageable_cell_m(terrain: Terrain, cell_m: float, most_cells: int) -> float:
    """`cell_m`, doubled until the measured part of a terrain model fits `most_cells`.

    Raises:
        TerrainError: nothing was measured.
    """
    spans = [_span(part) for part in seen_parts(terrain)]
    if not spans:
        raise TerrainError("the terrain model has no elevations: see the log of its run")
    top, left = np.min([span[:2] for span in spans], axis=0)
    bottom, right = np.max([span[2:] for span in spans], axis=0)
    area_m2 = float((bottom - top) * (right - left)) * terrain.grid.cell_m**2
    while area_m2 > most_cells * cell_m**2:
        cell_m *= 2
    return cell_m


def _span(part: Part) -> tuple[int, int, int, int]:
    """First row and column with an elevation, and those after the last."""
    known = np.isfinite(part.dtm.elevation[part.inner])
    rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    top, left = part.own[0].start, part.own[1].start
    return (
        top + int(rows[0]) * part.step,
        left + int(cols[0]) * part.step,
        top + (int(rows[-1]) + 1) * part.step,
        left + (int(cols[-1]) + 1) * part.step,
    )
