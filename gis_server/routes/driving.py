"""Where a rover can drive: isochrones as areas, picture and GeoTIFF, and ways free of hazards."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response

from solmap.gis_server.analysis.driving import (
    MOST_BANDS,
    USUAL_SPEED_M_H,
    Drives,
    ReachAnswer,
    RouteAnswer,
    drives_from,
    reach_answer,
    reach_png,
    route_answer,
)
from solmap.gis_server.analysis.ground import BEST
from solmap.gis_server.routes.analysis import ground_of
from solmap.gis_server.routes.geotiffs import geotiff
from solmap.gis_server.routes.missions import map_layers
from solmap.gis_server.routes.parameters import AGAIN, Metres, MissionName
from solmap.gis_server.services import ServicesOf
from solmap.photogrammetry.terrain.traversability.driving import DrivingParams
from solmap.products.crs import local_crs
from solmap.products.formats.raster.raster import write_raster

router = APIRouter(prefix="/api/missions/{mission}", tags=["analysis"])
_USUAL = DrivingParams()
FARTHEST_M = 500.0
Farthest = Annotated[float, Query(gt=0, le=FARTHEST_M, description="longest way, metres")]
Gap = Annotated[
    float,
    Query(ge=0, le=5, description="unknown ground less wide than this is driven over, metres"),
]
Stand = Annotated[
    float, Query(ge=0, le=10, description="unknown ground so near the start is safe, metres")
]
Interval = Annotated[
    float, Query(ge=0.1, le=FARTHEST_M, description="of driving, between isochrones, metres")
]
Speed = Annotated[float, Query(gt=0, le=1000, description="metres an hour")]


def _drives(  # noqa: PLR0913 - the query
    *,
    mission: MissionName,
    services: ServicesOf,
    east: Metres,
    north: Metres,
    farthest_m: Farthest = 50.0,
    gap_m: Gap = _USUAL.gap_m,
    stand_m: Stand = _USUAL.stand_m,
) -> Drives:
    ground = ground_of(mission, BEST, services)
    params = DrivingParams(stand_m, gap_m, farthest_m)
    return drives_from((east, north), params, map_layers(mission, services), ground)


DrivesHere = Annotated[Drives, Depends(_drives)]
"""The ways from the place that a query asks for."""


@router.get("/reach")
def reachable(
    drives: DrivesHere,
    request: Request,
    response: Response,
    interval_m: Interval = 5.0,
    speed_m_h: Speed = USUAL_SPEED_M_H,
) -> ReachAnswer:
    """How far a rover drives to the ground around it, past all hazards: isochrones as GeoJSON.

    Isochrones are at most 50; ground beyond the last counts to it.
    """
    response.headers.update(AGAIN)
    interval_m = max(interval_m, drives.params.farthest_m / MOST_BANDS)
    return reach_answer(drives, interval_m, speed_m_h, request.url.query, request.url.path)


@router.get("/reach.png", response_class=Response)
def reach_picture(drives: DrivesHere, interval_m: Interval = 5.0) -> Response:
    """The same as a picture on the bounds that /reach tells: near is yellow, far is blue."""
    interval_m = max(interval_m, drives.params.farthest_m / MOST_BANDS)
    return Response(reach_png(drives, interval_m), media_type="image/png", headers=AGAIN)


@router.get("/reach.tif", response_class=Response)
def reach_geotiff(mission: MissionName, drives: DrivesHere, services: ServicesOf) -> Response:
    """The metres driven to every cell, as a GeoTIFF in the local CRS; NaN where no way leads."""
    crs = local_crs(services.catalogue.mission(mission).landing)
    found = drives.found
    return geotiff(
        "reach.tif",
        lambda path: write_raster(path, found.grid, {"drive": found.drive_m}, crs, unit="m"),
    )


@router.get("/route")
def route(
    drives: DrivesHere,
    response: Response,
    to_east: Metres,
    to_north: Metres,
    speed_m_h: Speed = USUAL_SPEED_M_H,
) -> RouteAnswer:
    """The shortest way between two places that keeps to ground free of hazards."""
    response.headers.update(AGAIN)
    return route_answer(drives, (to_east, to_north), speed_m_h)
