"""Planes fitted to a terrain model around every cell: gradient, scatter and their certainty.

Around every cell a plane h = a + g_e e + g_n n is fitted by least squares to the cells with an
elevation inside a square window, whose side is the baseline over which slope is felt. With the
weights m = 1 where there is an elevation, and e, n counted from the middle of the window, all
sums are convolutions of m, m h and their moments, and the normal equations

    | S_1  S_e  S_n  | | a   |   | S_h  |
    | S_e  S_ee S_en | | g_e | = | S_eh |
    | S_n  S_en S_nn | | g_n |   | S_nh |

are solved in every cell at once: exact on tilted planes, whatever cells are missing. With the
centred sums C_xy = S_xy - S_x S_y / S_1 the elevations scatter around the plane by

    s^2 = (C_hh - g_e C_eh - g_n C_nh) / (S_1 - 3)

and errors of the cells with the mean variance v, of which k neighbours share one, give the gradient
the covariance k v C^-1.

The raster is worked through block by block with the window's margin, each from its own mean plane:
memory does not grow with the map, and single precision keeps a tenth of a millimetre anywhere.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Bool, Float32, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

Gradients = Float32[np.ndarray, "2 rows cols"]
"""Rise per metre towards east and towards north; NaN where no plane could be fitted."""
Shapes = Float32[np.ndarray, "3 rows cols"]
"""C_ee, C_en, C_nn of the cells that a plane was fitted to, square metres."""

LEAST_SPREAD = 0.02
"""Second moment of the cells used, along their thinnest direction, over that of a full window. A
strip of cells a seventh as wide as the window is the least that holds a plane."""
BLOCK = 256
"""Side of the blocks in cells: what is worked on fits a processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """The planes around every cell."""

    gradient: Gradients
    scatter: Raster
    """Standard deviation of the elevations from the plane, metres."""
    shape: Shapes


def gradients(
    elevation: Raster, cell_m: float, baseline_m: float, min_share: float = 0.5
) -> Gradients:
    """Gradient of the plane through the cells of a window of side `baseline_m` around each cell."""
    half = _half_window(elevation.shape, cell_m, baseline_m)
    found = np.full((2, *elevation.shape), np.nan, np.float32)
    for block in _blocks(elevation, half):
        sums = _Sums.of(elevation[block.around], half, min_share)
        found[(slice(None), *block.own)] = sums.gradient[(slice(None), *block.inner)]
    return found / np.float32(cell_m)


def fit_planes(
    elevation: Raster, cell_m: float, baseline_m: float, min_share: float = 0.5
) -> PlaneFit:
    """The same planes with their scatter, and the shape of the cells they were fitted to."""
    half = _half_window(elevation.shape, cell_m, baseline_m)
    gradient, shape, scatter = (
        np.full((*bands, *elevation.shape), np.nan, np.float32) for bands in ((2,), (3,), ())
    )
    for block in _blocks(elevation, half):
        sums = _Sums.of(elevation[block.around], half, min_share)
        gradient[(slice(None), *block.own)] = sums.gradient[(slice(None), *block.inner)]
        shape[(slice(None), *block.own)] = sums.shape[(slice(None), *block.inner)]
        scatter[block.own] = sums.scatter()[block.inner]
    return PlaneFit(gradient / np.float32(cell_m), scatter, shape * np.float32(cell_m**2))


