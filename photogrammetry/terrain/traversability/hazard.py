"""Hazards: where a rover may stand, and the kind of hazard elsewhere.

As in GESTALT, the hazard avoidance of the Mars Exploration Rovers (Goldberg, Maimone and Matthies
2002; Biesiadecki and Maimone 2006): cells of about 0.2 m, and around each a window as large as the
rover, 13 such cells, in which three quantities are evaluated,

- tilt: the slope of the plane fitted to the window;
- step: the largest difference in height, within a wheel's diameter and over that plane, anywhere in
  the window;
- roughness: the standard deviation of the heights from that plane.

Each is divided by its limit; the rover may be here if the largest ratio is at most 1, otherwise its
quantity is the kind of hazard. A window with too few known cells is UNKNOWN, unless those are a
hazard already; so is ground whose elevations are too uncertain to detect a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Classes, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.planes import Gradients, fit_window_planes
from solmap.photogrammetry.ranges import CellSize, Metres, Share, ShortMetres, Slope
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.parts import Terrain, seen_parts
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.dtm.resampling import (
    CoarseRaster,
    coarse_grid,
    coarse_means,
    repeat,
)


class Hazard(IntEnum):
    """Class of a cell, for a rover with its middle in the cell."""

    UNKNOWN = 0
    """Too few cells are known, or too uncertain."""
    TRAVERSABLE = 1
    """All quantities are within their limits."""
    ROUGH = 2
    """The ground deviates too much from a plane."""
    STEP = 3
    """There is a step higher than a wheel can climb."""
    STEEP = 4
    """The rover would tilt too much."""


@dataclass(frozen=True, slots=True)
class HazardParams:
    """Size of the rover, and its limits."""

    window_m: ShortMetres = 2.6
    """Side of the rover-sized window: GESTALT's 13 cells of 0.2 m. MER is 1.6 by 2.3 m."""
    steepest_deg: Slope = 20.0
    """Largest tilt. MER was designed to be safe up to 30 degrees, but slips on loose ground
    long before; steeper slopes were driven with visual odometry only (Maimone, Cheng and
    Matthies 2007)."""
    highest_step_m: Metres = 0.2
    """Highest step: MER's suspension climbs rocks as high as a wheel's diameter, 0.26 m."""
    roughest_m: Metres = 0.1
    """Largest standard deviation from the plane: a third of MER's ground clearance, 0.3 m."""
    wheel_m: ShortMetres = 0.26
    """Diameter of a wheel: height differences within it are steps."""
    min_share: Share = 0.7
    """Least known fraction of the window: more than half of the rover."""
    cell_m: CellSize = 0.16
    """Side of a cell; GESTALT's are 0.2 m, which is not a power of two times the map's finest
    cell."""

    def __post_init__(self) -> None:
        limits = (self.steepest_deg, self.highest_step_m, self.roughest_m)
        if not all(limit > 0 for limit in limits):
            raise TerrainError(
                f"hazard limits must be above zero, not {limits} (degrees, metres, metres)"
            )


