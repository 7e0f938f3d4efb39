"""Measuring on the map: profiles, areas, volumes, planes, statistics, lines of sight, drives.

Requests have a body or a query; nothing is written.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response

from solmap.gis_server.analysis.bodies import UnanswerableError
from solmap.gis_server.analysis.driving import (
    MOST_BANDS,
    USUAL_SPEED_M_H,
    Drives,
    ReachAnswer,
    RouteAnswer,
    find_drives,
    reach_answer,
    reach_png,
    route_answer,
)
from solmap.gis_server.analysis.ground import BEST
from solmap.gis_server.analysis.layer_values import ZonalAnswer, ZonalQuestion, zonal_answer
from solmap.gis_server.analysis.measures import (
    AreaAnswer,
    AreaQuestion,
    LineAnswer,
    LineQuestion,
    ProfileAnswer,
    ProfileQuestion,
    VolumeAnswer,
    VolumeQuestion,
    area_answer,
    line_answer,
    profile_answer,
    profile_csv,
    profile_of,
    volume_answer,
)
from solmap.gis_server.analysis.planes import PlaneAnswer, PlaneQuestion, plane_answer
from solmap.gis_server.analysis.visibility import (
    FARTHEST_M,
    LineEnd,
    SightAnswer,
    Viewshed,
    ViewshedAnswer,
    compute_viewshed,
    line_of_sight,
    viewshed_answer,
    viewshed_png,
)
from solmap.gis_server.parameters import REVALIDATE, Metres, MissionName, ground_of
from solmap.gis_server.services import ServicesOf, map_layers
from solmap.photogrammetry.terrain.traversability.driving import DrivingParams
from solmap.photogrammetry.terrain.visibility.viewshed import ViewshedParams
from solmap.products.crs import local_crs
from solmap.products.formats.raster.raster import VISIBILITY_CLASSES, write_classes, write_raster

router = APIRouter(prefix="/api/missions/{mission}", tags=["analysis"])
_VIEWSHED = ViewshedParams()
Height = Annotated[float, Query(ge=0, le=100, description="above the ground, metres")]
Elevation = Annotated[
    float | None, Query(ge=-1e5, le=1e5, description="of the ground, where the map has none")
]
LayerId = Annotated[str, Query(max_length=200, description="a terrain model, or `best`")]
Unseen = Annotated[
    float, Query(ge=0, le=FARTHEST_M, description="longest unmapped stretch in a line of sight")
]
_DRIVING = DrivingParams()
LONGEST_DRIVE_M = 500.0
Farthest = Annotated[float, Query(gt=0, le=LONGEST_DRIVE_M, description="longest way, metres")]
Gap = Annotated[
    float,
    Query(ge=0, le=5, description="unknown ground less wide than this is driven over, metres"),
]
Stand = Annotated[
    float, Query(ge=0, le=10, description="unknown ground so near the start is safe, metres")
]
Interval = Annotated[
    float, Query(ge=0.1, le=LONGEST_DRIVE_M, description="of driving, between isochrones, metres")
]
Speed = Annotated[float, Query(gt=0, le=1000, description="metres an hour")]


def geotiff(name: str, write: Callable[[Path], None]) -> Response:
    """A GeoTIFF named `name` as a download; `write` writes it to a path."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        body = path.read_bytes()
    disposition = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(body, media_type="image/tiff", headers={**REVALIDATE, **disposition})


@router.post("/profile")
def profile(mission: MissionName, question: ProfileQuestion, services: ServicesOf) -> ProfileAnswer:
    """Elevation with its uncertainty, slope and source along a line."""
    ground = ground_of(mission, question.layer, services)
    return profile_answer(question, profile_of(question, ground), ground)


@router.post("/profile.csv", response_class=Response)
def profile_table(
    mission: MissionName, question: ProfileQuestion, services: ServicesOf
) -> Response:
    """The profile as a CSV table."""
    answer = profile(mission, question, services)
    return Response(
        profile_csv(answer),
        media_type="text/csv; charset=utf-8",
        headers={"content-disposition": 'attachment; filename="profile.csv"'},
    )


@router.post("/measure-line")
def line(mission: MissionName, question: LineQuestion, services: ServicesOf) -> LineAnswer:
    """Length on the map and along the ground, azimuths, and the slope between both ends."""
    landing = services.catalogue.mission(mission).landing
    return line_answer(question, ground_of(mission, question.layer, services), landing)


@router.post("/measure-area")
def area(mission: MissionName, question: AreaQuestion, services: ServicesOf) -> AreaAnswer:
    """Area on the map and of the ground."""
    return area_answer(question, ground_of(mission, question.layer, services))


@router.post("/volume")
def volume(mission: MissionName, question: VolumeQuestion, services: ServicesOf) -> VolumeAnswer:
    """Volume of the ground over or below a base, with its standard deviation."""
    return volume_answer(question, ground_of(mission, question.layer, services))


@router.post("/plane-fit")
def plane_fit(mission: MissionName, question: PlaneQuestion, services: ServicesOf) -> PlaneAnswer:
    """Strike and dip, with errors, of the plane through picked points or a polygon of ground."""
    return plane_answer(question, ground_of(mission, question.layer, services))