def window_mean(values: Raster, cell_m: float, baseline_m: float) -> Raster:
    """Mean over the same windows of what is known; NaN where nothing is."""
    half = _half_window(values.shape, cell_m, baseline_m)
    known = np.isfinite(values)
    side = (2 * half + 1, 2 * half + 1)
    total, count = (
        cv2.boxFilter(part, cv2.CV_32F, side, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for part in (np.where(known, values, np.float32(0)), known.astype(np.float32))
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0, total / count, np.float32(np.nan)).astype(np.float32)


def window_cells(grid: MapGrid, baseline_m: float) -> int:
    """Cells that a window reaches to either side."""
    return _half_window(grid.shape, grid.cell_m, baseline_m)


def _half_window(shape: tuple[int, ...], cell_m: float, baseline_m: float) -> int:
    """Cells on either side of the middle one.

    Raises:
        TerrainError: the window is larger than the terrain model.
    """
    half = max(1, round((baseline_m / cell_m - 1) / 2))
    if 2 * half + 1 > min(shape) * 2:
        raise TerrainError(
            f"a baseline of {baseline_m} m is {2 * half + 1} cells of {cell_m} m, but the terrain "
            f"model has only {shape}: take a shorter baseline"
        )
    return half


@dataclass(frozen=True, slots=True)
class _Block:
    """A part of a raster, with the margin that its windows reach into."""

    own: tuple[slice, slice]
    around: tuple[slice, slice]
    inner: tuple[slice, slice]
    """The part's own cells in what is around it."""


def _blocks(elevation: Raster, half: int) -> Iterator[_Block]:
    """The blocks with an elevation."""
    rows, cols = elevation.shape
    for top, left in itertools.product(range(0, rows, BLOCK), range(0, cols, BLOCK)):
        bottom, right = min(top + BLOCK, rows), min(left + BLOCK, cols)
        above, before = max(0, top - half), max(0, left - half)
        block = _Block(
            (slice(top, bottom), slice(left, right)),
            (slice(above, bottom + half), slice(before, right + half)),
            (slice(top - above, bottom - above), slice(left - before, right - before)),
        )
        if np.isfinite(elevation[block.own]).any():
            yield block


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Centred sums over the windows of one block, lengths in cells."""

    bent: Gradients
    """Gradient over that of the block's mean plane."""
    trend: Float32[np.ndarray, "2 1 1"]
    """Gradient of the block's mean plane."""
    shape: Shapes
    count: Raster
    height: Raster
    """Elevation over the block's mean plane; 0 where unknown."""
    half: int
    rise: tuple[Raster, Raster, Raster]
    """S_h, C_eh and C_nh."""

    @classmethod
    def of(cls, elevation: Raster, half: int, min_share: float) -> _Sums:
        known = np.isfinite(elevation)
        trend, rest = _detrended(elevation, known)
        m, h = known.astype(np.float32), np.where(known, rest, np.float32(0))
        S_1, S_e, S_n = (_moment(m, half, powers) for powers in ((0, 0), (1, 0), (0, 1)))
        S_ee, S_en, S_nn = (_moment(m, half, powers) for powers in ((2, 0), (1, 1), (0, 2)))
        S_h, S_eh, S_nh = (_moment(h, half, powers) for powers in ((0, 0), (1, 0), (0, 1)))
        with np.errstate(invalid="ignore", divide="ignore"):
            C_ee, C_en, C_nn = S_ee - S_e**2 / S_1, S_en - S_e * S_n / S_1, S_nn - S_n**2 / S_1
            C_eh, C_nh = S_eh - S_e * S_h / S_1, S_nh - S_n * S_h / S_1
            determinant = C_ee * C_nn - C_en**2
            bent = np.stack([C_nn * C_eh - C_en * C_nh, C_ee * C_nh - C_en * C_eh]) / determinant
            thinnest = (C_ee + C_nn) / 2 - np.sqrt((C_ee - C_nn) ** 2 / 4 + C_en**2)
        window = 2 * half + 1
        full = window * window * (window * window - 1) / 12
        fits = known & (S_1 / window**2 >= min_share) & (thinnest > LEAST_SPREAD * full)
        bent[:, ~fits] = np.nan
        return cls(bent, trend, np.stack([C_ee, C_en, C_nn]), S_1, h, half, (S_h, C_eh, C_nh))

    @property
    def gradient(self) -> Gradients:
        """Rise a cell towards east and north."""
        return self.bent + self.trend

    def scatter(self) -> Raster:
        """Standard deviation from the plane."""
        S_h, C_eh, C_nh = self.rise
        S_hh = _moment(self.height**2, self.half, (0, 0))
        with np.errstate(invalid="ignore", divide="ignore"):
            C_hh = S_hh - S_h**2 / self.count
            left = C_hh - self.bent[0] * C_eh - self.bent[1] * C_nh
            return np.sqrt(np.maximum(left, 0) / (self.count - 3))


def _detrended(
    elevation: Raster, known: Bool[np.ndarray, "rows cols"]
) -> tuple[Float32[np.ndarray, "2 1 1"], Raster]:
    """Gradient of the mean plane, rise a cell to east and north, and what lies over that plane."""
    row, col = np.argwhere(known).T
    some = slice(None, None, max(1, len(row) // 1000))
    row, col = row[some], col[some]
    sums = np.column_stack([np.ones(len(row)), col, row])
    level, east, south = np.linalg.lstsq(sums, elevation[row, col].astype(np.float64))[0]
    down = np.arange(elevation.shape[0], dtype=np.float32)[:, None]
    right = np.arange(elevation.shape[1], dtype=np.float32)[None, :]
    plane = np.float32(level) + np.float32(east) * right + np.float32(south) * down
    return np.array([east, -south], np.float32).reshape(2, 1, 1), elevation - plane


def _moment(values: Raster, half: int, powers: tuple[int, int]) -> Raster:
    """Sum of values times e^a n^b over the window around every cell, in cells; north is up."""
    steps = np.arange(-half, half + 1, dtype=np.float32)
    return cv2.sepFilter2D(
        values,
        cv2.CV_32F,
        steps ** powers[0],
        (-steps) ** powers[1],
        borderType=cv2.BORDER_CONSTANT,
    )
