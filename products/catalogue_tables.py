"""The tables of the catalogue, and how they are written to."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine.interfaces import DBAPIConnection

from products.model import ProductRef

TABLES = sa.MetaData()
MISSIONS = sa.Table(
    "missions",
    TABLES,
    sa.Column("mission", sa.String, primary_key=True),
    sa.Column("document", sa.JSON, nullable=False),
)
IMAGES = sa.Table(
    "images",
    TABLES,
    sa.Column("id", sa.String, primary_key=True),
    sa.Column("mission", sa.String, nullable=False, index=True),
    sa.Column("stop", sa.String, nullable=False, index=True),
    sa.Column("sol", sa.Integer, nullable=False, index=True),
    sa.Column("document", sa.JSON, nullable=False),
)
LAYERS = sa.Table(
    "layers",
    TABLES,
    sa.Column("scope", sa.String, primary_key=True),
    sa.Column("kind", sa.String, primary_key=True),
    sa.Column("digest", sa.String, primary_key=True),
    sa.Column("mission", sa.String, nullable=False, index=True),
    sa.Column("document", sa.JSON, nullable=False),
)
LATEST = sa.Table(
    "latest",
    TABLES,
    sa.Column("scope", sa.String, primary_key=True),
    sa.Column("kind", sa.String, primary_key=True),
    sa.Column("digest", sa.String, nullable=False),
)
OUTCOMES = sa.Table(
    "outcomes",
    TABLES,
    sa.Column("subject", sa.String, primary_key=True),
    sa.Column("document", sa.JSON, nullable=False),
)

RUNS = sa.Table(
    "runs",
    TABLES,
    sa.Column("id", sa.String, primary_key=True),
    sa.Column("started_at", sa.String, nullable=False, index=True),
    sa.Column("document", sa.JSON, nullable=False),
)


def engine_of(path: Path, url: str | None = None) -> sa.Engine:
    """A database in a file, or at a URL."""
    engine = sa.create_engine(url or f"sqlite:///{path}")
    if engine.dialect.name == "sqlite":
        sa.event.listen(engine, "connect", _configure)
    return engine


def _configure(connection: DBAPIConnection, _record: object) -> None:
    """Readers never wait for a writer, and two writers wait for each other."""
    for pragma in ("journal_mode=WAL", "busy_timeout=30000", "synchronous=NORMAL"):
        connection.cursor().execute(f"PRAGMA {pragma}")


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
    connection.execute(table.delete().where(where))
    connection.execute(table.insert().values(**keys, **columns, document=document))
    return True


def point(connection: sa.Connection, ref: ProductRef) -> bool:
    """Move the pointer of a scope and kind; whether it moved."""
    keys = keys_of(ref)
    where = sa.and_(LATEST.c.scope == keys["scope"], LATEST.c.kind == keys["kind"])
    before = connection.execute(sa.select(LATEST.c.digest).where(where)).scalar_one_or_none()
    if before == ref.digest:
        return False
    connection.execute(LATEST.delete().where(where))
    connection.execute(LATEST.insert().values(**keys, digest=ref.digest))
    return True
