"""Server-sent events of what is published, and of runs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Depends, Header, HTTPException, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent

from solmap.gis_server.budgets import client_of
from solmap.gis_server.live import TooManyListenersError
from solmap.gis_server.parameters import LARGEST_ID
from solmap.gis_server.services import ServicesOf
from solmap.products.catalogue.events import Event

router = APIRouter(prefix="/api", tags=["live"])
_RETRY_MS = 2000
RELOAD = "reload"
"""Events were missed that are no longer available: reload everything."""
Mission = Annotated[
    str | None, Query(max_length=64, description="leave out the events of other missions")
]
Number = Annotated[
    int | None, Query(ge=0, le=LARGEST_ID, description="the last event that was seen")
]
SeenHeader = Annotated[str | None, Header(alias="Last-Event-ID", max_length=20)]


async def _queue(
    services: ServicesOf, request: Request
) -> AsyncIterator[asyncio.Queue[Event | None]]:
    try:
        async with services.tail.listening(client_of(request.scope)) as queue:
            yield queue
    except TooManyListenersError as error:
        status = 429 if error.are_of_client else 503
        raise HTTPException(status, str(error), headers={"Retry-After": "30"}) from error


Queue = Annotated[asyncio.Queue[Event | None], Depends(_queue)]


@router.get("/events", response_class=EventSourceResponse)
async def events(
    queue: Queue,
    services: ServicesOf,
    request: Request,
    mission: Mission = None,
    since: Number = None,
    last_event_id: SeenHeader = None,
) -> AsyncIterable[ServerSentEvent]:
    """Events of the store as they happen: `layers.published`, `run.changed` and others.

    Every event has a number; a client that reconnects with its last one (`Last-Event-ID`, which
    browsers send by themselves, or `since`) gets the missed ones. `reload` means that these are no
    longer available. A comment line every 15 s keeps the connection open.
    """
    if request.method == "HEAD":
        return
    seen = _last_seen(since, last_event_id)
    missed = [] if seen is None else await services.tail.events_after(seen)
    reached = await services.tail.newest() if seen is None or missed is None else seen
    yield ServerSentEvent(event="hello", data={}, id=str(reached), retry=_RETRY_MS)
    if missed is None:
        yield ServerSentEvent(event=RELOAD, data={}, id=str(reached))
    for event in missed or ():
        reached = event.id
        if _concerns(event, mission):
            yield _server_event(event)
    while True:
        fresh = await queue.get()
        if fresh is None:
            reached = await services.tail.newest()
            yield ServerSentEvent(event=RELOAD, data={}, id=str(reached))
        elif fresh.id > reached:
            reached = fresh.id
            if _concerns(fresh, mission):
                yield _server_event(fresh)


def _last_seen(since: int | None, header: str | None) -> int | None:
    """Number of the last event; the header is newer than the URL on a reconnection."""
    if not (header and header.isascii() and header.isdigit()):
        return since
    return min(int(header), LARGEST_ID)


def _concerns(event: Event, mission: str | None) -> bool:
    return mission is None or event.document.get("mission", mission) == mission


def _server_event(event: Event) -> ServerSentEvent:
    return ServerSentEvent(
        event=event.kind, data={**event.document, "at": event.at}, id=str(event.id)
    )
