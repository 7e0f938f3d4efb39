"""The heights of map cells from one view.

Points of the view are sorted into cells. Where their heights scatter by more than noise and a steep
slope explain, the cell contains two levels, and only the upper part is kept: the points above their
mean, repeatedly until the remaining scatter is explained.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64, ParallaxMap
from solmap.photogrammetry.terrain.dtm.ground import (
    SightParams,
    camera_on_map,
    continuous_ground,
    ground_points,
    trusted_parallax,
)
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.kernels import (
    Lattice,
    cells_of_mesh,
    upper_levels,
    without_isolated,
)

STEEP = 1.7
"""Gradient of 60 degrees: scatter of a cell by a slope as steep as this is not a second level."""
SAMPLES_A_CELL = 1.5
"""Mesh samples along the side of a cell: with the square root of two or more, every square inside a
lattice has one at any rotation."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewHeights:
    """Cells of a view, one row per cell.

    Rows and columns count cells from the origin of the map, south and east.
    """

    row: np.ndarray
    col: np.ndarray
    height: Float64[np.ndarray, " n"]
    """Elevation, metres."""
    points: Float32[np.ndarray, " n"]
    """Matched points in the cell; none where only the mesh covers it."""
    scatter: Float32[np.ndarray, " n"]
    """Standard deviation of the heights of these points, metres."""
    sigma_px: Float32[np.ndarray, " n"]
    """Standard deviation of the parallax of one match in the cell, pixels."""
    sag: Float32[np.ndarray, " n"]
    """Length over which the ground may deviate from the mesh, metres; 0 with points."""

    def __len__(self) -> int:
        return len(self.row)


def view_heights(
    view: TerrainView, params: SightParams, cell_m: float, *, meshed: bool = True
) -> ViewHeights:
    """The heights of map cells from `view`; only those with points if not meshed.

    An isolated pixel is left out: it is a blunder, or belongs to ground so far away that the gap to
    the next is too wide to be bridged.
    """
    parallax = trusted_parallax(view, params)
    planes = ground_points(view, parallax, params)
    squares = continuous_ground(planes, parallax, view, params)
    planes = without_isolated(planes, squares)
    camera = camera_on_map(view.lsl_from_pair)
    window = _Window.around(planes, camera, cell_m)
    noise_px = np.float32(params.sigma_parallax_px)
    slope_m = STEEP * cell_m / np.sqrt(12)
    sigma_px, lattice = _sigma_px(view, params), window.lattice
    measured = upper_levels(planes, parallax, sigma_px, lattice, noise_px, slope_m)
    count, mean, scatter, square_px = measured
    everywhere = float(np.mean(sigma_px[np.isfinite(planes[0])] ** 2)) if count.any() else 0.0
    filled, filled_sum, sag = np.zeros((3, window.rows * window.cols))
    if meshed:
        spacing_m = np.float32(cell_m / SAMPLES_A_CELL)
        filled, filled_sum, sag = cells_of_mesh(planes, squares, measured, lattice, spacing_m)
    seen = np.flatnonzero(count + filled > 0)
    many = np.maximum(1, filled[seen])
    has_points = count[seen] > 0
    row, col = np.divmod(seen, window.cols)
    return ViewHeights(
        row=row + window.row,
        col=col + window.col,
        height=camera[2] + np.where(has_points, mean[seen], filled_sum[seen] / many),
        points=count[seen].astype(np.float32),
        scatter=scatter[seen].astype(np.float32),
        sigma_px=np.sqrt(np.where(has_points, square_px[seen], everywhere)).astype(np.float32),
        sag=(sag[seen] / many).astype(np.float32),
    )


@dataclass(frozen=True, slots=True)
class _Window:
    """The part of the map's lattice in a view, and the camera's position on it, in cells."""

    row: int
    col: int
    rows: int
    cols: int
    camera_east: float
    camera_south: float
    cell_m: float

    @classmethod
    def around(cls, planes: np.ndarray, camera: np.ndarray, cell_m: float) -> _Window:
        if not np.isfinite(planes[0]).any():
            return cls(0, 0, 0, 0, 0.0, 0.0, cell_m)
        east, south = camera[0] / cell_m, -camera[1] / cell_m
        col = int(np.floor(east + np.nanmin(planes[0]) / cell_m)) - 1
        row = int(np.floor(south - np.nanmax(planes[1]) / cell_m)) - 1
        cols = int(np.floor(east + np.nanmax(planes[0]) / cell_m)) + 2 - col
        rows = int(np.floor(south - np.nanmin(planes[1]) / cell_m)) + 2 - row
        return cls(row, col, rows, cols, east - col, south - row, cell_m)

    @property
    def lattice(self) -> Lattice:
        """The window as compiled loops use it."""
        east, south = np.float32(self.camera_east), np.float32(self.camera_south)
        return self.rows, self.cols, np.float32(self.cell_m), east, south


def _sigma_px(view: TerrainView, params: SightParams) -> ParallaxMap:
    """Standard deviation of every parallax: from matching, or the parameter's for all."""
    if view.sigma_px is not None:
        return view.sigma_px
    return np.full(view.parallax.shape, params.sigma_parallax_px, dtype=np.float32)
