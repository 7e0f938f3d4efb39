"""Map grids: cells of the local metric map, aligned so that map tiles need no resampling.

The map of a landing site is the tangent plane at the lander: east = y, north = x and up = -z of
the LSL. All grids of a site share one lattice. Cells measure 0.01 m times a power of two, and grids
start and end on whole blocks of 256 cells, which are the tiles of the site's tile matrix set.

A grid's origin is the outer north-west corner of its first cell; the centre of cell (row, col) lies
at east = west + (col + 1/2) cell, north = north - (row + 1/2) cell.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from solmap.photogrammetry.arrays import Float64, ObjectPoints
from solmap.photogrammetry.errors import TerrainError

BLOCK = 256
"""Cells along the side of a block, which is one tile."""
FINEST_CELL_M = 0.01

Bounds: TypeAlias = tuple[float, float, float, float]
"""(west, south, east, north)."""


def union(boxes: Iterable[Bounds]) -> Bounds:
    """The smallest bounds around all of some.

    Raises:
        ValueError: there are no bounds.
    """
    west, south, east, north = zip(*boxes, strict=True)
    return min(west), min(south), max(east), max(north)


def overlap(one: Bounds, other: Bounds) -> bool:
    """Whether two bounds have an area in common."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


@dataclass(frozen=True, slots=True)
class MapGrid:
    """Position of a raster on the map of the landing site, metres."""

    west: float
    north: float
    cell_m: float
    rows: int
    cols: int

    def __post_init__(self) -> None:
        if self.rows < 1 or self.cols < 1 or not self.cell_m > 0:
            raise TerrainError(f"a map grid of {self.rows} x {self.cols} cells of {self.cell_m} m")

    @classmethod
    def covering(cls, bounds: Bounds, cell_m: float) -> MapGrid:
        """The smallest grid of whole blocks around (west, south, east, north).

        Raises:
            TerrainError: `cell_m` is not 0.01 m times a power of two, or the bounds are empty.
        """
        level = math.log2(cell_m / FINEST_CELL_M)
        if abs(level - round(level)) > 1e-6:  # noqa: PLR2004 - rounding of a decimal fraction
            raise TerrainError(f"a cell of {cell_m} m is not 0.01 m times a power of two")
        west, south, east, north = bounds
        if not (east > west and north > south):
            raise TerrainError(f"the bounds {bounds} are empty")
        block_m = BLOCK * cell_m
        first_col, last_col = math.floor(west / block_m), math.ceil(east / block_m)
        first_row, last_row = math.floor(south / block_m), math.ceil(north / block_m)
        return cls(
            west=first_col * block_m,
            north=last_row * block_m,
            cell_m=cell_m,
            rows=(last_row - first_row) * BLOCK,
            cols=(last_col - first_col) * BLOCK,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.rows, self.cols

    @property
    def bounds(self) -> Bounds:
        """(west, south, east, north), metres."""
        return (
            self.west,
            self.north - self.rows * self.cell_m,
            self.west + self.cols * self.cell_m,
            self.north,
        )

    def centres(self) -> tuple[Float64[np.ndarray, " cols"], Float64[np.ndarray, " rows"]]:
        """East of every column and north of every row, at cell centres."""
        east = self.west + (np.arange(self.cols) + 0.5) * self.cell_m
        north = self.north - (np.arange(self.rows) + 0.5) * self.cell_m
        return east, north

    def cells_of(
        self, points_in_lsl: ObjectPoints
    ) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
        """Fractional (row, col) of LSL points; whole numbers are cell centres."""
        row = (self.north - points_in_lsl[:, 0]) / self.cell_m - 0.5
        col = (points_in_lsl[:, 1] - self.west) / self.cell_m - 0.5
        return row, col

    def cell_at(self, east: float, north: float) -> tuple[int, int] | None:
        """(row, col) of the cell at a position, metres of the local map; None off the grid."""
        row = math.floor((self.north - north) / self.cell_m)
        col = math.floor((east - self.west) / self.cell_m)
        return (row, col) if 0 <= row < self.rows and 0 <= col < self.cols else None

    def window(self, rows: slice, cols: slice) -> MapGrid:
        """The grid of a window of this one; with a step, in cells that many times as wide."""
        step = rows.step or 1
        shape = (-(-(side.stop - side.start) // step) for side in (rows, cols))
        return replace(self.part(rows.start, cols.start, *shape), cell_m=self.cell_m * step)

    def divided(self, factor: int) -> MapGrid:
        """The grid of `factor` times finer cells."""
        size = (self.cell_m / factor, self.rows * factor, self.cols * factor)
        return MapGrid(self.west, self.north, *size)

    def part(self, row: int, col: int, rows: int, cols: int) -> MapGrid:
        """The grid of a window of this one."""
        return MapGrid(
            self.west + col * self.cell_m, self.north - row * self.cell_m, self.cell_m, rows, cols
        )
