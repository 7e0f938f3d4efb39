"""Triangulate a grid with few right triangles, within a stated error; holes are preserved.

A right-triangulated irregular network (Evans, Kirkpatrick & Townsend 2001): a square is two right
triangles, and a right triangle is split at the middle of its longest side into two. With squares of
side s = 2^j the middles are in turn

    A_j: middles of squares, on one diagonal        B_j: middles of the squares' sides

    coarse  A_k, B_k, A_k-1, B_k-1, ... A_1, B_1  fine          (2^k: side of the root squares)

where the diagonal joins the corners whose row + column, counted in s, is even. The two triangles on
either side of a longest side are split together, so that there are no cracks. Splitting at v
requires the four vertices of the next coarser level; this is ensured by raising each error to at
least those of its dependents (Lindstrom & Pascucci 2002).

The error is exact rather than estimated: for every level the grid is interpolated from the vertices
above that level, which on right triangles is repeated halving, and the error of v is the largest
distance, at any grid point that v represents, between that surface and the grid. A triangle that is
kept is therefore nowhere farther than the tolerance from the grid points inside it.

A square of four neighbouring grid points is a hole when its corners are not one surface. Triangles
that cover both squares and holes are split down to single squares, and the holes are removed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Bool, Float32, Int32, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.kernels import errors_of_triangles

ROOT_LEVELS = 8
"""Side of the root squares as a power of two: 256 points, one block of a map."""


@dataclass(frozen=True, slots=True, eq=False)
class GridMesh:
    """Triangles between points of a grid."""

    row: Int32[np.ndarray, " n"]
    col: Int32[np.ndarray, " n"]
    triangles: Int32[np.ndarray, "m 3"]
    """Vertices of every triangle, counter-clockwise where columns run right and rows down."""

    def __len__(self) -> int:
        return len(self.triangles)


@dataclass(frozen=True, slots=True, eq=False)
class RightTriangles:
    """A grid prepared for triangulation with any tolerance."""

    levels: int
    """The root squares' side is 2^levels."""
    error: Float32[np.ndarray, "points_down points_across"]
    """Largest deviation of the surface when the triangles around this point are not split at it."""
    whole: Bool[np.ndarray, "squares_down squares_across"]
    """Squares between four neighbouring points that are ground and not holes."""

    @classmethod
    def of(
        cls,
        values: Raster,
        whole: Bool[np.ndarray, "squares_down squares_across"] | None = None,
        levels: int = ROOT_LEVELS,
    ) -> RightTriangles:
        """Prepare a grid of values, from which errors are computed; NaN where nothing was measured.

        Args:
            values: Elevation, parallax or another quantity that is linear over a plane.
            whole: Squares that are one surface; all by default, except those with a NaN.
            levels: The root squares' side as a power of two.
        """
        known = np.isfinite(values)
        four = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
        if whole is not None:
            four &= whole
        side = 1 << levels
        down, across = (-(-max(1, n - 1) // side) * side for n in values.shape)
        grid = np.zeros((down + 1, across + 1), dtype=np.float32)
        grid[: values.shape[0], : values.shape[1]] = np.where(known, values, np.float32(0))
        squares = np.zeros((down, across), dtype=np.bool_)
        squares[: four.shape[0], : four.shape[1]] = four
        return cls(levels, errors_of_triangles(grid, squares, levels), squares)

    @property
    def roots(self) -> tuple[int, int]:
        """Number of root squares down and across."""
        return self.whole.shape[0] >> self.levels, self.whole.shape[1] >> self.levels

    def mesh(
        self, tolerance: float, roots: tuple[slice, slice] = (slice(None), slice(None))
    ) -> GridMesh:
        """The fewest of these triangles that deviate by no more than `tolerance`.

        Args:
            tolerance: In the unit of the grid's values.
            roots: Root squares to include, down and across; all by default.
        """
        if not tolerance > 0:
            raise TerrainError(f"a mesh needs a tolerance above zero, not {tolerance}")
        kept = []
        error = self.error.ravel()
        corners = self._root_triangles(roots)
        for _ in range(2 * self.levels):
            middle = (corners[0] + corners[1]) // 2
            split = error[middle] > tolerance
            kept.append(corners[:, ~split])
            a, b, c = corners[:, split]
            middle = middle[split]
            corners = np.stack([[c, b], [a, c], [middle, middle]]).reshape(3, -1)
        return self._compact(np.concatenate([*kept, corners], axis=1))

    def _root_triangles(self, roots: tuple[slice, slice]) -> np.ndarray:
        """Places (a, b, c) of two triangles per root square; a to b is the longest side."""
        down, across = (np.arange(n)[part] for n, part in zip(self.roots, roots, strict=True))
        i, j = (one.ravel() for one in np.meshgrid(down, across, indexing="ij"))
        falling = (i + j) % 2 == 0
        nw, ne = np.stack([i, j]), np.stack([i, j + 1])
        sw, se = np.stack([i + 1, j]), np.stack([i + 1, j + 1])
        first = np.where(falling, np.stack([nw, se, ne]), np.stack([sw, ne, nw]))
        second = np.where(falling, np.stack([se, nw, sw]), np.stack([ne, sw, se]))
        row, col = np.concatenate([first, second], axis=2).swapaxes(0, 1) << self.levels
        return row * self.error.shape[1] + col

    def _compact(self, corners: np.ndarray) -> GridMesh:
        """Triangles except those over holes, and the points that they use."""
        width = self.error.shape[1]
        row, col = (part.sum(axis=0) // 3 for part in np.divmod(corners, width))
        corners = corners[:, self.whole[row, col]]  # a square inside: also the corners of one
        first = corners.min(initial=self.error.size)
        number = np.zeros(corners.max(initial=first) - first + 1, np.int32)
        number[corners - first] = 1
        used = np.flatnonzero(number)
        number[used] = np.arange(len(used), dtype=np.int32)
        row, col = np.divmod(used + first, width)
        triangles = number[corners - first].T
        return GridMesh(
            row.astype(np.int32), col.astype(np.int32), np.ascontiguousarray(triangles, np.int32)
        )
