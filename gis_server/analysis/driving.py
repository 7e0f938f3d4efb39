"""Driving distances to the ground around a place, and routes free of hazards.

Hazards are those of the maps: at every point the worst of all stops and regions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from pydantic import BaseModel

from solmap.gis_server.analysis.bodies import UNITS, LayerUsed, UnanswerableError, json_numbers
from solmap.gis_server.analysis.ground import (
    Ground,
    grid_around,
    mosaic,
    polygons_of,
    worst_classes,
)
from solmap.gis_server.rendering.png import indexed_png
from solmap.photogrammetry.arrays import Classes, Float64, Raster
from solmap.photogrammetry.terrain.dtm.grid import Bounds, MapGrid
from solmap.photogrammetry.terrain.traversability.driving import (
    DrivingParams,
    Reachability,
    reachability,
)
from solmap.products.model import Layer, ProductKind

HAZARD_KINDS = (ProductKind.HAZARD, ProductKind.REGION_HAZARD)
MOST_CELLS = 1 << 20
"""Most cells of a search, one second of work; larger areas get cells of twice the size."""
MOST_BANDS = 50
USUAL_SPEED_M_H = 36.0
"""Usual speed, a centimetre per second: the mean of MER with hazard detection."""
_OPACITY = 0xA0


@dataclass(frozen=True, slots=True, eq=False)
class Drives:
    """The routes from a place, and the hazard map they were found on."""

    place: tuple[float, float]
    found: Reachability
    elevation: Raster
    params: DrivingParams
    layers: list[Layer]

    def bands(self, interval_m: float) -> Classes:
        """Number of the driving interval of a cell, from 1; 0 if it cannot be reached."""
        nearer = np.nan_to_num(self.found.drive_m / interval_m, nan=-1.0)
        return np.where(nearer < 0, 0, np.minimum(nearer, MOST_BANDS - 1) + 1).astype(np.uint8)


class ReachAnswer(BaseModel):
    """Driving distances to the ground around a place, as polygons, image and GeoTIFF."""

    units: str = UNITS
    east: float
    north: float
    farthest_m: float
    """Longest route of the search."""
    interval_m: float
    cell_m: float
    reached_m2: float
    """Ground that can be reached without hazards and unknown ground."""
    longest_drive_m: float
    speed_m_h: float
    longest_drive_h: float
    bounds: Bounds
    """(west, south, east, north) of the image and the GeoTIFF."""
    picture: str
    geotiff: str
    isochrones: dict[str, Any]
    """GeoJSON in metres of the local map: the ground in each interval of driving, and its hours."""
    layers: list[LayerUsed]


class RouteAnswer(BaseModel):
    """A shortest route free of hazards."""

    units: str = UNITS
    drive_m: float
    """Length along the ground."""
    straight_m: float
    """Length on the map, from end to end."""
    climb_m: float
    descent_m: float
    speed_m_h: float
    drive_h: float
    cell_m: float
    places: list[tuple[float, float]]
    """(east, north) of every cell on the route."""
    distance_m: list[float | None]
    ground_m: list[float | None]
    layers: list[LayerUsed]


def find_drives(
    place: tuple[float, float], params: DrivingParams, hazards: Sequence[Layer], ground: Ground
) -> Drives:
    """All paths from a point up to the requested length.

    Raises:
        UnanswerableError: there are no hazard maps.
        TerrainError: no rover may stand at the place.
    """
    maps = [layer for layer in hazards if layer.ref.kind in HAZARD_KINDS and layer.cell_m]
    if not maps:
        raise UnanswerableError(
            "this mission has no hazard maps yet, which a safe route needs: process its sols "
            "with a pipeline that makes them"
        )
    grid = grid_around(place, params.farthest_m, min(layer.cell_m or 0.0 for layer in maps))
    codes, used = worst_classes(maps, grid, ground.store, ground.pool)
    while grid.rows * grid.cols > MOST_CELLS:
        codes, grid = _halve(codes, grid)
    heights, models = mosaic(ground, grid)
    found = reachability(codes, heights, grid, place, params)
    return Drives(place, found, heights, params, [*used, *models])


def _halve(codes: Classes, grid: MapGrid) -> tuple[Classes, MapGrid]:
    """Cells of twice the side, each with the worst of its four."""
    fours = codes.reshape(grid.rows // 2, 2, grid.cols // 2, 2)
    half = MapGrid(grid.west, grid.north, 2 * grid.cell_m, grid.rows // 2, grid.cols // 2)
    return fours.max(axis=(1, 3)), half


def reach_answer(
    drives: Drives, interval_m: float, speed_m_h: float, query: str, address: str
) -> ReachAnswer:
    """Response on the ground around a point; images are available with the same query."""
    found, grid = drives.found, drives.found.grid
    reached = np.isfinite(found.drive_m)
    longest = float(np.nanmax(found.drive_m))
    return ReachAnswer(
        east=drives.place[0],
        north=drives.place[1],
        farthest_m=drives.params.farthest_m,
        interval_m=interval_m,
        cell_m=grid.cell_m,
        reached_m2=round(float(np.count_nonzero(reached)) * grid.cell_m**2, 3),
        longest_drive_m=round(longest, 3),
        speed_m_h=speed_m_h,
        longest_drive_h=round(longest / speed_m_h, 4),
        bounds=grid.bounds,
        picture=f"{address}.png?{query}",
        geotiff=f"{address}.tif?{query}",
        isochrones=_isochrones(drives, interval_m, speed_m_h),
        layers=[LayerUsed.of(layer) for layer in drives.layers],
    )


def _isochrones(drives: Drives, interval_m: float, speed_m_h: float) -> dict[str, Any]:
    """A polygon for every patch of ground in one driving interval."""
    features: list[dict[str, Any]] = []
    for rings, band in polygons_of(drives.bands(interval_m), drives.found.grid):
        until = band * interval_m
        known = {"drive_m": until, "drive_h": round(until / speed_m_h, 4)}
        shape = {"type": "Polygon", "coordinates": rings}
        features.append({"type": "Feature", "properties": known, "geometry": shape})
    features.sort(key=lambda feature: feature["properties"]["drive_m"])
    return {"type": "FeatureCollection", "features": features}


def reach_png(drives: Drives, interval_m: float) -> bytes:
    """The intervals of driving as an image, near ones yellow, far ones blue."""
    bands = drives.bands(interval_m)
    last = max(1, int(bands.max()))
    shades = np.linspace(255, 0, last).astype(np.uint8)  # viridis, backwards: near is bright
    colours = cv2.applyColorMap(shades[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    palette = np.zeros((256, 3), np.uint8)
    palette[1 : last + 1] = colours
    return indexed_png(bands, palette, b"\x00" + bytes([_OPACITY]) * last)


def route_answer(drives: Drives, to: tuple[float, float], speed_m_h: float) -> RouteAnswer:
    """The route to one place.

    Raises:
        TerrainError: there is none.
    """
    places = drives.found.path_to(to)
    grid = drives.found.grid
    rows = ((grid.north - places[:, 1]) / grid.cell_m).astype(int)
    cols = ((places[:, 0] - grid.west) / grid.cell_m).astype(int)
    distance = drives.found.drive_m[rows, cols].astype(np.float64)
    heights = drives.elevation[rows, cols].astype(np.float64)
    climb, descent = _climbs(heights)
    return RouteAnswer(
        drive_m=round(float(distance[-1]), 3),
        straight_m=round(float(np.hypot(*(places[-1] - places[0]))), 3),
        climb_m=round(climb, 3),
        descent_m=round(descent, 3),
        speed_m_h=speed_m_h,
        drive_h=round(float(distance[-1]) / speed_m_h, 4),
        cell_m=grid.cell_m,
        places=[(round(e, 3), round(n, 3)) for e, n in places.tolist()],
        distance_m=json_numbers(distance),
        ground_m=json_numbers(heights),
        layers=[LayerUsed.of(layer) for layer in drives.layers],
    )


def _climbs(heights: Float64[np.ndarray, " n"]) -> tuple[float, float]:
    """Metres up and metres down along known ground."""
    rises = np.diff(heights[np.isfinite(heights)])
    return float(rises[rises > 0].sum()), float(-rises[rises < 0].sum())
