"""Viewsheds and sight lines: ground visible from a viewpoint.

Elevations are sampled along rays from the viewpoint in steps of a cell; at the largest distance
rays are a cell apart. Along a ray, a target at the distance d and the height z above the viewpoint
is hidden if nearer ground has a larger elevation angle,

    max over r < d of  z(r) / r   >   z(d) / d

so one running maximum per ray gives the visibility of all its cells (O(cells) in total; like sweeps
and R2, Franklin and Ray 1994, on rays of equal angle). A cell gets the visibility of the nearest
ray, which passes within half a cell of its centre. The map's plane is level: the planet's curvature
hides 1 mm at 80 m.

Unknown ground hides nothing; a target beyond a long stretch of it is UNKNOWN, unless known ground
hides it. The unknown ground around the viewpoint does not count, because the mast is higher.

A sight line is the straight line from a viewpoint to a single target, compared with the ground h(s)
below it. It is

    blocked     where known ground reaches above it,
    doubtful    where it passes a long stretch of unknown ground,

and free otherwise. The clearance is the smallest height of the line over known ground. Blocking
ground takes precedence over unknown ground, as in viewsheds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Classes, Float32, Float64, Int32, PerPoint, Raster, Vector3
from solmap.photogrammetry.ranges import CellSize, MapCells, Metres, MetresOrZero
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.parts import manageable_cell_m
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.dtm.resampling import MapPoints, coarsen

Rays = Float32[np.ndarray, "rays steps"]
"""Values along rays from the viewpoint, one row per ray."""


OCCLUDED_SHARE = 0.5
"""Fraction of a cell that must be occluded for a cell without elevation to be hidden."""
NEAR_M = 0.3
"""Distance from either end within which ground does not block."""


class Sight(IntEnum):
    """Visibility of a cell of the map."""

    UNKNOWN = 0
    """Ground without elevation, or behind a long stretch of unknown ground."""
    VISIBLE = 1
    """No known ground hides it."""
    HIDDEN = 2
    """Known ground hides it, or it is occluded from the stop's own cameras."""


@dataclass(frozen=True, slots=True)
class ViewshedParams:
    """Parameters of visibility: heights, and the treatment of unknown ground."""

    eye_height_m: Metres = 1.5
    """Height of the viewpoint above the ground, if not given by a camera: the mast of MER."""
    target_height_m: MetresOrZero = 0.1
    """Height of the target above the ground: a stone, and three times a terrain model's noise."""
    max_unseen_m: MetresOrZero = 4.0
    """Longest stretch of unknown ground over which a target counts as visible: twice as long as the
    shadow of a rock of 0.1 m at 30 m from a mast."""
    radius_m: Metres = 100.0
    """Farthest target: beyond the reach of a stop's terrain model."""
    cell_m: CellSize = 0.16
    """Side of a cell: smaller objects hide no relevant ground."""
    most_cells: MapCells = 4_000_000
    """Most cells, 200 MB: for larger areas the cells are doubled. A stop has 0.2 million."""


def viewshed_of_stop(dtm: Dtm, eye: Vector3, params: ViewshedParams) -> tuple[Classes, MapGrid]:
    """A `Sight` for every cell of a coarser grid, from a stop's own viewpoint, and that grid.

    The stop's cameras were at the viewpoint. Ground that they measured is therefore visible, even
    beyond long unknown stretches, unless it is no higher than nearer ground; and occluded cells of
    its terrain model are hidden.
    """
    cell_m = manageable_cell_m(dtm, params.cell_m, params.most_cells)
    elevation, grid = coarsen(dtm.elevation, dtm.grid, cell_m)
    sight = viewshed(elevation, grid, eye, params)
    occluded = (dtm.ground == GroundClass.OCCLUDED).astype(np.float32)
    share, _ = coarsen(occluded, dtm.grid, cell_m)
    is_hidden = (share > OCCLUDED_SHARE) & ~np.isfinite(elevation)
    down, right = _offsets(grid, eye)
    within = np.hypot(down, right) <= params.radius_m / grid.cell_m
    measured = np.isfinite(elevation) & within & (sight == Sight.UNKNOWN)
    sight[measured] = Sight.VISIBLE
    sight[is_hidden & within] = Sight.HIDDEN
    return sight, grid


def viewshed(elevation: Raster, grid: MapGrid, eye: Vector3, params: ViewshedParams) -> Classes:
    """A `Sight` for every cell of a terrain model, from a viewpoint (east, north, up)."""
    down, right = _offsets(grid, eye)
    distance: Raster = np.hypot(down, right)
    height = elevation - np.float32(eye[2])
    inside = np.isfinite(height) & (distance <= params.radius_m / grid.cell_m)
    sight = np.zeros(elevation.shape, np.uint8)
    if not inside.any():
        return sight
    steps = math.ceil(float(distance[inside].max()))
    count = 4 * math.ceil(2 * math.pi * steps / 4)
    along = _along_rays(height, (-float(down[0, 0]), -float(right[0, 0])), count, steps)
    ray, step = _nearest(down[inside], right[inside], distance[inside], count)
    target = height[inside] + np.float32(params.target_height_m)
    tangent = target / np.maximum(distance[inside], np.float32(0.5))
    is_near = step < 0
    hidden = (_highest(along)[ray, step] > tangent) & ~is_near
    doubtful = (_longest_unseen(along)[ray, step] * grid.cell_m > params.max_unseen_m) & ~is_near
    sight[inside] = np.where(
        hidden, Sight.HIDDEN, np.where(doubtful, Sight.UNKNOWN, Sight.VISIBLE)
    ).astype(np.uint8)
    return sight