@router.post("/zonal")
def zonal_statistics(
    mission: MissionName, question: ZonalQuestion, services: ServicesOf
) -> ZonalAnswer:
    """Statistics of a raster layer over a polygon."""
    services.catalogue.mission(mission)
    for layer in map_layers(mission, services):
        if layer.id == question.layer:
            return zonal_answer(question, layer, services.store, services.pool)
    raise UnanswerableError(f"{question.layer} is not a layer of {mission}; /layers lists them")


def _viewshed(  # noqa: PLR0913 - the query
    *,
    mission: MissionName,
    services: ServicesOf,
    east: Metres,
    north: Metres,
    mast_m: Height = _VIEWSHED.eye_height_m,
    target_m: Height = _VIEWSHED.target_height_m,
    radius_m: Annotated[float, Query(gt=0, le=FARTHEST_M)] = 50.0,
    max_unseen_m: Unseen = _VIEWSHED.max_unseen_m,
    elevation: Elevation = None,
    layer: LayerId = BEST,
) -> Viewshed:
    params = ViewshedParams(mast_m, target_m, max_unseen_m, radius_m)
    ground = ground_of(mission, layer, services)
    return compute_viewshed((east, north), elevation, params, ground)


ViewshedHere = Annotated[Viewshed, Depends(_viewshed)]
"""The viewshed of a query."""


@router.get("/viewshed")
def viewshed(seen: ViewshedHere, request: Request, response: Response) -> ViewshedAnswer:
    """The ground that can be seen from an eye on a mast: areas, and what is visible as GeoJSON."""
    response.headers.update(REVALIDATE)
    return viewshed_answer(seen, request.url.query, request.url.path)


@router.get("/viewshed.png", response_class=Response)
def viewshed_image(seen: ViewshedHere) -> Response:
    """The viewshed as an image on the bounds from /viewshed: visible blue, hidden brown."""
    return Response(viewshed_png(seen), media_type="image/png", headers=REVALIDATE)


@router.get("/viewshed.tif", response_class=Response)
def viewshed_geotiff(mission: MissionName, seen: ViewshedHere, services: ServicesOf) -> Response:
    """The viewshed as a GeoTIFF of classes in the local CRS."""
    crs = local_crs(services.catalogue.mission(mission).landing)
    return geotiff(
        "viewshed.tif",
        lambda path: write_classes(
            path, seen.grid, seen.sight, crs, name="sight", classes=VISIBILITY_CLASSES
        ),
    )


@router.get("/line-of-sight")
def sight(  # noqa: PLR0913 - the query
    *,
    mission: MissionName,
    services: ServicesOf,
    east: Metres,
    north: Metres,
    to_east: Metres,
    to_north: Metres,
    eye_m: Height = _VIEWSHED.eye_height_m,
    target_m: Height = _VIEWSHED.target_height_m,
    elevation: Elevation = None,
    to_elevation: Elevation = None,
    max_unseen_m: Unseen = _VIEWSHED.max_unseen_m,
    layer: LayerId = BEST,
) -> SightAnswer:
    """Whether a target can be seen from an eye, with the ground between and the obstruction."""
    ground = ground_of(mission, layer, services)
    eye = LineEnd((east, north), elevation, eye_m)
    target = LineEnd((to_east, to_north), to_elevation, target_m)
    return line_of_sight(eye, target, max_unseen_m, ground)


def _find_drives(  # noqa: PLR0913 - the query
    *,
    mission: MissionName,
    services: ServicesOf,
    east: Metres,
    north: Metres,
    farthest_m: Farthest = 50.0,
    gap_m: Gap = _DRIVING.gap_m,
    stand_m: Stand = _DRIVING.stand_m,
) -> Drives:
    ground = ground_of(mission, BEST, services)
    params = DrivingParams(stand_m, gap_m, farthest_m)
    return find_drives((east, north), params, map_layers(mission, services), ground)


DrivesHere = Annotated[Drives, Depends(_find_drives)]
"""The paths from the point of a query."""


@router.get("/reach")
def reachable(
    drives: DrivesHere,
    request: Request,
    response: Response,
    interval_m: Interval = 5.0,
    speed_m_h: Speed = USUAL_SPEED_M_H,
) -> ReachAnswer:
    """Driving distances of a rover to the ground around it, past all hazards, as GeoJSON.

    There are at most 50 isochrones; ground beyond the last belongs to it.
    """
    response.headers.update(REVALIDATE)
    interval_m = max(interval_m, drives.params.farthest_m / MOST_BANDS)
    return reach_answer(drives, interval_m, speed_m_h, request.url.query, request.url.path)


@router.get("/reach.png", response_class=Response)
def reach_image(drives: DrivesHere, interval_m: Interval = 5.0) -> Response:
    """The driving distances as an image on the bounds from /reach: near is yellow, far is blue."""
    interval_m = max(interval_m, drives.params.farthest_m / MOST_BANDS)
    return Response(reach_png(drives, interval_m), media_type="image/png", headers=REVALIDATE)


@router.get("/reach.tif", response_class=Response)
def reach_geotiff(mission: MissionName, drives: DrivesHere, services: ServicesOf) -> Response:
    """The metres driven to every cell, as a GeoTIFF in the local CRS; NaN where no route leads."""
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
    response.headers.update(REVALIDATE)
    return route_answer(drives, (to_east, to_north), speed_m_h)
