"""Measuring on the map: what is asked comes as a body, nothing is written."""

from __future__ import annotations

from fastapi import APIRouter, Response

from solmap.gis_server.analysis.ground import Ground
from solmap.gis_server.analysis.measures import (
    AreaAnswer,
    AreaQuestion,
    LineAnswer,
    LineQuestion,
    VolumeAnswer,
    VolumeQuestion,
    measured_area,
    measured_line,
    measured_volume,
)
from solmap.gis_server.analysis.planes import PlaneAnswer, PlaneQuestion, fitted_plane
from solmap.gis_server.analysis.profiles import (
    ProfileAnswer,
    ProfileQuestion,
    ask_profile,
    profile_answer,
    profile_csv,
)
from solmap.gis_server.analysis.refusal import RefusedError
from solmap.gis_server.analysis.zonal import ZonalAnswer, ZonalQuestion, zonal
from solmap.gis_server.routes.missions import map_layers
from solmap.gis_server.routes.parameters import MissionName
from solmap.gis_server.services import Services, ServicesOf

router = APIRouter(prefix="/api/missions/{mission}", tags=["analysis"])


def ground_of(mission: str, asked: str, services: Services) -> Ground:
    """The terrain models of a mission that a question names."""
    services.catalogue.mission(mission)
    return Ground.of(map_layers(mission, services), asked, services.store, services.pool)


@router.post("/profile")
def profile(mission: MissionName, question: ProfileQuestion, services: ServicesOf) -> ProfileAnswer:
    """Elevation with its uncertainty, slope and source along a line."""
    ground = ground_of(mission, question.layer, services)
    return profile_answer(question, ask_profile(question, ground), ground)


@router.post("/profile.csv", response_class=Response)
def profile_table(
    mission: MissionName, question: ProfileQuestion, services: ServicesOf
) -> Response:
    """The same as a table for spreadsheets."""
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
    return measured_line(question, ground_of(mission, question.layer, services), landing)


@router.post("/measure-area")
def area(mission: MissionName, question: AreaQuestion, services: ServicesOf) -> AreaAnswer:
    """Area on the map and of the ground."""
    return measured_area(question, ground_of(mission, question.layer, services))


@router.post("/volume")
def volume(mission: MissionName, question: VolumeQuestion, services: ServicesOf) -> VolumeAnswer:
    """Volume of the ground over or below a base, with its standard deviation."""
    return measured_volume(question, ground_of(mission, question.layer, services))


@router.post("/plane-fit")
def plane_fit(mission: MissionName, question: PlaneQuestion, services: ServicesOf) -> PlaneAnswer:
    """Strike and dip, with errors, of the plane through picked points or a polygon of ground."""
    return fitted_plane(question, ground_of(mission, question.layer, services))


@router.post("/zonal")
def zonal_statistics(
    mission: MissionName, question: ZonalQuestion, services: ServicesOf
) -> ZonalAnswer:
    """Statistics of a raster layer over a polygon."""
    services.catalogue.mission(mission)
    for layer in map_layers(mission, services):
        if layer.id == question.layer:
            return zonal(question, layer, services.store, services.pool)
    raise RefusedError(f"{question.layer} is no layer of {mission}; /layers lists them")
