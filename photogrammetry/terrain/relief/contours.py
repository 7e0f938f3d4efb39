"""Contours of a terrain model.

Contours of the raw model would enclose every pebble and every noisy cell. Elevations are first
averaged with a Gaussian of the size of the smallest relief to be drawn, with zero weight for cells
without elevation (normalised convolution),

    h' = G * (m h) / G * m,      m = 1 where there is an elevation, 0 elsewhere

and h' is valid where at least half of the Gaussian's weight is on known cells: lines stop at
unknown ground and continue across a missing cell or two. Lines are marching squares on h', whose
nodes are kept off the contours' own elevations, so that no two lines touch.

Every line is then simplified separately (Douglas and Peucker 1973: no point moves by more than the
tolerance). Lines that then intersect each other or themselves are simplified again with half the
tolerance, repeatedly, and finally left unchanged; so if the given lines do not intersect, neither
do the returned ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import contourpy
import cv2
import numpy as np
import shapely

from solmap.photogrammetry.arrays import Float32, Float64, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.ranges import (
    ContourInterval,
    Few,
    MetresOrZero,
    Share,
    ShortMetresOrZero,
)
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.parts import Terrain, seen_parts
from solmap.photogrammetry.terrain.dtm.resampling import seen_window

Line = Float64[np.ndarray, "_ 2"]
"""(east, north), metres; the first and last are equal where the line is closed."""
HALVINGS = 4
"""Most halvings of the tolerance of an intersecting line before it is left unchanged."""
STEPS = (1.0, 2.0, 2.5, 5.0)
"""Intervals are one of these times a power of ten."""
LEAST_OFF = 1e-3
"""Least distance of a node's elevation from a contour's, in intervals."""
REACH_SIGMAS = 4.0
"""Standard deviations to which the Gaussian reaches, as OpenCV cuts it off."""
NODES_PER_SIGMA = 2.0
"""Lattice nodes per standard deviation of the Gaussian: finer ones add no detail."""


def simplify_lines(lines: Sequence[Line], tolerance_m: float) -> list[Line]:
    """The lines with as few points as the tolerance allows, in the same order."""
    if not lines or not tolerance_m > 0:
        return list(lines)
    given = np.array([shapely.LineString(line) for line in lines])
    kept = shapely.simplify(given, tolerance_m, preserve_topology=False)
    halved = np.zeros(len(given), dtype=int)
    while True:
        meeting = _intersecting(kept)
        meeting = meeting[halved[meeting] <= HALVINGS]
        if not len(meeting):
            return [shapely.get_coordinates(line) for line in kept]
        halved[meeting] += 1
        for index in meeting:
            kept[index] = _simplify_less(given[index], tolerance_m, int(halved[index]))


def _simplify_less(line: shapely.LineString, tolerance_m: float, halved: int) -> shapely.Geometry:
    """A line simplified with a tolerance halved a number of times, or unchanged after the last."""
    if halved > HALVINGS:
        return line
    return shapely.simplify(line, tolerance_m / 2.0**halved, preserve_topology=False)


def _intersecting(lines: np.ndarray) -> np.ndarray:
    """Indices of the lines that intersect another one or themselves."""
    one, other = shapely.STRtree(lines).query(lines, predicate="intersects")
    return np.union1d(one[one != other], np.flatnonzero(~shapely.is_simple(lines)))


@dataclass(frozen=True, slots=True)
class ContourParams:
    """Parameters of contours."""

    interval_m: ContourInterval | None = None
    """Difference in elevation between contours; chosen by the relief when absent."""
    most_contours: Few = 15
    """Most contours when the interval is chosen: lines stay apart on a screen."""
    index_every: Few = 5
    """Every fifth contour is an index contour, as on printed maps."""
    smoothing_m: ShortMetresOrZero = 0.2
    """Standard deviation of the Gaussian: rocks below half a metre are not drawn."""
    min_share: Share = 0.5
    """Least fraction of the Gaussian's weight on known cells: at an edge it is half."""
    min_length_m: MetresOrZero = 1.0
    """Shortest contour: about a wheel base."""
    simplify_m: ShortMetresOrZero = 0.02
    """Largest distance of a contour from where it was traced: a fifth of a node's distance."""

    def __post_init__(self) -> None:
        if self.interval_m is not None and not self.interval_m > 0:
            raise TerrainError(f"a contour interval must be above zero, not {self.interval_m} m")


@dataclass(frozen=True, slots=True)
class RegionContourParams(ContourParams):
    """Parameters of contours of a region: many stops, seen from farther away."""

    interval_m: ContourInterval | None = 1.0
    """Contour interval, that of the paper's maps of regions."""
    smoothing_m: ShortMetresOrZero = 0.5
    """Rocks of a metre are not drawn."""
    min_length_m: MetresOrZero = 5.0
    """Shorter lines enclose mounds of a few metres."""
    simplify_m: ShortMetresOrZero = 0.1
    """Invisible on a map of a hundred metres."""


