"""Measuring on the map: what is asked comes as a body, nothing is written."""

from __future__ import annotations

from fastapi import APIRouter, Response

from gis_server.analysis.ground import Ground
from gis_server.analysis.profiles import (
    ProfileAnswer,
    ProfileQuestion,
    ask_profile,
    profile_answer,
    profile_csv,
)
from gis_server.routes.missions import map_layers
from gis_server.routes.parameters import MissionName
from gis_server.services import Services, ServicesOf

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
