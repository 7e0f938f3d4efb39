"""What can be seen from where: viewsheds as areas, picture and GeoTIFF, and lines of sight."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response

from solmap.gis_server.analysis.ground import BEST
from solmap.gis_server.analysis.sight import FARTHEST_M, End, SightAnswer, line_of_sight
from solmap.gis_server.analysis.viewsheds import (
    Seen,
    ViewshedAnswer,
    seen_from,
    viewshed_answer,
    viewshed_png,
)
from solmap.gis_server.routes.analysis import ground_of
from solmap.gis_server.routes.geotiffs import geotiff
from solmap.gis_server.routes.parameters import AGAIN, Metres, MissionName
from solmap.gis_server.services import ServicesOf
from solmap.photogrammetry.terrain.visibility.viewshed import ViewshedParams
from solmap.products.crs import local_crs
from solmap.products.formats.raster.raster import SIGHTS, write_classes

router = APIRouter(prefix="/api/missions/{mission}", tags=["analysis"])
_USUAL = ViewshedParams()
Height = Annotated[float, Query(ge=0, le=100, description="above the ground, metres")]
Elevation = Annotated[
    float | None, Query(ge=-1e5, le=1e5, description="of the ground, where the map knows none")
]
LayerId = Annotated[str, Query(max_length=200, description="a terrain model, or `best`")]
Unseen = Annotated[
    float, Query(ge=0, le=FARTHEST_M, description="longest unmapped stretch that is looked over")
]


def _seen(  # noqa: PLR0913 - the query
    *,
    mission: MissionName,
    services: ServicesOf,
    east: Metres,
    north: Metres,
    mast_m: Height = _USUAL.eye_height_m,
    target_m: Height = _USUAL.target_height_m,
    radius_m: Annotated[float, Query(gt=0, le=FARTHEST_M)] = 50.0,
    max_unseen_m: Unseen = _USUAL.max_unseen_m,
    elevation: Elevation = None,
    layer: LayerId = BEST,
) -> Seen:
    params = ViewshedParams(mast_m, target_m, max_unseen_m, radius_m)
    ground = ground_of(mission, layer, services)
    return seen_from((east, north), elevation, params, ground)


SeenHere = Annotated[Seen, Depends(_seen)]
"""The viewshed that a query asks for."""


@router.get("/viewshed")
def viewshed(seen: SeenHere, request: Request, response: Response) -> ViewshedAnswer:
    """The ground that can be seen from an eye on a mast: areas, and what is visible as GeoJSON."""
    response.headers.update(AGAIN)
    return viewshed_answer(seen, request.url.query, request.url.path)


@router.get("/viewshed.png", response_class=Response)
def viewshed_picture(seen: SeenHere) -> Response:
    """The same as a picture on the bounds that /viewshed tells: visible blue, hidden brown."""
    return Response(viewshed_png(seen), media_type="image/png", headers=AGAIN)


@router.get("/viewshed.tif", response_class=Response)
def viewshed_geotiff(mission: MissionName, seen: SeenHere, services: ServicesOf) -> Response:
    """The same as a GeoTIFF of classes in the local CRS."""
    crs = local_crs(services.catalogue.mission(mission).landing)
    return geotiff(
        "viewshed.tif",
        lambda path: write_classes(path, seen.grid, seen.sight, crs, name="sight", classes=SIGHTS),
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
    eye_m: Height = _USUAL.eye_height_m,
    target_m: Height = _USUAL.target_height_m,
    elevation: Elevation = None,
    to_elevation: Elevation = None,
    max_unseen_m: Unseen = _USUAL.max_unseen_m,
    layer: LayerId = BEST,
) -> SightAnswer:
    """Whether a target can be seen from an eye, with the ground between and what is in the way."""
    ground = ground_of(mission, layer, services)
    eye = End((east, north), elevation, eye_m)
    target = End((to_east, to_north), to_elevation, target_m)
    return line_of_sight(eye, target, max_unseen_m, ground)
