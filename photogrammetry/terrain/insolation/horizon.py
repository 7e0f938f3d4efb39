"""Horizons: elevation angle of the visible skyline, in every direction, from every cell.

Along a line of cells, the horizon of a cell is the next corner of the upper convex hull of the
cells ahead: of two corners, the nearer one is either hidden by the line from the cell to the
farther one or is the horizon (Dozier, Bruno and Downey 1981, A faster solution to the horizon
problem, Computers & Geosciences 7). Every cell enters and leaves the hull once, so a line of n
cells takes O(n) steps and not O(n^2); here the lines of all directions are processed in parallel.

For an azimuth within 45 degrees of north the lines are columns of the raster sheared row by row; in
a row sheared by i + f columns each cell contributes to two lines, with the weights 1 - f and f, and
its horizon is interpolated from both with the same weights. Other azimuths are reduced to this case
by quarter turns.

Unknown ground, and ground beyond the model, is assumed to be below the horizon: the result is a
lower limit. It is never below level.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64, Int32, Raster

Horizons = Float32[np.ndarray, "azimuths rows cols"]
"""Tangent of the horizon's elevation, in equal steps of azimuth from north over east; NaN where the
ground is unknown."""
Lines = Float32[np.ndarray, "rows lines"]
"""Values along lines of sight, which run up the columns."""
LEAST_WEIGHT = 1e-3
"""Distance to the nearest known ground above which a position on a line is unknown."""
AZIMUTHS = 36
"""Number of directions: the sun moves by ten degrees of azimuth in 40 minutes; values between are
interpolated.
"""
BATCH = 6_000_000
"""Cells of sheared rasters processed together: 60 MB with their temporaries."""


def horizons(elevation: Raster, cell_m: float, azimuths: int = AZIMUTHS) -> Horizons:
    """Tangents of the horizon's elevation from every cell, in `azimuths` directions."""
    found = np.empty((azimuths, *elevation.shape), np.float32)
    turns = 2 * math.pi * np.arange(azimuths) / azimuths
    quarter = np.rint(turns / (math.pi / 2)).astype(int)
    for turned in range(4):
        lying = np.flatnonzero(quarter % 4 == turned)
        facing = np.rot90(elevation, turned)
        for some in _batches(lying, facing.shape):
            leaning = turns[some] - quarter[some] * (math.pi / 2)
            tangents = _towards_the_top(facing, leaning.tolist(), cell_m)
            for azimuth, tangent in zip(some, tangents, strict=True):
                found[azimuth] = np.rot90(tangent, -turned)
    np.maximum(found, np.float32(0), out=found)
    found[:, ~np.isfinite(elevation)] = np.nan
    return found


def _batches(
    azimuths: Int32[np.ndarray, " n"] | np.ndarray, shape: tuple[int, ...]
) -> Iterator[np.ndarray]:
    """Directions whose sheared rasters are processed together."""
    rows, cols = shape
    together = max(1, BATCH // (rows * (rows + cols)))
    for first in range(0, len(azimuths), together):
        yield azimuths[first : first + together]


def _towards_the_top(elevation: Raster, leaning: Sequence[float], cell_m: float) -> list[Raster]:
    """Tangents towards azimuths (radians) within 45 degrees of the top row's direction."""
    shears = [_Shear.of(angle, elevation.shape) for angle in leaning]
    known = np.isfinite(elevation)
    level = np.float32(elevation[known].mean()) if known.any() else np.float32(0)
    height, weight = np.where(known, elevation - level, np.float32(0)), known.astype(np.float32)
    lines = np.concatenate([shear.lines(height, weight) for shear in shears], axis=1)
    rise = _rise_to_the_horizon(lines)
    starts = np.cumsum([0, *(shear.width for shear in shears)]).tolist()
    steps = [np.float32(cell_m / math.cos(angle)) for angle in leaning]
    return [
        shear.cells(rise[:, start : start + shear.width]) / step
        for shear, start, step in zip(shears, starts, steps, strict=False)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Shear:
    """Rows moved sideways until a direction runs along columns."""

    whole: tuple[int, ...]
    """Columns by which every row is shifted, rounded down: i."""
    share: tuple[np.float32, ...]
    """Remainder of the shift, f."""
    cols: int

    @classmethod
    def of(cls, angle: float, shape: tuple[int, ...]) -> _Shear:
        rows, cols = shape
        shift = np.arange(rows) * math.tan(angle)
        shift -= shift.min()
        whole = np.floor(shift)
        return cls(
            tuple(whole.astype(int).tolist()), tuple((shift - whole).astype(np.float32)), cols
        )

    @property
    def width(self) -> int:
        """Number of lines."""
        return max(self.whole) + self.cols + 1

    def lines(self, height: Raster, known: Raster) -> Lines:
        """Heights along the lines; NaN where neither cell of a position is known (1, else 0)."""
        total, weight = np.zeros((2, len(self.whole), self.width), np.float32)
        for row, (first, share) in enumerate(zip(self.whole, self.share, strict=True)):
            for start, part in ((first, 1 - share), (first + 1, share)):
                total[row, start : start + self.cols] += height[row] * part
                weight[row, start : start + self.cols] += known[row] * part
        known_here = weight > LEAST_WEIGHT
        np.divide(total, weight, out=total, where=known_here)
        total[~known_here] = np.nan
        return total

    def cells(self, values: Lines) -> Raster:
        """Values of the cells from those of their two lines."""
        found = np.empty((len(self.whole), self.cols), np.float32)
        for row, (first, share) in enumerate(zip(self.whole, self.share, strict=True)):
            one, next_ = values[row, first:][: self.cols], values[row, first + 1 :][: self.cols]
            found[row] = one + share * (next_ - one)
        return found


def _rise_to_the_horizon(height: Lines) -> Lines:
    """Steepest rise per row from every cell of every column to the cells above it; 0 if none.

    `beyond` holds, for every cell, the row of its horizon: followed from the previous cell, it
    gives the corners of the hull from near to far.
    """
    rows, lines = height.shape
    known = np.isfinite(height)
    beyond = np.full((rows, lines), -1, np.int32)
    rise = np.zeros((rows, lines), np.float32)
    nearest = np.full(lines, -1, np.int32)
    for row in range(rows):
        open_ = np.flatnonzero(known[row] & (nearest >= 0))
        here, corner = height[row, open_], nearest[open_]
        slope = (height[corner, open_] - here) / (row - corner)
        rise[row, open_], beyond[row, open_] = _last_corner(
            height, beyond, (row, open_, here), corner, slope
        )
        nearest[known[row]] = row
    return rise


def _last_corner(
    height: Lines,
    beyond: Int32[np.ndarray, "rows lines"],
    seen_from: tuple[int, np.ndarray, np.ndarray],
    corner: Int32[np.ndarray, " n"],
    slope: Float32[np.ndarray, " n"] | Float64[np.ndarray, " n"],
) -> tuple[np.ndarray, np.ndarray]:
    """Rise to the horizon, and its row: along the hull as long as the next corner is higher."""
    row, line, here = seen_from
    active = np.arange(len(line))
    while active.size:
        further = beyond[corner[active], line[active]]
        has_more = further >= 0
        active, further = active[has_more], further[has_more]
        ahead = (height[further, line[active]] - here[active]) / (row - further)
        higher = ahead >= slope[active]
        active = active[higher]
        corner[active], slope[active] = further[higher], ahead[higher]
    return slope, corner
