"""State of the engine: deployments and waiting runs; pausing and resuming.

The server does not control the engine: `solmap up` records its state and processes requests.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Path, Response

from solmap.gis_server.collaboration.accounts import Operator
from solmap.gis_server.parameters import REVALIDATE
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.edits import RequestKind, RunRequest
from solmap.products.catalogue.engine_state import (
    DeploymentState,
    EngineState,
    read_engine_state,
)
from solmap.products.catalogue.events import REQUESTS_CHANGED

router = APIRouter(prefix="/api/engine", tags=["runs"])
Name = Annotated[str, Path(pattern=r"^[A-Za-z0-9-]{1,64}$")]


@router.get("")
def engine(services: ServicesOf, response: Response) -> EngineState:
    """Whether the engine is up, its deployments with their schedules, and the runs that wait."""
    response.headers.update(REVALIDATE)
    return read_engine_state(services.store.root)


@router.post("/deployments/{flow}/{name}/pause", status_code=202)
def pause(flow: Name, name: Name, services: ServicesOf, who: Operator) -> RunRequest:
    """Pause the schedule of a deployment; runs may still be requested."""
    found = _deployment(f"{flow}/{name}", services)
    if found.is_paused:
        raise HTTPException(409, f"{found.name} is paused already")
    given = {"deployment": found.name}
    return add_request(services, RequestKind.PAUSE, None, who.name, given)


@router.post("/deployments/{flow}/{name}/resume", status_code=202)
def resume(flow: Name, name: Name, services: ServicesOf, who: Operator) -> RunRequest:
    """Start the scheduled runs of a deployment again."""
    found = _deployment(f"{flow}/{name}", services)
    if not found.is_paused:
        raise HTTPException(409, f"{found.name} is not paused")
    given = {"deployment": found.name}
    return add_request(services, RequestKind.RESUME, None, who.name, given)


def require_engine(services: Services) -> EngineState:
    """The state of the running engine.

    Raises:
        HTTPException: 503, it does not run.
    """
    state = read_engine_state(services.store.root)
    if not state.is_up:
        raise HTTPException(503, f"the engine is down: {state.trouble}", {"Retry-After": "30"})
    return state


def add_request(
    services: Services,
    kind: RequestKind,
    mission: str | None,
    author: str,
    parameters: Mapping[str, Any],
) -> RunRequest:
    """Store a request for `solmap up`, with an event; an identical waiting one is not repeated."""
    request = services.requests.add(kind, mission, author, parameters)
    services.catalogue.append_event(
        REQUESTS_CHANGED, {"request": request.id, "state": str(request.state)}
    )
    return request


def _deployment(name: str, services: Services) -> DeploymentState:
    for found in require_engine(services).deployments:
        if found.name == name:
            return found
    raise HTTPException(404, f"the engine has no deployment {name}")
