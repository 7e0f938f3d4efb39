"""Live events: events that processes write to the catalogue, sent to every listening browser.

Any process may publish. Each server polls the database four times a second, which SQLite answers
from memory (`PRAGMA data_version`), reads new events once, and puts them into the queues of its
listeners; without listeners it does not poll. A listener whose queue is full gets a request to
reload everything, so that memory stays bounded.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable, Collection
from dataclasses import dataclass, field

import sqlalchemy as sa
from anyio.to_thread import run_sync
from sqlalchemy.exc import SQLAlchemyError

from solmap.products.catalogue.events import Event, events_since, is_gone, last_event

log = logging.getLogger(__name__)
POLL_INTERVAL_S = 0.25
MOST_LISTENERS, MOST_OF_ONE = 500, 100
"""Most listeners, each with a connection and a queue; and most of one client."""
_QUEUE = 256
"""Most events by which a listener may lag."""


class TooManyListenersError(Exception):
    """All slots for listeners, or all of one client, are taken."""

    def __init__(self, most: int, *, are_of_client: bool) -> None:
        whose = "of yours listen" if are_of_client else "listen"
        super().__init__(f"{most} browsers {whose} already; try again later")
        self.are_of_client = are_of_client


@dataclass(slots=True, eq=False)
class EventTail:
    """The end of the table of events, watched for the listeners of this process."""

    engine: sa.Engine
    most: int = MOST_LISTENERS
    most_of_one: int = MOST_OF_ONE
    before: Callable[[Collection[Event]], None] | None = None
    """Called in a thread before listeners get new events."""
    _listeners: dict[asyncio.Queue[Event | None], str] = field(default_factory=dict)
    """Queues and their clients."""
    _has_listeners: asyncio.Event = field(default_factory=asyncio.Event)
    """Set while anybody listens."""
    _task: asyncio.Task[None] | None = None
    _last: int = 0

    @contextlib.asynccontextmanager
    async def listening(self, client: str = "") -> AsyncIterator[asyncio.Queue[Event | None]]:
        """A queue of new events for a client; None in it means that events were left out.

        Raises:
            TooManyListenersError: all slots are taken.
        """
        if list(self._listeners.values()).count(client) >= self.most_of_one:
            raise TooManyListenersError(self.most_of_one, are_of_client=True)
        if len(self._listeners) >= self.most:
            raise TooManyListenersError(self.most, are_of_client=False)
        queue: asyncio.Queue[Event | None] = asyncio.Queue(_QUEUE)
        if not self._listeners:
            self._last = await run_sync(self._newest)
        if self._task is None:
            self._task = asyncio.create_task(self._watch())
        self._listeners[queue] = client
        self._has_listeners.set()
        try:
            yield queue
        finally:
            self._listeners.pop(queue, None)
            if not self._listeners:
                self._has_listeners.clear()

    @property
    def listeners(self) -> int:
        """Number of listeners."""
        return len(self._listeners)

    async def events_after(self, event_id: int) -> list[Event] | None:
        """Events after `event_id`, or None if some of them were removed."""
        return await run_sync(self._read_events_after, event_id)

    async def newest(self) -> int:
        """The number of the last event."""
        return await run_sync(self._newest)

    def close(self) -> None:
        """Stop watching at the end of the server."""
        if self._task is not None:
            self._task.cancel()

    async def _watch(self) -> None:
        """Follow the table while there are listeners, also after errors."""
        while True:
            await self._has_listeners.wait()
            try:
                with self.engine.connect() as connection:
                    await self._follow(connection)
            except SQLAlchemyError as error:
                log.warning("events could not be read; retrying: %s", error)
                await asyncio.sleep(POLL_INTERVAL_S)

    async def _follow(self, connection: sa.Connection) -> None:
        """Send new events, until no client listens."""
        seen = -1
        while self._listeners:
            seen, fresh = await run_sync(self._poll, connection, seen)
            if fresh and self.before is not None:
                await run_sync(self.before, fresh)
            for event in fresh:
                self._distribute(event)
            await asyncio.sleep(POLL_INTERVAL_S)

    def _distribute(self, event: Event) -> None:
        self._last = event.id
        for queue in self._listeners:
            if queue.full():
                while not queue.empty():
                    queue.get_nowait()
                queue.put_nowait(None)
            else:
                queue.put_nowait(event)

    def _poll(self, connection: sa.Connection, seen: int) -> tuple[int, list[Event]]:
        """The version of the database, and new events if it differs from `seen`."""
        version = seen + 1
        if self.engine.dialect.name == "sqlite":
            version = connection.exec_driver_sql("PRAGMA data_version").scalar_one()
        fresh = [] if version == seen else events_since(connection, self._last)
        connection.rollback()  # holds no snapshot meanwhile
        return version, fresh

    def _newest(self) -> int:
        with self.engine.connect() as connection:
            return last_event(connection)

    def _read_events_after(self, event_id: int) -> list[Event] | None:
        with self.engine.connect() as connection:
            if is_gone(connection, event_id):
                return None
            return events_since(connection, event_id)
