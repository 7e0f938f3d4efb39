"""Viewsheds: the ground that can be seen from a place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import rasterio.features
from affine import Affine
from pydantic import BaseModel

from solmap.gis_server.analysis.bodies import UNITS, LayerUsed
from solmap.gis_server.analysis.ground import Ground
from solmap.gis_server.analysis.mosaic import mosaic
from solmap.gis_server.analysis.sight import raised
from solmap.gis_server.rendering.png import indexed_png
from solmap.photogrammetry.arrays import Classes, Vector3
from solmap.photogrammetry.terrain.dtm.grid import Bounds, MapGrid
from solmap.photogrammetry.terrain.visibility.viewshed import Sight, ViewshedParams, viewshed
from solmap.products.formats.raster.raster import SIGHTS
from solmap.products.model import Layer

MOST_CELLS = 1_500_000
"""Cells of a viewshed, a second of work; of larger areas the cells are doubled."""
MOST_POLYGONS = 500


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The ground that can be seen from a place."""

    eye: Vector3
    """(east, north, up)."""
    params: ViewshedParams
    sight: Classes
    grid: MapGrid
    layers: list[Layer]


class ViewshedAnswer(BaseModel):
    """The ground that can be seen from a place, as areas, polygons and pictures."""

    units: str = UNITS
    east: float
    north: float
    eye_elevation_m: float
    mast_m: float
    target_m: float
    """Height of what is looked at above the ground."""
    radius_m: float
    cell_m: float
    max_unseen_m: float
    """Longest stretch of unseen ground over which a target counts as visible."""
    visible_m2: float
    hidden_m2: float
    unknown_m2: float
    """Within the radius: not mapped, or behind a long unmapped stretch."""
    bounds: Bounds
    """(west, south, east, north) of the picture and the GeoTIFF."""
    picture: str
    geotiff: str
    polygons: dict[str, Any]
    """GeoJSON in metres of the local map: what is visible, largest first."""
    polygons_left_out: int
    layers: list[LayerUsed]


def seen_from(
    place: tuple[float, float], elevation: float | None, params: ViewshedParams, ground: Ground
) -> Seen:
    """The viewshed of an eye on a mast above a place."""
    eye = raised(place, elevation, params.eye_height_m, ground)
    reach, cell = params.radius_m, max(params.cell_m, ground.finest_cell_m)
    while (2 * reach / cell) ** 2 > MOST_CELLS:
        cell *= 2
    box = (place[0] - reach, place[1] - reach, place[0] + reach, place[1] + reach)
    grid = MapGrid.covering(box, cell)
    heights, layers = mosaic(ground, grid)
    return Seen(
        eye, replace(params, cell_m=cell), viewshed(heights, grid, eye, params), grid, layers
    )


def viewshed_answer(seen: Seen, query: str, address: str) -> ViewshedAnswer:
    """The viewshed as it is sent; pictures are had with the same query."""
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


def _polygons(seen: Seen) -> Iterator[dict[str, Any]]:
    """What is visible, patch by patch."""
    visible = (seen.sight == Sight.VISIBLE).astype(np.uint8)
    grid = seen.grid
    place = Affine(grid.cell_m, 0.0, grid.west, 0.0, -grid.cell_m, grid.north)
    for geometry, _ in rasterio.features.shapes(visible, mask=visible > 0, transform=place):
        rings = [[[round(x, 3), round(y, 3)] for x, y in r] for r in geometry["coordinates"]]
        area = _area(rings[0]) - sum(_area(hole) for hole in rings[1:])
        yield {
            "type": "Feature",
            "properties": {"sight": "visible", "area_m2": round(area, 3)},
            "geometry": {"type": "Polygon", "coordinates": rings},
        }


def _area(ring: list[list[float]]) -> float:
    x, y = np.array(ring).T
    return abs(float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))) / 2


def viewshed_png(seen: Seen) -> bytes:
    """The viewshed as a picture on its bounds; unknown ground is transparent."""
    palette = np.zeros((256, 3), np.uint8)
    for kind in SIGHTS:
        palette[kind.value] = tuple(bytes.fromhex(kind.colour.removeprefix("#")))
    return indexed_png(seen.sight, palette, b"\x00\xa0\xa0")