@dataclass(frozen=True, slots=True)
class FarContourParams(ContourParams):
    """Parameters of contours of far ground."""

    smoothing_m: ShortMetresOrZero = 3.2
    """Five cells, as in the map of a stop."""
    min_length_m: MetresOrZero = 16.0
    """Twenty-five cells, as in the map of a stop."""
    simplify_m: ShortMetresOrZero = 0.32
    """Half a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Contour:
    """A line of equal elevation."""

    elevation_m: float
    is_index: bool
    points: Float64[np.ndarray, "n 2"]
    """(east, north), metres; the first and last are equal where the line is closed."""


def trace_terrain(terrain: Terrain, params: ContourParams) -> tuple[Contour, ...]:
    """Contours of a terrain model that is smoothed part by part."""
    grid, step = terrain.grid, _node_step(terrain.grid, params)
    nodes = np.full([-(-count // step) for count in grid.shape], np.nan, np.float32)
    margin = math.ceil(REACH_SIGMAS * params.smoothing_m / grid.cell_m) + 1
    for part in seen_parts(terrain, margin * grid.cell_m):
        smooth = smooth_elevation(
            part.dtm.elevation, part.grid.cell_m, params.smoothing_m, params.min_share
        )
        down, right = (-side.start % step for side in part.own)
        own = part.own_values(smooth)[down::step, right::step]
        row, col = (-(-side.start // step) for side in part.own)
        nodes[row : row + own.shape[0], col : col + own.shape[1]] = own
    return _trace(nodes, grid, step, params)


def trace_contours(elevation: Raster, grid: MapGrid, params: ContourParams) -> tuple[Contour, ...]:
    """Contours of elevations, lowest first; none where they are flat or empty."""
    smooth = smooth_elevation(elevation, grid.cell_m, params.smoothing_m, params.min_share)
    step = _node_step(grid, params)
    return _trace(smooth[::step, ::step], grid, step, params)


def _node_step(grid: MapGrid, params: ContourParams) -> int:
    """Cells from one node of the lattice to the next."""
    return max(1, int(params.smoothing_m / NODES_PER_SIGMA / grid.cell_m))


def _trace(nodes: Raster, grid: MapGrid, step: int, params: ContourParams) -> tuple[Contour, ...]:
    """Contours of smoothed elevations at every `step`-th cell of a grid."""
    known = nodes[np.isfinite(nodes)]
    if not len(known):
        return ()
    rows, cols = seen_window(nodes)
    nodes = nodes[rows, cols]
    if min(nodes.shape) < 2:  # noqa: PLR2004 - a cell has two sides
        return ()
    interval_m = params.interval_m or interval_by_relief(known, params.most_contours)
    east, north = grid.centres()
    tracer: Any = contourpy.contour_generator(
        x=east[::step][cols],
        y=north[::step][rows],
        z=np.ma.masked_invalid(_off_the_contours(nodes, interval_m)),
        corner_mask=True,
    )
    levels = _levels(known, interval_m)
    lines = [
        (number, points)
        for number in levels
        for points in tracer.lines(number * interval_m)
        if _length_m(points) >= params.min_length_m
    ]
    simple = simplify_lines([points for _, points in lines], params.simplify_m)
    return tuple(
        Contour(round(number * interval_m, 6), number % params.index_every == 0, points)
        for (number, _), points in zip(lines, simple, strict=True)
    )


def _levels(known: Float32[np.ndarray, " n"], interval_m: float) -> range:
    """The contours between the lowest and the highest elevation, in intervals from 0."""
    return range(math.ceil(known.min() / interval_m), math.floor(known.max() / interval_m) + 1)


def _off_the_contours(nodes: Raster, interval_m: float) -> Float64[np.ndarray, "rows cols"]:
    """Elevations that differ from every contour's: those within a thousandth are raised.

    Lines through a node at a contour's own elevation would touch there.
    """
    intervals = nodes.astype(np.float64) / interval_m
    level = np.rint(intervals)
    off = np.where(np.abs(intervals - level) < LEAST_OFF, level + LEAST_OFF, intervals)
    return off * interval_m


def interval_by_relief(known: Float64[np.ndarray, " n"] | np.ndarray, most_contours: int) -> float:
    """The smallest round interval with at most `most_contours` contours for most of the relief.

    Relief is taken between the 1st and 99th percentile, so that single boulders have no effect.
    """
    low, high = np.percentile(known, (1, 99))
    least = max(float(high - low) / most_contours, 1e-3)
    decade = 10.0 ** math.floor(math.log10(least))
    return next(
        round(step * decade, 9) for step in (*STEPS, 10.0) if step * decade >= least * (1 - 1e-9)
    )


def smooth_elevation(elevation: Raster, cell_m: float, sigma_m: float, min_share: float) -> Raster:
    """Elevations averaged with a Gaussian; NaN where too little of its weight is on known cells."""
    known = np.isfinite(elevation)
    if not known.any() or sigma_m < cell_m / 2:
        return elevation
    level = np.float32(np.mean(elevation[known], dtype=np.float64))
    heights = np.where(known, elevation - level, np.float32(0))
    sigma = sigma_m / cell_m
    weight = _blur(known.astype(np.float32), sigma)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = _blur(heights, sigma) / weight + level
    return np.where(weight >= min_share, mean, np.float32(np.nan))


def _blur(raster: Raster, sigma: float) -> Raster:
    return cv2.GaussianBlur(raster, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)


def _length_m(points: Float64[np.ndarray, "n 2"]) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())
