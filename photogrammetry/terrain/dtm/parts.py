"""Terrain models in parts: those that hold elevations, with the margin that a window needs.

A region with far ground has fifty million cells, few of which are known. What is computed from it
part by part takes memory and time for these only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from solmap.photogrammetry.arrays import Bool
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.dtm.resampling import CoarseRaster, coarse_grid, place_means

STRIP = 2
"""Rows of blocks in a part: 35 MB at a stop's width."""
Window = tuple[slice, slice]
"""Rows and columns."""


@runtime_checkable
class Terrain(Protocol):
    """A terrain model that can be read in parts: a `Dtm`, or a file."""

    @property
    def grid(self) -> MapGrid:
        """Grid of the whole model."""
        ...

    def seen_blocks(self) -> Bool[np.ndarray, "block_rows block_cols"]:
        """The blocks that may hold elevations."""
        ...

    def part(self, rows: slice, cols: slice) -> Dtm:
        """A window of the model."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A part of a terrain model and the margin around it."""

    own: Window
    """Its cells in the whole model."""
    inner: Window
    """Place of the block in `dtm`."""
    dtm: Dtm

    @property
    def grid(self) -> MapGrid:
        """The grid of its own cells."""
        (rows, cols) = self.inner
        shape = (rows.stop - rows.start, cols.stop - cols.start)
        return self.dtm.grid.part(rows.start, cols.start, *shape)


def seen_parts(terrain: Terrain, margin: int = 0) -> Iterator[Part]:
    """The parts that together hold all elevations, with `margin` cells around each.

    A part is a run of blocks in some rows; it begins and ends on whole blocks.
    """
    (rows, cols), seen = terrain.grid.shape, terrain.seen_blocks()
    for first in range(0, len(seen), STRIP):
        top, bottom = first * BLOCK, min((first + STRIP) * BLOCK, rows)
        for start, stop in _runs(np.any(seen[first : first + STRIP], axis=0)):
            left, right = start * BLOCK, min(stop * BLOCK, cols)
            above, before = max(0, top - margin), max(0, left - margin)
            around = (
                slice(above, min(bottom + margin, rows)),
                slice(before, min(right + margin, cols)),
            )
            dtm = terrain.part(*around)
            inner = slice(top - above, bottom - above), slice(left - before, right - before)
            if np.isfinite(dtm.elevation[inner]).any():
                yield Part((slice(top, bottom), slice(left, right)), inner, dtm)


def _runs(flags: Bool[np.ndarray, " n"]) -> Iterator[tuple[int, int]]:
    """Start and end of every run of true flags."""
    changes = np.flatnonzero(np.diff(np.r_[False, flags, False])).tolist()
    return zip(changes[::2], changes[1::2], strict=True)


def coarse_elevation(terrain: Terrain, cell_m: float) -> tuple[CoarseRaster, MapGrid]:
    """Mean elevation of larger cells, and their grid; NaN where too few cells are known."""
    coarse = coarse_grid(terrain.grid, cell_m)
    whole = np.full(coarse.shape, np.nan, np.float32)
    for part in seen_parts(terrain):
        place_means(whole, coarse, part.dtm.elevation, part.grid)
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
        top + int(rows[0]),
        left + int(cols[0]),
        top + int(rows[-1]) + 1,
        left + int(cols[-1]) + 1,
    )
