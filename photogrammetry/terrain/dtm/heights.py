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
    continuous_quads,
    ground_points,
    largest_step_px,
    mesh_samples,
    quad_corners,
    trusted_parallax,
)
from solmap.photogrammetry.terrain.dtm.records import TerrainView

STEEP = 1.7
"""Gradient of 60 degrees: scatter of a cell by a slope as steep as this is not a second level."""
SPLITS = 4
"""Most repetitions: one sixteenth of the points remains then."""
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
    step_px = largest_step_px(view.geometry.base_m, params)
    quads = continuous_quads(planes, parallax, step_px, params.max_gap_m)
    np.copyto(planes, np.float32(np.nan), where=~quad_corners(quads, parallax.shape))
    camera = camera_on_map(view.lsl_from_pair)
    window = _Window.around(planes, camera, cell_m)
    trusted = np.isfinite(planes[0])
    points = planes[:, trusted]
    noise = params.sigma_parallax_px / parallax[trusted] * np.abs(points[2])
    cell_of_point = window.cells(points)
    count, mean, scatter = _upper_levels(cell_of_point, points[2], noise, window)
    sigma_px = _sigma_of_cells(cell_of_point, _sigma_px(view, params)[trusted], window)
    unmeasured = count == 0
    filled = np.zeros(window.size)
    filled_mean, sag = np.zeros(window.size), np.zeros(window.size)
    for samples in mesh_samples(planes, quads, cell_m / SAMPLES_A_CELL) if meshed else ():
        cells = window.cells(samples.points)
        open_ = unmeasured[cells]
        cells = cells[open_]
        filled += np.bincount(cells, minlength=window.size)
        filled_mean += np.bincount(cells, samples.points[2][open_], minlength=window.size)
        sag += np.bincount(cells, samples.sag_m[open_], minlength=window.size)
    seen = np.flatnonzero(count + filled > 0)
    many = np.maximum(1, filled[seen])
    measured = count[seen] > 0
    row, col = np.divmod(seen, window.cols)
    return ViewHeights(
        row=row + window.row,
        col=col + window.col,
        height=camera[2] + np.where(measured, mean[seen], filled_mean[seen] / many),
        points=count[seen].astype(np.float32),
        scatter=scatter[seen].astype(np.float32),
        sigma_px=sigma_px[seen].astype(np.float32),
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
    def size(self) -> int:
        return self.rows * self.cols

    def cells(self, points: Float32[np.ndarray, "3 n"]) -> np.ndarray:
        """The cell of every point, counted along the rows of the window."""
        col = (points[0] / np.float32(self.cell_m) + np.float32(self.camera_east)).astype(np.int32)
        row = (np.float32(self.camera_south) - points[1] / np.float32(self.cell_m)).astype(np.int32)
        return row * np.int32(self.cols) + col


def _sigma_px(view: TerrainView, params: SightParams) -> ParallaxMap:
    """Standard deviation of every parallax: from matching, or the parameter's for all."""
    if view.sigma_px is not None:
        return view.sigma_px
    return np.full(view.parallax.shape, params.sigma_parallax_px, dtype=np.float32)


def _sigma_of_cells(cells: np.ndarray, sigma_px: np.ndarray, window: _Window) -> np.ndarray:
    """Root mean square over the points of every cell; over the whole view where there are none."""
    count = np.bincount(cells, minlength=window.size)
    squares = np.bincount(cells, sigma_px**2, minlength=window.size)
    everywhere = float(np.mean(sigma_px**2)) if len(sigma_px) else 0.0
    return np.sqrt(np.where(count > 0, squares / np.maximum(1, count), everywhere))


def _upper_levels(
    cells: np.ndarray, height: np.ndarray, noise: np.ndarray, window: _Window
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Number, mean and scatter of the points of every cell's upper level."""
    size = window.size
    count, mean, scatter = _statistics(cells, height, size)
    with np.errstate(invalid="ignore", divide="ignore"):
        noise = np.bincount(cells, noise, minlength=size) / count
    allowed = np.hypot(2 * noise, STEEP * window.cell_m / np.sqrt(12))
    for _ in range(SPLITS):
        mixed = scatter > allowed
        chosen = mixed[cells]
        if not chosen.any():
            break
        cells, height = cells[chosen], height[chosen]
        upper = height > mean[cells]
        cells, height = cells[upper], height[upper]
        parts = _statistics(cells, height, size)
        split = parts[0] > 0
        count, mean, scatter = (
            np.where(split, part, whole)
            for part, whole in zip(parts, (count, mean, scatter), strict=True)
        )
    return count, mean, scatter


def _statistics(
    cells: np.ndarray, height: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Number, mean and standard deviation of the heights in every cell."""
    count = np.bincount(cells, minlength=size)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.nan_to_num(np.bincount(cells, height, minlength=size) / count)
        off = height - mean[cells]
        variance = np.nan_to_num(np.bincount(cells, off**2, minlength=size) / count)
    return count, mean, np.sqrt(variance)