def hazards(terrain: Terrain, params: HazardParams) -> tuple[Classes, MapGrid]:
    """A `Hazard` for every cell of a coarser grid, and that grid."""
    grid = coarse_grid(terrain.grid, params.cell_m)
    margin = math.ceil(params.window_m / grid.cell_m)  # a step half a window off, and its plane
    codes = np.zeros(grid.shape, np.uint8)
    for part in seen_parts(terrain, margin * grid.cell_m):
        cell_m = max(grid.cell_m, part.grid.cell_m)
        factor = round(cell_m / part.grid.cell_m)
        found = _classify_part(part.dtm, factor, replace(params, cell_m=cell_m))
        inner = tuple(slice(side.start // factor, -(-side.stop // factor)) for side in part.inner)
        row = round((grid.north - part.grid.north) / grid.cell_m)
        col = round((part.grid.west - grid.west) / grid.cell_m)
        own = repeat(found[inner], round(cell_m / grid.cell_m))
        codes[row : row + len(own), col : col + own.shape[1]] = own
    return codes, grid


def _classify_part(dtm: Dtm, factor: int, params: HazardParams) -> Classes:
    """The hazards of a part of a terrain model, in cells `factor` times as wide."""
    rows, cols = (-(-count // factor) for count in dtm.grid.shape)
    place = MapGrid(dtm.grid.west, dtm.grid.north, params.cell_m, rows, cols)

    def mean(layer: Raster) -> CoarseRaster:
        return coarse_means(layer, dtm.grid, place)[1]

    sigma_m = mean(dtm.sigma_m)
    if dtm.pose_sigma_m is not None:  # errors common to all cells cause no steps
        sigma_m = np.sqrt(np.maximum(sigma_m**2 - mean(dtm.pose_sigma_m) ** 2, 0))
    return classify_cells(mean(dtm.elevation), sigma_m, params)


def classify_cells(elevation: Raster, sigma_m: Raster, params: HazardParams) -> Classes:
    """A `Hazard` for every cell of a terrain model of `cell_m`."""
    fit = fit_window_planes(elevation, params.cell_m, params.window_m, params.min_share / 2)
    tilt = np.degrees(np.arctan(np.hypot(fit.gradient[0], fit.gradient[1])))
    step = _over_the_window(step_heights(elevation, fit.gradient, params), params)
    ratios = np.stack(
        [
            fit.scatter / np.float32(params.roughest_m),
            step / np.float32(params.highest_step_m),
            tilt / np.float32(params.steepest_deg),
        ]
    )
    kinds = np.array([Hazard.ROUGH, Hazard.STEP, Hazard.STEEP], np.uint8)
    worst = np.nan_to_num(ratios, nan=-1.0)
    found = np.where(
        worst.max(axis=0) > 1, kinds[worst.argmax(axis=0)], np.uint8(Hazard.TRAVERSABLE)
    )
    well_seen = _share_seen(elevation, params) >= params.min_share
    certain = sigma_m <= params.highest_step_m / 3
    is_known = np.isfinite(ratios).all(axis=0) & well_seen
    doubtful = ~certain | ((found == Hazard.TRAVERSABLE) & ~is_known)
    return np.where(np.isfinite(elevation) & ~doubtful, found, np.uint8(Hazard.UNKNOWN))


def step_heights(elevation: Raster, gradient: Gradients, params: HazardParams) -> Raster:
    """Largest height difference over the rover's plane within a wheel's diameter."""
    reach = math.ceil(params.wheel_m / params.cell_m - 1e-9)
    east, north = (part * np.float32(params.cell_m) for part in gradient)
    padded = np.pad(elevation, reach, constant_values=np.nan)
    rows, cols = elevation.shape
    highest = np.zeros_like(elevation)
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            if 0 < math.hypot(down, right) <= reach:
                there = padded[reach + down :, reach + right :][:rows, :cols]
                rise = there - elevation - east * np.float32(right) + north * np.float32(down)
                highest = np.fmax(highest, np.abs(rise))
    return np.where(np.isfinite(elevation), highest, np.float32(np.nan))


def _over_the_window(values: Raster, params: HazardParams) -> Raster:
    """Largest known value within half a window."""
    side = 2 * max(1, round((params.window_m / params.cell_m - 1) / 2)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    largest = cv2.dilate(np.nan_to_num(values, nan=-1.0), disc)
    return np.where(largest >= 0, largest, np.float32(np.nan))


def _share_seen(elevation: Raster, params: HazardParams) -> Raster:
    side = 2 * max(1, round((params.window_m / params.cell_m - 1) / 2)) + 1
    known = np.isfinite(elevation).astype(np.float32)
    return cv2.boxFilter(known, cv2.CV_32F, (side, side), borderType=cv2.BORDER_CONSTANT)
