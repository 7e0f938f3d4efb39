"""Lines of sight between two places, and viewsheds: all ground visible from a place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import BaseModel

from solmap.gis_server.analysis.bodies import (
    SIGHT_NAMES,
    UNITS,
    LayerUsed,
    UnanswerableError,
    json_number,
    json_numbers,
)
from solmap.gis_server.analysis.ground import Ground, grid_around, mosaic, polygons_of
from solmap.gis_server.analysis.measures import layers_used
from solmap.gis_server.rendering.png import indexed_png
from solmap.photogrammetry.arrays import Classes, Vector3
from solmap.photogrammetry.terrain.dtm.grid import Bounds, MapGrid
from solmap.photogrammetry.terrain.visibility.viewshed import (
    Sight,
    ViewshedParams,
    sight_line,
    sight_line_stations,
    viewshed,
)
from solmap.products.formats.raster.raster import VISIBILITY_CLASSES
from solmap.products.model import Layer

FARTHEST_M = 2000.0
"""Longest line of sight, and largest radius of a viewshed."""
_MOST_STATIONS = 2000
MOST_CELLS = 1_500_000
"""Most cells of a viewshed, one second of work; larger areas get cells of twice the size."""
MOST_POLYGONS = 500


class SightAnswer(BaseModel):
    """Whether one place can be seen from another, and the ground between."""

    units: str = UNITS
    sight: str
    """visible, hidden or unknown."""
    clearance_m: float | None
    """Least height of the line over known ground; negative below it."""
    obstruction: tuple[float, float, float] | None
    """(east, north, elevation) of the ground that obstructs the line most."""
    obstruction_distance_m: float | None
    unseen_m: float
    """Longest stretch of unmapped ground on the way."""
    eye_elevation_m: float
    target_elevation_m: float
    map_distance_m: float
    distance_m: list[float | None]
    ground_m: list[float | None]
    line_m: list[float | None]
    layers: list[LayerUsed]


@dataclass(frozen=True, slots=True)
class LineEnd:
    """One end of a line of sight."""

    place: tuple[float, float]
    elevation_m: float | None
    """Elevation of the ground; None: that of the map."""
    height_m: float
    """Height above the ground."""


def line_of_sight(
    eye: LineEnd, target: LineEnd, max_unseen_m: float, ground: Ground
) -> SightAnswer:
    """Whether a target above one place can be seen from an eye above another."""
    start, end = (
        point_above_ground(e.place, e.elevation_m, e.height_m, ground) for e in (eye, target)
    )
    length = float(np.hypot(*(end - start)[:2]))
    if not 0 < length <= FARTHEST_M:
        raise UnanswerableError(
            f"a line of sight is longer than 0 m and no longer than {FARTHEST_M:g} m; this one has "
            f"{length:.1f} m"
        )
    places = sight_line_stations(start, end, max(ground.finest_cell_m, length / _MOST_STATIONS))
    read = ground.at(places)
    found = sight_line(start, end, places, read.elevation, max_unseen_m)
    where = found.obstruction
    return SightAnswer(
        sight=SIGHT_NAMES[found.sight],
        clearance_m=json_number(found.clearance_m),
        obstruction=None
        if where is None
        else (
            round(float(places[where, 0]), 4),
            round(float(places[where, 1]), 4),
            round(float(found.ground_m[where]), 4),
        ),
        obstruction_distance_m=None
        if where is None
        else json_number(float(found.distance_m[where])),
        unseen_m=round(found.unseen_m, 3),
        eye_elevation_m=round(float(start[2]), 4),
        target_elevation_m=round(float(end[2]), 4),
        map_distance_m=round(length, 4),
        distance_m=json_numbers(found.distance_m),
        ground_m=json_numbers(found.ground_m),
        line_m=json_numbers(found.line_m),
        layers=layers_used(read, ground),
    )


def point_above_ground(
    place: tuple[float, float], elevation: float | None, height_m: float, ground: Ground
) -> Vector3:
    """(east, north, up) at a height above the ground, by default that of the map.

    Raises:
        UnanswerableError: the map has no elevation there.
    """
    if elevation is None:
        found = float(ground.elevation(np.array([place]))[0])
        if not np.isfinite(found):
            raise UnanswerableError(
                f"the ground at east {place[0]:.2f}, north {place[1]:.2f} has no elevation: stand "
                "on mapped ground, or give its elevation"
            )
        elevation = found
    return np.array([*place, elevation + height_m])


@dataclass(frozen=True, slots=True, eq=False)
class Viewshed:
    """The ground that can be seen from a place."""

    eye: Vector3
    """(east, north, up)."""
    params: ViewshedParams
    sight: Classes
    grid: MapGrid
    layers: list[Layer]


class ViewshedAnswer(BaseModel):
    """The ground that can be seen from a place, as areas, polygons and images."""

    units: str = UNITS
    east: float
    north: float
    eye_elevation_m: float
    mast_m: float
    target_m: float
    """Height of the target above the ground."""
    radius_m: float
    cell_m: float
    max_unseen_m: float
    """Longest stretch of unseen ground over which a target counts as visible."""
    visible_m2: float
    hidden_m2: float
    unknown_m2: float
    """Unknown area within the radius: not mapped, or behind a long unmapped stretch."""
    bounds: Bounds
    """(west, south, east, north) of the image and the GeoTIFF."""
    picture: str
    geotiff: str
    polygons: dict[str, Any]
    """GeoJSON in metres of the local map: what is visible, largest first."""
    polygons_left_out: int
    layers: list[LayerUsed]


def compute_viewshed(
    place: tuple[float, float], elevation: float | None, params: ViewshedParams, ground: Ground
) -> Viewshed:
    """The viewshed of an eye on a mast above a place."""
    eye = point_above_ground(place, elevation, params.eye_height_m, ground)
    reach, cell = params.radius_m, max(params.cell_m, ground.finest_cell_m)
    while (2 * reach / cell) ** 2 > MOST_CELLS:
        cell *= 2
    grid = grid_around(place, reach, cell)
    heights, layers = mosaic(ground, grid)
    return Viewshed(
        eye, replace(params, cell_m=cell), viewshed(heights, grid, eye, params), grid, layers
    )


def viewshed_answer(seen: Viewshed, query: str, address: str) -> ViewshedAnswer:
    """Response with the viewshed; images are available with the same query."""
    cell, grid = seen.grid.cell_m**2, seen.grid
    east, north = grid.centres()
    away = np.hypot(east[None, :] - seen.eye[0], north[:, None] - seen.eye[1])
    within = seen.sight[away <= seen.params.radius_m]
    areas = {kind: float(np.count_nonzero(within == kind)) * cell for kind in Sight}
    polygons = sorted(_polygons(seen), key=lambda polygon: -polygon["properties"]["area_m2"])
    return ViewshedAnswer(
        east=float(seen.eye[0]),
        north=float(seen.eye[1]),
        eye_elevation_m=round(float(seen.eye[2]), 4),
        mast_m=seen.params.eye_height_m,
        target_m=seen.params.target_height_m,
        radius_m=seen.params.radius_m,
        cell_m=grid.cell_m,
        max_unseen_m=seen.params.max_unseen_m,
        visible_m2=round(areas[Sight.VISIBLE], 3),
        hidden_m2=round(areas[Sight.HIDDEN], 3),
        unknown_m2=round(areas[Sight.UNKNOWN], 3),
        bounds=grid.bounds,
        picture=f"{address}.png?{query}",
        geotiff=f"{address}.tif?{query}",
        polygons={"type": "FeatureCollection", "features": polygons[:MOST_POLYGONS]},
        polygons_left_out=max(0, len(polygons) - MOST_POLYGONS),
        layers=[LayerUsed.of(layer) for layer in seen.layers],
    )


def _polygons(seen: Viewshed) -> Iterator[dict[str, Any]]:
    """Visible ground, patch by patch."""
    visible = (seen.sight == Sight.VISIBLE).astype(np.uint8)
    for rings, _ in polygons_of(visible, seen.grid):
        area = _area(rings[0]) - sum(_area(hole) for hole in rings[1:])
        yield {
            "type": "Feature",
            "properties": {"sight": "visible", "area_m2": round(area, 3)},
            "geometry": {"type": "Polygon", "coordinates": rings},
        }


def _area(ring: list[tuple[float, float]]) -> float:
    x, y = np.array(ring).T
    return abs(float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))) / 2


def viewshed_png(seen: Viewshed) -> bytes:
    """The viewshed as an image on its bounds; unknown ground is transparent."""
    palette = np.zeros((256, 3), np.uint8)
    for kind in VISIBILITY_CLASSES:
        palette[kind.value] = tuple(bytes.fromhex(kind.colour.removeprefix("#")))
    return indexed_png(seen.sight, palette, b"\x00\xa0\xa0")
