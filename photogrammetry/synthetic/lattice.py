"""Windows of an endless lattice, and fractal relief that does not depend on the window.

Nodes of level k are 0.02 m * 2^k apart, at whole multiples of that from the LSL origin. A fractal
is made from coarse to fine: the nodes of level k + 1 are subdivided as a cubic B-spline (the
binomial kernel 1 4 6 4 1 on every second node), and every new node is displaced at random,

    z_k = subdivide(z_{k+1}) + sigma_k n_k,        sigma_k = sigma (cell_k / 1 m)^H

which is successive random addition (Saupe 1988) with Hurst exponent H. The numbers n_k come from
blocks of nodes, each with its own random stream, so that windows computed at different times for
different stops have the same ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64
from solmap.photogrammetry.errors import TerrainError

FINEST_NODE_M = 0.02
"""Node distance of level 0: about ten Navcam pixels at 2 m, one at 20 m."""
COARSEST = 13
"""Coarsest level of a fractal: 164 m."""
NOISE_BLOCK = 128
"""Nodes along the side of a block with one random stream."""

Nodes = Float32[np.ndarray, "rows cols"]
"""One value per node; rows run north, columns east."""


def node_distance_m(level: int) -> float:
    """Distance between neighbouring nodes of a level, metres."""
    return FINEST_NODE_M * 2**level


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of nodes: row i, column j is at (first_row + i, first_col + j) cells."""

    level: int
    first_row: int
    first_col: int
    rows: int
    cols: int

    def __post_init__(self) -> None:
        if self.rows < 2 or self.cols < 2:  # noqa: PLR2004 - one cell
            raise TerrainError(f"a window of {self.rows} x {self.cols} nodes contains no cell")

    @classmethod
    def around(cls, level: int, north: float, east: float, half_m: float) -> Window:
        """The square window of half side `half_m` around a point, plus one cell."""
        cell_m = node_distance_m(level)
        half = math.ceil(half_m / cell_m) + 1
        row, col = round(north / cell_m), round(east / cell_m)
        return cls(level, row - half, col - half, 2 * half + 1, 2 * half + 1)

    @classmethod
    def covering(cls, level: int, north: np.ndarray, east: np.ndarray) -> Window:
        """The smallest window around points."""
        cell_m = node_distance_m(level)
        row, col = math.floor(north.min() / cell_m), math.floor(east.min() / cell_m)
        rows = math.floor(north.max() / cell_m) - row + 2
        return cls(level, row, col, rows, math.floor(east.max() / cell_m) - col + 2)

    @property
    def cell_m(self) -> float:
        """Distance between neighbouring nodes, metres."""
        return node_distance_m(self.level)

    @property
    def north(self) -> Float64[np.ndarray, " rows"]:
        """North of every row, metres."""
        return (self.first_row + np.arange(self.rows)) * self.cell_m

    @property
    def east(self) -> Float64[np.ndarray, " cols"]:
        """East of every column, metres."""
        return (self.first_col + np.arange(self.cols)) * self.cell_m

    def nodes_of(self, north: np.ndarray, east: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fractional (row, col) of points."""
        return north / self.cell_m - self.first_row, east / self.cell_m - self.first_col


def bilinear(values: Nodes, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Values between nodes, in double precision; NaN outside the window."""
    rows, cols = values.shape
    inside = (row >= 0) & (row <= rows - 1) & (col >= 0) & (col <= cols - 1)
    i = np.clip(np.nan_to_num(row).astype(np.int64), 0, rows - 2)
    j = np.clip(np.nan_to_num(col).astype(np.int64), 0, cols - 2)
    u, v = row - i, col - j
    south = values[i, j] * (1 - v) + values[i, j + 1] * v
    north = values[i + 1, j] * (1 - v) + values[i + 1, j + 1] * v
    return np.where(inside, south * (1 - u) + north * u, np.nan)


@dataclass(frozen=True, slots=True)
class Fractal:
    """Random relief (or mottling) with its own power law."""

    seed: int
    stream: int
    """Distinguishes relief from mottling of the same seed."""
    sigma: float
    """Standard deviation of the displacement at nodes 1 m apart."""
    hurst: float

    def values(self, window: Window) -> Nodes:
        """The fractal at the nodes of a window."""
        displacement = self.displacement(window)
        if window.level < COARSEST:
            displacement += subdivide(self.values(parent_window(window)), window)
        return displacement

    def displacement(self, window: Window) -> Nodes:
        """The random part that the window's level adds to subdivided nodes of the coarser one."""
        values = np.empty((window.rows, window.cols), np.float32)
        last_row, last_col = window.first_row + window.rows, window.first_col + window.cols
        for i in range(window.first_row // NOISE_BLOCK, -(-last_row // NOISE_BLOCK)):
            for j in range(window.first_col // NOISE_BLOCK, -(-last_col // NOISE_BLOCK)):
                row, col = i * NOISE_BLOCK - window.first_row, j * NOISE_BLOCK - window.first_col
                block = self._block(window.level, i, j)[max(0, -row) :, max(0, -col) :]
                target = values[max(0, row) : row + NOISE_BLOCK, max(0, col) : col + NOISE_BLOCK]
                target[:] = block[: target.shape[0], : target.shape[1]]
        values *= np.float32(self.sigma * window.cell_m**self.hurst)
        return values

    def _block(self, level: int, row: int, col: int) -> Nodes:
        rng = stream_of(self.seed, self.stream, level, row, col)
        return rng.standard_normal((NOISE_BLOCK, NOISE_BLOCK), dtype=np.float32)


def stream_of(*key: int) -> np.random.Generator:
    """Random numbers for a key of whole numbers, independent of any others drawn before."""
    return np.random.Generator(np.random.SFC64([part % 2**32 for part in key]))


def parent_window(window: Window) -> Window:
    """The window of the next coarser level from which a window is subdivided."""
    return Window(
        window.level + 1,
        window.first_row // 2 - 1,
        window.first_col // 2 - 1,
        window.rows // 2 + 4,
        window.cols // 2 + 4,
    )


def subdivide(coarse: Nodes, window: Window) -> Float32[np.ndarray, "fine_rows fine_cols"]:
    """Cubic B-spline subdivision of the nodes of `parent(window)` to those of `window`."""
    fine = cv2.pyrUp(coarse)
    row = window.first_row - 2 * (window.first_row // 2 - 1)
    col = window.first_col - 2 * (window.first_col // 2 - 1)
    return fine[row : row + window.rows, col : col + window.cols]
