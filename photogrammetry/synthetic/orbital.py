"""The orbital image of a simulated world: coarse, under another sun, its georeference off.

What the image claims to be at p truly lies at R p + (east, north), R a turn anticlockwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import GreyImage
from solmap.photogrammetry.synthetic.lattice import Nodes, Window, node_distance_m, stream_of
from solmap.photogrammetry.synthetic.lighting import Sun, ground_radiance
from solmap.photogrammetry.synthetic.scene import World
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

CELL_M = 0.25
"""Cell size, that of HiRISE."""
MARGIN_M = 60.0
"""Ground beyond what the stops see that the image shows."""
MOST_CELLS = 2048
"""Most cells along a side; the image of a longer traverse has larger cells."""
AFTERNOON = Sun(float(np.deg2rad(285.0)), float(np.deg2rad(40.0)))
"""Time of day at which mapping orbiters pass: 15:00."""
NOISE = 0.01
"""Standard deviation of the noise; the ground's radiance is about 0.9, its own deviation 0.07."""


@dataclass(frozen=True, slots=True)
class GeoreferenceError:
    """How far off an image's georeference is."""

    east_m: float
    north_m: float
    rotation_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class OrbitalMosaic:
    """An image, where it claims to lie, and how that is wrong."""

    grid: MapGrid
    brightness: GreyImage
    error: GeoreferenceError


def orbital_mosaic(world: World) -> OrbitalMosaic:
    """A world as imaged from orbit; its position has an error of 3 to 6 m and up to 0.5 degrees."""
    rng = stream_of(world.seed, 106)
    bearing, far_m = rng.uniform(0, 2 * np.pi), rng.uniform(3.0, 6.0)
    east_m, north_m = float(far_m * np.sin(bearing)), float(far_m * np.cos(bearing))
    error = GeoreferenceError(east_m, north_m, float(rng.uniform(-0.5, 0.5)))
    grid = _grid_around(world.bounds)
    window = _window_of(grid)
    patch = world.terrain.patch(window)
    radiance = ground_radiance(patch.elevation, window.cell_m, AFTERNOON) * patch.albedo
    seen = resampled(radiance, window, grid, turn(error.rotation_deg), (east_m, north_m))
    noise = np.float32(NOISE) * rng.standard_normal(grid.shape, np.float32)
    return OrbitalMosaic(grid, seen + noise, error)


def turn(rotation_deg: float) -> np.ndarray:
    """The matrix that turns (east, north) anticlockwise."""
    c, s = math.cos(math.radians(rotation_deg)), math.sin(math.radians(rotation_deg))
    return np.array([[c, -s], [s, c]])


def resampled(
    nodes: Nodes,
    window: Window,
    grid: MapGrid,
    matrix: np.ndarray,
    shift_m: tuple[float, float] | np.ndarray,
) -> GreyImage:
    """Mean of the nodes over the cells of a grid, each taken at `matrix` (east, north) + shift."""
    blurred = cv2.GaussianBlur(nodes, (0, 0), 0.5 * grid.cell_m / window.cell_m)
    east, north = grid.centres()
    at_east = matrix[0, 0] * east[None, :] + matrix[0, 1] * north[:, None] + shift_m[0]
    at_north = matrix[1, 0] * east[None, :] + matrix[1, 1] * north[:, None] + shift_m[1]
    rows, cols = window.nodes_of(at_north, at_east)
    return cv2.remap(blurred, cols.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR)


def _grid_around(bounds: tuple[float, float, float, float]) -> MapGrid:
    west, south, east, north = bounds
    wide, high = east - west + 2 * MARGIN_M, north - south + 2 * MARGIN_M
    coarser = max(0, math.ceil(math.log2(max(wide, high) / (CELL_M * MOST_CELLS))))
    cell_m = CELL_M * 2**coarser
    rows, cols = math.ceil(high / cell_m), math.ceil(wide / cell_m)
    return MapGrid(west - MARGIN_M, north + MARGIN_M, cell_m, rows, cols)


def _window_of(grid: MapGrid) -> Window:
    """Nodes no coarser than the cells, around all that the shifted and turned grid may show."""
    level = math.floor(math.log2(grid.cell_m / node_distance_m(0)))
    west, south, east, north = grid.bounds
    half_m = max(abs(west), abs(south), abs(east), abs(north))
    reach_m = 8.0 + math.radians(0.5) * half_m
    return Window.covering(
        level,
        np.array([south - reach_m, north + reach_m]),
        np.array([west - reach_m, east + reach_m]),
    )
