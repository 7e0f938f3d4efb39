"""Loops over the pixels of a pair that sum up its ground on level grids, compiled.

Level frame: (north, east, down) from the rover, metres. Grids are square, row 0 is the
northernmost, the rover central. `camera` is (f B in pixel metres, f in pixels, principal point by
sample and line), `rotation` (3, 3) and `origin` (3) transform from the pair to the level frame.
Every second column is used: on the ground, columns are far closer than rows.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.compiled import compiled

CAMERA, GRID = ("per_point", "points", "per_point"), ("float64", "float64", "int64")

ROVER_M = 1.5
"""What is nearer to the rover's origin may be the rover itself, which looks alike at all stops."""

GRADIENT_PX = 3
"""Pixels to each side over which the parallax of a facet is differenced."""

LEAST_FACING = 0.1
"""Least sine of the angle at which a facet must be seen: that of level ground at 15 m; further away
that of level ground there."""

DENSE_M = 8.0
"""Nearer than this every second line is used."""


@compiled()
def _along(axis: np.ndarray, x: float, y: float) -> float:
    """Component along an axis of the ray to a pixel, over its forward component."""
    return axis[0] * x + axis[1] * y + axis[2]


@compiled()
def _cell(north: float, east: float, grid: tuple[float, float, int]) -> int:
    """Index of the cell of a place, row by row; negative outside the grid and near the rover."""
    cell_m, radius_m, size = grid
    row = int(np.floor((radius_m - north) / cell_m))
    col = int(np.floor((radius_m + east) / cell_m))
    if row < 0 or row >= size or col < 0 or col >= size:
        return -1
    if north * north + east * east <= ROVER_M * ROVER_M:
        return -1
    return row * size + col


@compiled(("image", "mask", "image"), *CAMERA, "float64", GRID)
def sum_ground(
    rasters: tuple[np.ndarray, np.ndarray, np.ndarray],
    camera: np.ndarray,
    rotation: np.ndarray,
    origin: np.ndarray,
    least_px: float,
    grid: tuple[float, float, int],
) -> np.ndarray:
    """Sum up the points of a pair in the cells of the level plane of its stop.

    Args:
        rasters: Parallax in pixels, NaN where there is none; usable pixels; the left image, all of
            shape (lines, samples).
        camera: (4,), pixel metres and pixels.
        rotation: (3, 3), level frame from pair.
        origin: (3,), the left camera in the level frame, metres.
        least_px: Parallax of the farthest ground, pixels.
        grid: Side of a cell, and distance of the borders from the rover, in metres; number of rows
            and columns.

    Returns:
        (3, cells): number, sum of grey values, sum of metres above the rover.
    """
    parallax, mask, grey = rasters
    sums = np.zeros((3, grid[2] * grid[2]))
    for line in range(parallax.shape[0]):
        y = (line - camera[3]) / camera[1]
        for sample in range(0, parallax.shape[1], 2):
            p = parallax[line, sample]
            if not (p > least_px and mask[line, sample]):
                continue
            x, z = (sample - camera[2]) / camera[1], camera[0] / p
            north = _along(rotation[0], x, y) * z + origin[0]
            east = _along(rotation[1], x, y) * z + origin[1]
            cell = _cell(north, east, grid)
            if cell >= 0:
                sums[0, cell] += 1
                sums[1, cell] += grey[line, sample]
                sums[2, cell] -= _along(rotation[2], x, y) * z + origin[2]
    return sums


@compiled("image", *CAMERA, "float64", GRID)
def sum_heights(
    parallax: np.ndarray,
    camera: np.ndarray,
    rotation: np.ndarray,
    origin: np.ndarray,
    farthest_m: float,
    grid: tuple[float, float, int],
) -> np.ndarray:
    """Weights, one over the squared range, and weighted elevations of points that are not crests.

    A point of parallax p on the ray (x, y, 1) / f is in range and faces the camera where p exceeds
    a limit that depends on the ray and, for facing, on the slope of the parallax. What is compared
    with the heights so summed is described in `surface_alignment`.

    Args:
        parallax: (lines, samples), pixels; NaN where there is none.
        camera: (4,), pixel metres and pixels.
        rotation: (3, 3), level frame from pair.
        origin: (3,), the left camera in the level frame, metres.
        farthest_m: Largest range, metres.
        grid: Side of a cell, and distance of the borders from the rover, in metres; number of rows
            and columns.

    Returns:
        (2, cells): sum of weights, one per square metre; sum of these times metres above the rover.
    """
    sums = np.zeros((2, grid[2] * grid[2]))
    k, focal = GRADIENT_PX, camera[1]
    for line in range(k, parallax.shape[0] - k):
        v = line - camera[3]
        y = v / focal
        most_px = camera[0] / DENSE_M if line % 2 else np.inf
        for sample in range(k + k % 2, parallax.shape[1] - k, 2):
            p, u = parallax[line, sample], sample - camera[2]
            x = u / focal
            ray = np.sqrt(1 + x * x + y * y)
            if not (camera[0] / farthest_m * ray < p < most_px):
                continue
            across = (parallax[line, sample + k] - parallax[line, sample - k]) / (2 * k)
            down = (parallax[line + k, sample] - parallax[line - k, sample]) / (2 * k)
            at_centre = p - across * u - down * v
            steep = np.sqrt(focal * focal * (across * across + down * down) + at_centre * at_centre)
            if not p > min(LEAST_FACING * ray, _along(rotation[2], x, y)) * steep:
                continue
            z = camera[0] / p
            north = _along(rotation[0], x, y) * z + origin[0]
            east = _along(rotation[1], x, y) * z + origin[1]
            cell = _cell(north, east, grid)
            if cell >= 0:
                weight = 1 / (z * ray) ** 2
                sums[0, cell] += weight
                sums[1, cell] -= weight * (_along(rotation[2], x, y) * z + origin[2])
    return sums
