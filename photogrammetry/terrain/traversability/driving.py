"""Reachability: length and path of the shortest drive to every cell, around all hazards.

Cells in which the middle of the rover may be (`hazard.py` checks all ground below it) are joined to
their sixteen neighbours, the eight around and the eight a knight's move away, by edges of the
length on the ground. Shortest paths are found by Dijkstra's algorithm (1959). A path in one of the
sixteen directions has its exact length; in others it is up to 2.8 % longer than a straight line.

Unknown ground is not driven over, except around the start, which the rover's own cameras do not
see, and across gaps of the map that are much smaller than a rover.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from solmap.photogrammetry.arrays import Bool, Classes, Float64, Int32, Raster
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.traversability.hazard import Hazard

Places = Float64[np.ndarray, "n 2"]
"""(east, north) in metres of the local map."""
Open = Bool[np.ndarray, "rows cols"]
"""True where the middle of the rover may be."""

_MOVES = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))
"""(rows, columns) to half of the neighbours; the other half are the reverse moves."""


@dataclass(frozen=True, slots=True)
class DrivingParams:
    """Unknown ground that may be driven over."""

    stand_m: float = 2.6
    """Radius around the start in which unknown ground counts as safe, because the rover is there:
    its width plus that of the window in which hazards are evaluated."""
    gap_m: float = 0.5
    """Unknown ground narrower than this is driven over where the ground around is safe."""
    farthest_m: float = 100.0
    """Longest path that is searched."""

    def __post_init__(self) -> None:
        if not (self.stand_m >= 0 and self.gap_m >= 0 and self.farthest_m > 0):
            raise TerrainError(
                "farthest_m must be above zero, gap_m and stand_m zero or more, not "
                f"{self.farthest_m} m, {self.gap_m} m and {self.stand_m} m"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Reachability:
    """The shortest paths from one point to all others."""

    grid: MapGrid
    start: tuple[int, int]
    """Row and column of the start cell."""
    drive_m: Raster
    """Length of the path to every cell; NaN where there is none."""
    before: Int32[np.ndarray, "rows cols"]
    """Index of the previous cell on that path, by rows; negative where there is none."""

    def path_to(self, place: tuple[float, float]) -> Places:
        """Centres of the cells on the path to the cell of a point, the start first.

        Raises:
            TerrainError: there is no path.
        """
        cell = self.grid.cell_at(*place)
        if cell is None or not np.isfinite(self.drive_m[cell]):
            raise TerrainError(
                f"there is no path free of hazards and unknown ground to east {place[0]:.2f}, "
                f"north {place[1]:.2f}: choose another point, or allow wider gaps or a longer path"
            )
        before, at = self.before.ravel(), int(np.ravel_multi_index(cell, self.grid.shape))
        cells = [at]
        while before[at] >= 0:
            at = int(before[at])
            cells.append(at)
        rows, cols = np.unravel_index(cells[::-1], self.grid.shape)
        east, north = self.grid.centres()
        return np.column_stack([east[cols], north[rows]])


def reachability(
    hazard: Classes,
    elevation: Raster,
    grid: MapGrid,
    place: tuple[float, float],
    params: DrivingParams,
) -> Reachability:
    """The shortest paths from (east, north) over cells of `Hazard`, with their elevations, metres.

    Raises:
        TerrainError: the point is off the grid, or in a hazard.
    """
    start = grid.cell_at(*place)
    if start is None:
        raise TerrainError(f"east {place[0]:.2f}, north {place[1]:.2f} is not on the map")
    if hazard[start] > Hazard.TRAVERSABLE:
        kind = Hazard(int(hazard[start])).name.lower()
        raise TerrainError(
            f"east {place[0]:.2f}, north {place[1]:.2f} is a hazard ({kind}): start on safe ground"
        )
    way = drivable(hazard, grid, start, params)
    edges = drive_graph(way, fill_gaps(elevation), grid.cell_m)
    first = int(np.ravel_multi_index(start, grid.shape))
    length, before = dijkstra(
        edges, directed=False, indices=first, limit=params.farthest_m, return_predecessors=True
    )
    length[~np.isfinite(length)] = np.nan
    return Reachability(
        grid,
        start,
        length.astype(np.float32).reshape(grid.shape),
        before.astype(np.int32).reshape(grid.shape),
    )


def drivable(hazard: Classes, grid: MapGrid, start: tuple[int, int], params: DrivingParams) -> Open:
    """The cells that may be driven over: free of hazards, in small gaps, or at the start."""
    free = (hazard == Hazard.TRAVERSABLE).astype(np.uint8)
    half = math.floor(params.gap_m / grid.cell_m / 2 + 1e-9)
    if half:
        shape = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * half + 1, 2 * half + 1))
        free |= cv2.morphologyEx(free, cv2.MORPH_CLOSE, shape, borderValue=0)
    stand = np.zeros(grid.shape, np.uint8)
    cv2.circle(stand, start[::-1], round(params.stand_m / grid.cell_m), 1, cv2.FILLED)
    return ((free | stand) > 0) & (hazard <= Hazard.TRAVERSABLE)


def fill_gaps(elevation: Raster) -> Raster:
    """The elevations, and in gaps that of the nearest known cell."""
    gaps = ~np.isfinite(elevation)
    if not gaps.any():
        return elevation
    if gaps.all():
        return np.zeros_like(elevation)
    rows, cols = distance_transform_edt(gaps, return_distances=False, return_indices=True)
    return elevation[rows, cols]


def drive_graph(way: Open, elevation: Raster, cell_m: float) -> coo_array:
    """The graph of cells: the length of the ground between each and half of its neighbours."""
    number = np.arange(way.size, dtype=np.int32).reshape(way.shape)
    starts, ends, lengths = [], [], []
    for move in _MOVES:
        here, there = (_cells(way.shape, move, at) for at in ((0, 0), move))
        passed = (way[_cells(way.shape, move, at)] for at in _touched_cells(*move))
        both = np.logical_and.reduce([way[here], way[there], *passed])
        rise = elevation[there][both] - elevation[here][both]
        starts.append(number[here][both])
        ends.append(number[there][both])
        lengths.append(np.hypot(rise, cell_m * math.hypot(*move)))
    at = (np.concatenate(starts), np.concatenate(ends))
    return coo_array((np.concatenate(lengths).astype(np.float64), at), shape=(way.size, way.size))


def _cells(
    shape: tuple[int, ...], move: tuple[int, int], at: tuple[int, int]
) -> tuple[slice, slice]:
    """The cells at (rows, columns) from those that have a neighbour a move away."""
    (rows, cols), (down, right) = shape, move
    left, over = max(0, -right), max(0, right)
    return slice(at[0], rows - down + at[0]), slice(left + at[1], cols - over + at[1])


def _touched_cells(down: int, right: int) -> tuple[tuple[int, int], ...]:
    """The cells whose corners or sides a move touches between its ends."""
    side = 1 if right > 0 else -1
    if (down, abs(right)) == (1, 1):
        return (1, 0), (0, side)
    if (down, abs(right)) == (1, 2):
        return (0, side), (1, side)
    return ((1, 0), (1, side)) if down > 1 else ()
