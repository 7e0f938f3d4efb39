"""Missions, their layers and images, and what lies at a place."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

from fastapi import APIRouter, Path, Query, Response
from fastapi.responses import HTMLResponse
from pydantic import TypeAdapter

from solmap.gis_server.kept_answers import AskerOf, KeptAnswer
from solmap.gis_server.rendering.identify import identify
from solmap.gis_server.routes.bodies import (
    Image,
    MapLayer,
    Mission,
    Place,
    image_body,
    layer_body,
    mission_body,
    place_body,
)
from solmap.gis_server.routes.parameters import AGAIN, LAST_SOL, Metres, MissionName
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import Layer
from solmap.products.reports.sol_report import sol_report

router = APIRouter(prefix="/api/missions", tags=["missions"])
_IMAGES = TypeAdapter(list[Image])
_KEPT = 16
"""Lists of images; one of 10,000 is 4 MB."""


@router.get("")
def missions(services: ServicesOf, response: Response) -> list[Mission]:
    """All missions, where their maps lie on Mars and how these are cut into tiles."""
    response.headers.update(AGAIN)
    return missions_of(services)


@router.get("/{mission}/layers")
def layers(mission: MissionName, services: ServicesOf, response: Response) -> list[MapLayer]:
    """The latest layer of every scope and kind."""
    response.headers.update(AGAIN)
    services.catalogue.mission(mission)
    return [layer_body(layer) for layer in map_layers(mission, services)]


@router.get("/{mission}/images", response_model=list[Image])
def images(
    mission: MissionName,
    services: ServicesOf,
    asker: AskerOf,
    sol: Annotated[int | None, Query(ge=0, le=LAST_SOL)] = None,
    stop: Annotated[str | None, Query(max_length=128)] = None,
) -> Response:
    """The images of a mission, sol or stop, with partner or why there is none."""
    services.catalogue.mission(mission)
    version = services.catalogue.images_version(mission)
    return asker.answer(_images(services, mission, stop, sol, version))


@lru_cache(maxsize=_KEPT)
def _images(
    services: Services, mission: str, stop: str | None, sol: int | None, _version: str
) -> KeptAnswer:
    """Of 10,000 images it takes a second to write."""
    found = [image_body(entry) for entry in services.catalogue.images(mission, stop, sol)]
    return KeptAnswer.of(_IMAGES.dump_json(found))


@router.get("/{mission}/sols/{sol}/report", response_class=HTMLResponse)
def sol_page(
    mission: MissionName, sol: Annotated[int, Path(ge=0, le=LAST_SOL)], services: ServicesOf
) -> HTMLResponse:
    """All that is known of a sol, on one page: images, matches, adjustment, layers, times."""
    workspace = Workspace(services.store, services.catalogue)
    return HTMLResponse(sol_report(mission, sol, workspace), headers=AGAIN)


@router.get("/{mission}/identify")
def identify_place(
    mission: MissionName, east: Metres, north: Metres, services: ServicesOf, response: Response
) -> Place:
    """What all layers say about a place: coordinates, elevation, values, stops and images."""
    response.headers.update(AGAIN)
    landing = services.catalogue.mission(mission).landing
    layers = map_layers(mission, services)
    found = identify(layers, east, north, services.store, services.pool)
    return place_body(landing, east, north, found)


def missions_of(services: Services) -> list[Mission]:
    """All missions of the store."""
    return [
        mission_body(entry, services.catalogue.layers(entry.mission))
        for entry in services.catalogue.missions()
    ]


def map_layers(mission: str, services: Services) -> list[Layer]:
    """The latest layers that are on the map: models and panoramas are looked at elsewhere."""
    latest = services.catalogue.layers(mission)
    return [layer for layer in latest if layer.type in {"raster", "vector"}]
