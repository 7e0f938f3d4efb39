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


@compiled(("image", "image"), *CAMERA, "float64", GRID)
def sum_facets(
    rasters: tuple[np.ndarray, np.ndarray],
    camera: np.ndarray,
    rotation: np.ndarray,
    origin: np.ndarray,
    farthest_m: float,
    grid: tuple[float, float, int],
) -> np.ndarray:
    """Weights, one over the squared range, and weighted elevations and grey values of facets.

    A point of parallax p on the ray (x, y, 1) / f is in range and faces the camera where p exceeds
    a limit that depends on the ray and, for facing, on the slope of the parallax: crests are left
    out. What is compared with these sums is described in `surface_alignment`.

    Args:
        rasters: Parallax in pixels, NaN where there is none, and the left image, both of shape
            (lines, samples).
        camera: (4,), pixel metres and pixels.
        rotation: (3, 3), level frame from pair.
        origin: (3,), the left camera in the level frame, metres.
        farthest_m: Largest range, metres.
        grid: Side of a cell, and distance of the borders from the rover, in metres; number of rows
            and columns.

    Returns:
        (3, cells): sum of weights, one per square metre; sums of these times metres above the
        rover, and times grey values.
    """
    parallax, grey = rasters
    sums = np.zeros((3, grid[2] * grid[2]))
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
                sums[2, cell] += weight * grey[line, sample]
    return sums


@compiled("image", "image", "points", "per_point", ("float64", "float64", "float64"))
def height_differences(
    earlier: np.ndarray,
    later: np.ndarray,
    rotation: np.ndarray,
    shift: np.ndarray,
    limits: tuple[float, float, float],
) -> np.ndarray:
    """Elevations of the earlier stop above those of the later one, on the grid of the latter.

    NaN where either is unknown or where one stop sees the place from much further away.

    Args:
        earlier: (size, size), metres above the rover, interpolated between known cells.
        later: (size, size), the same of the later stop.
        rotation: (3, 3), earlier level frame from later one.
        shift: (3,), the same, metres.
        limits: Side of a cell, metres; least weight of known cells; largest ratio of the ranges,
            beyond a metre.
    """
    cell_m, least, ratio = limits
    differences = np.full_like(later, np.nan)
    size, half = later.shape[0], later.shape[0] / 2 - 0.5
    there, middle = earlier.shape[0], earlier.shape[0] / 2 - 0.5
    for row in range(size):
        north = (half - row) * cell_m
        for col in range(size):
            up = later[row, col]
            if not up == up:  # noqa: PLR0124, SIM201 - NaN
                continue
            east = (col - half) * cell_m
            y = rotation[0, 0] * north + rotation[0, 1] * east - rotation[0, 2] * up + shift[0]
            x = rotation[1, 0] * north + rotation[1, 1] * east - rotation[1, 2] * up + shift[1]
            down = rotation[2, 0] * north + rotation[2, 1] * east - rotation[2, 2] * up + shift[2]
            near, far = np.hypot(north, east), np.hypot(x, y)
            if not (far < ratio * near + 1 and near < ratio * far + 1):
                continue
            u, v = x / cell_m + middle, middle - y / cell_m
            i, j = int(np.floor(u)), int(np.floor(v))
            if i < 0 or j < 0 or i >= there - 1 or j >= there - 1:
                continue
            a, b = u - i, v - j
            weight = total = 0.0
            for k in range(4):
                value = earlier[j + k // 2, i + k % 2]
                if value == value:  # noqa: PLR0124 - not NaN
                    part = (a if k % 2 else 1 - a) * (b if k // 2 else 1 - b)
                    weight += part
                    total += part * value
            if weight > least:
                differences[row, col] = total / weight + down
    return differences
