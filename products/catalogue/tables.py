"""The tables of the catalogue, and how they are written to."""

from __future__ import annotations

import json
from typing import Any

import sqlalchemy as sa

from solmap.products.catalogue.database import Text, upsert
from solmap.products.model import ProductRef

TABLES = sa.MetaData()
MISSIONS = sa.Table(
    "missions",
    TABLES,
    sa.Column("mission", Text, primary_key=True),
    sa.Column("document", sa.JSON, nullable=False),
)
IMAGES = sa.Table(
    "images",
    TABLES,
    sa.Column("id", Text, primary_key=True),
    sa.Column("mission", Text, nullable=False, index=True),
    sa.Column("stop", Text, nullable=False, index=True),
    sa.Column("sol", sa.Integer, nullable=False, index=True),
    sa.Column("document", sa.JSON, nullable=False),
)
LAYERS = sa.Table(
    "layers",
    TABLES,
    sa.Column("scope", Text, primary_key=True),
    sa.Column("kind", Text, primary_key=True),
    sa.Column("digest", Text, primary_key=True),
    sa.Column("mission", Text, nullable=False, index=True),
    sa.Column("document", sa.JSON, nullable=False),
)
LATEST = sa.Table(
    "latest",
    TABLES,
    sa.Column("scope", Text, primary_key=True),
    sa.Column("kind", Text, primary_key=True),
    sa.Column("digest", Text, nullable=False),
)
OUTCOMES = sa.Table(
    "outcomes",
    TABLES,
    sa.Column("subject", Text, primary_key=True),
    sa.Column("document", sa.JSON, nullable=False),
)

RUNS = sa.Table(
    "runs",
    TABLES,
    sa.Column("id", Text, primary_key=True),
    sa.Column("started_at", Text, nullable=False, index=True),
    sa.Column("document", sa.JSON, nullable=False),
)

INGESTED = sa.Table(
    "ingested",
    TABLES,
    sa.Column("mission", Text, primary_key=True),
    sa.Column("times", sa.Integer, nullable=False),
)
"""How often images of a mission were taken in, anew or for the first time."""

FINISHED = sa.Table(
    "finished",
    TABLES,
    sa.Column("scope", Text, primary_key=True),
    sa.Column("key", Text, nullable=False),
    sa.Column("document", sa.JSON, nullable=False),
)

LABELS = sa.Table(
    "labels",
    TABLES,
    sa.Column("digest", Text, primary_key=True),
    sa.Column("document", Text, nullable=False),
)


def keys_of(ref: ProductRef) -> dict[str, str]:
    """The columns of what is the latest of a scope and kind."""
    return {"scope": ref.scope.name, "kind": str(ref.kind)}


def put(
    connection: sa.Connection,
    table: sa.Table,
    keys: dict[str, Any],
    document: dict[str, Any],
    **columns: Any,  # noqa: ANN401 - column values
) -> bool:
    """Insert or replace a row; whether it says anything new."""
    where = sa.and_(*(table.c[name] == value for name, value in keys.items()))
    before = connection.execute(sa.select(table.c.document).where(where)).scalar_one_or_none()
    if before is not None and before == json.loads(json.dumps(document)):
        return False
    upsert(connection, table, keys, {**columns, "document": document})
    return True


def point(connection: sa.Connection, ref: ProductRef) -> bool:
    """Move the pointer of a scope and kind; whether it moved."""
    keys = keys_of(ref)
    where = sa.and_(LATEST.c.scope == keys["scope"], LATEST.c.kind == keys["kind"])
    before = connection.execute(sa.select(LATEST.c.digest).where(where)).scalar_one_or_none()
    if before == ref.digest:
        return False
    upsert(connection, LATEST, keys, {"digest": ref.digest})
    return True


def count_ingested(connection: sa.Connection, mission: str, images: int) -> None:
    """Count images that were taken in, so that others see that there are some."""
    before = times_ingested(connection, mission)
    upsert(connection, INGESTED, {"mission": mission}, {"times": before + images})


def times_ingested(connection: sa.Connection, mission: str) -> int:
    """How many images of a mission were ever taken in."""
    query = sa.select(INGESTED.c.times).where(INGESTED.c.mission == mission)
    return connection.execute(query).scalar_one_or_none() or 0
