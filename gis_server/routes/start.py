"""All that the first view of the map asks for, in one answer."""

from __future__ import annotations

from functools import lru_cache
from hashlib import blake2b
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Header, Response
from pydantic import BaseModel

from gis_server.routes.bodies import MapLayer, Mission, layer_body
from gis_server.routes.missions import map_layers, missions_of
from gis_server.routes.parameters import AGAIN
from gis_server.services import Services, ServicesOf

router = APIRouter(prefix="/api", tags=["missions"])
_KEPT = 2
"""Answers; of 96 layers it is 50 kB."""


class Start(BaseModel):
    """Where the map begins."""

    missions: list[Mission]
    """All of the store."""
    mission: str | None
    """The one whose layers these are: the first; null if there is none."""
    layers: list[MapLayer]
    """The latest layer of every scope and kind."""


SeenBefore = Annotated[str, Header(alias="If-None-Match", max_length=200)]


@router.get("/start", response_model=Start)
def start(services: ServicesOf, known: SeenBefore = "") -> Response:
    """All missions, and the layers of the first; written anew only when something was published."""
    body, tag = _written(services, services.catalogue.published())
    headers = {**AGAIN, "ETag": tag}
    if known == tag:
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    return Response(body, media_type="application/json", headers=headers)


@lru_cache(maxsize=_KEPT)
def _written(services: Services, _version: int) -> tuple[bytes, str]:
    """The answer and a tag that is another when its content is."""
    found = missions_of(services)
    first = found[0].mission if found else None
    layers = [layer_body(layer) for layer in map_layers(first, services)] if first else []
    body = Start(missions=found, mission=first, layers=layers).model_dump_json().encode()
    return body, f'W/"{blake2b(body, digest_size=8).hexdigest()}"'
