"""All that the first view of the map asks for, in one answer."""

from __future__ import annotations

from functools import lru_cache

from fastapi import APIRouter, Response
from pydantic import BaseModel

from solmap.gis_server.kept_answers import AskerOf, KeptAnswer
from solmap.gis_server.routes.bodies import MapLayer, Mission, layer_body
from solmap.gis_server.routes.missions import map_layers, missions_of
from solmap.gis_server.services import Services, ServicesOf

router = APIRouter(prefix="/api", tags=["missions"])
LAST_EVENT = "Last-Event-ID"
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


@router.get("/start", response_model=Start)
def start(services: ServicesOf, asker: AskerOf) -> Response:
    """All missions, and the layers of the first; written anew only when something was published.

    The header `Last-Event-ID` names the last event that is in it: who asks `/api/events` for those
    `since` misses none.
    """
    seen = services.catalogue.version()  # before all else: what happens meanwhile is told again
    answer = asker.answer(_written(services, services.catalogue.published()))
    answer.headers[LAST_EVENT] = str(seen)
    return answer


@lru_cache(maxsize=_KEPT)
def _written(services: Services, _version: int) -> KeptAnswer:
    found = missions_of(services)
    first = found[0].mission if found else None
    layers = [layer_body(layer) for layer in map_layers(first, services)] if first else []
    whole = Start(missions=found, mission=first, layers=layers)
    return KeptAnswer.of(whole.model_dump_json().encode())
