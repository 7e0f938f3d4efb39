"""Events: changes in a store, in order, for browsers that listen.

Event numbers are in the order of commits (`write_transaction` permits one writer at a time): after
number 7 no 6 can follow.

Events are rows that are only appended, in the transaction that makes the change, and deleted when
they are old or many newer ones exist. A browser that reconnects requests those after its last one;
where these are deleted already, `is_gone` is true and the browser reloads everything.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from solmap.products.catalogue.database import TABLES, Text

KEPT = 10_000
"""Most events kept; a downlink makes some hundred."""
LAYERS_PUBLISHED, IMAGES_INGESTED, MISSION_CHANGED = (
    "layers.published",
    "images.ingested",
    "mission.changed",
)
PUBLICATIONS = LAYERS_PUBLISHED, IMAGES_INGESTED, MISSION_CHANGED
RUN_CHANGED, EDITS_CHANGED, REQUESTS_CHANGED = "run.changed", "edits.changed", "requests.changed"
ENGINE_CHANGED = "engine.changed"
EVENTS = sa.Table(
    "events",
    TABLES,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
    sa.Column("kind", Text, nullable=False),
    sa.Column("document", sa.JSON, nullable=False),
    sa.Column("at", Text, nullable=False),
)


@dataclass(frozen=True, slots=True)
class Event:
    """A change that browsers are notified of."""

    id: int
    kind: str
    document: dict[str, Any]
    at: str
    """UTC, ISO 8601."""


def append(connection: sa.Connection, kind: str, document: dict[str, Any]) -> None:
    """Add an event within the transaction that makes the change."""
    at = datetime.now(UTC).isoformat(timespec="milliseconds")
    added = connection.execute(EVENTS.insert().values(kind=kind, document=document, at=at))
    (number,) = added.inserted_primary_key or (0,)
    connection.execute(EVENTS.delete().where(EVENTS.c.id <= number - KEPT))


def events_since(connection: sa.Connection, event_id: int) -> list[Event]:
    """Events after `event_id`, oldest first."""
    query = sa.select(EVENTS).where(EVENTS.c.id > event_id).order_by(EVENTS.c.id)
    return [Event(*row) for row in connection.execute(query)]


def last_event(connection: sa.Connection, kinds: Collection[str] = ()) -> int:
    """The number of the newest event, of any kind or of some; 0 before the first."""
    query = sa.select(EVENTS.c.id).order_by(EVENTS.c.id.desc()).limit(1)
    if kinds:
        query = query.where(EVENTS.c.kind.in_(kinds))
    return connection.execute(query).scalar_one_or_none() or 0


def trim_events(connection: sa.Connection, before: str) -> None:
    """Delete the events before a time, except those since the last publication.

    The remaining ones have no gaps, and the newest stays, so that numbering continues.
    """
    recent = connection.execute(sa.select(sa.func.min(EVENTS.c.id)).where(EVENTS.c.at >= before))
    first = recent.scalar_one() or last_event(connection)
    published = last_event(connection, PUBLICATIONS) or first
    connection.execute(EVENTS.delete().where(EVENTS.c.id < min(first, published)))


def is_gone(connection: sa.Connection, event_id: int) -> bool:
    """Whether events after `event_id` have been deleted."""
    oldest = connection.execute(sa.select(sa.func.min(EVENTS.c.id))).scalar_one()
    return oldest is not None and event_id + 1 < oldest