def _offsets(grid: MapGrid, eye: Vector3) -> Float32[np.ndarray, "2 rows cols"]:
    """Cells by which every cell is south and east of the viewpoint."""
    row, col = grid.cells_of(np.array([[eye[1], eye[0], 0.0]]))
    indices: Float32[np.ndarray, "2 rows cols"] = np.indices(grid.shape, dtype=np.float32)
    return indices - np.array([row, col], np.float32).reshape(2, 1, 1)


def _along_rays(height: Raster, centre: tuple[float, float], count: int, steps: int) -> Rays:
    """Height above the viewpoint at whole cells along `count` rays; NaN where unknown."""
    known = np.isfinite(height)
    azimuth = (2 * np.pi / count * np.arange(count, dtype=np.float32))[:, None]
    away = np.arange(1, steps + 1, dtype=np.float32)[None, :]
    rows = np.float32(centre[0]) - away * np.cos(azimuth)
    cols = np.float32(centre[1]) + away * np.sin(azimuth)

    def sample(values: Raster) -> Rays:
        return cv2.remap(values, cols, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)

    weight = sample(known.astype(np.float32))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sample(np.where(known, height, np.float32(0))) / weight
    return np.where(weight > 0.5, mean, np.float32(np.nan))  # noqa: PLR2004 - most of it is known


def _highest(along: Rays) -> Rays:
    """Largest tangent up to and including every step."""
    away = np.arange(1, along.shape[1] + 1, dtype=np.float32)
    return np.maximum.accumulate(np.nan_to_num(along / away, nan=-np.inf), axis=1)


def _longest_unseen(along: Rays) -> Int32[np.ndarray, "rays steps"]:
    """Steps of the longest stretch of unknown ground so far, after the first known ground."""
    step = np.arange(along.shape[1], dtype=np.int32)
    last = np.maximum.accumulate(np.where(np.isfinite(along), step, np.int32(-1)), axis=1)
    gap = np.where(last >= 0, step - last, 0)
    return np.maximum.accumulate(gap, axis=1).astype(np.int32)


def _nearest(
    down: Float32[np.ndarray, " n"],
    right: Float32[np.ndarray, " n"],
    distance: Float32[np.ndarray, " n"],
    count: int,
) -> tuple[np.ndarray, np.ndarray]:
    """The nearest ray of every target, and its last nearer step; -1 beside the viewpoint."""
    ray = np.rint(np.arctan2(right, -down) * np.float32(count / (2 * np.pi))).astype(np.int64)
    return ray % count, np.floor(distance - 0.5).astype(np.int64) - 1


@dataclass(frozen=True, slots=True, eq=False)
class SightLine:
    """The line between a viewpoint and a target, and the ground below it."""

    sight: Sight
    distance_m: PerPoint
    """Distance of stations from the viewpoint on the map."""
    places: MapPoints
    line_m: PerPoint
    """Elevation of the line."""
    ground_m: PerPoint
    """Elevation of the ground; NaN where unknown."""
    clearance_m: float | None
    """Least height over known ground; None where none is known."""
    obstruction: int | None
    """The station where the line is farthest below the ground, if it is anywhere."""
    unseen_m: float
    """Longest stretch of unknown ground that the line passes."""


def sight_line_stations(eye: Vector3, target: Vector3, step_m: float) -> MapPoints:
    """Stations on the map from a viewpoint to a target, both (east, north, up), ends included."""
    length = float(np.hypot(*(target - eye)[:2]))
    share = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / step_m)) + 1))
    return eye[:2] + share[:, None] * (target - eye)[:2]


def sight_line(
    eye: Vector3,
    target: Vector3,
    places: MapPoints,
    ground_m: PerPoint,
    max_unseen_m: float,
) -> SightLine:
    """Visibility of a target from a viewpoint, by the ground at `sight_line_stations`."""
    share = np.linspace(0.0, 1.0, len(places))
    length = float(np.hypot(*(target - eye)[:2]))
    distance, line = share * length, eye[2] + share * (target - eye)[2]
    counts = (distance > NEAR_M) & (distance < length - NEAR_M)
    room = np.where(counts & np.isfinite(ground_m), line - ground_m, np.inf)
    lowest = int(np.argmin(room))
    clearance = float(room[lowest]) if np.isfinite(room[lowest]) else None
    unseen = _longest(distance, np.isfinite(ground_m))
    blocked = clearance is not None and clearance < 0
    sight = Sight.HIDDEN if blocked else Sight.UNKNOWN if unseen > max_unseen_m else Sight.VISIBLE
    obstruction = lowest if blocked else None
    return SightLine(sight, distance, places, line, ground_m, clearance, obstruction, unseen)


def _longest(distance: PerPoint, known: np.ndarray) -> float:
    """Longest stretch without known ground, after the first known ground.

    The unknown ground around the viewpoint does not count, because the mast is higher.
    """
    stations: Float64[np.ndarray, " k"] = distance[known]
    if not len(stations):
        return float(distance[-1])
    return float(np.diff(np.append(stations, distance[-1])).max())
