"""Databases of the catalogue, SQLite in the store's folder or PostgreSQL at a URL, and its tables.

SQLite permits one writer at a time. PostgreSQL permits many, but then events could get their
numbers in another order than their transactions commit, and a request for events "after number 7"
would miss a 6 that is committed later. Writers therefore take turns there too (an advisory lock
that ends with the transaction, even if its process is killed): numbers are in the order of commits,
and data read by a writer stay valid until it has written. Readers never wait.

Databases of a read-only store are opened so that SQLite writes nothing beside them. One that its
owner has open is read with its write-ahead log; otherwise it is read as an immutable file. Every
query opens it again, so that later changes by the owner are read.
"""

from __future__ import annotations

import atexit
import json
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, lru_cache, partial
from pathlib import Path
from threading import Lock
from time import monotonic, sleep
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.exc import (
    ArgumentError,
    DatabaseError,
    DBAPIError,
    NoSuchModuleError,
    OperationalError,
)

from solmap.products.errors import ProductError, StoreAwayError, StoreFullError
from solmap.products.model import ProductRef
from solmap.products.store.faults import (
    is_database_full,
    is_disk_full,
    is_read_only,
    require_writable,
)

Text = sa.String().with_variant(sa.String(collation="C"), "postgresql")
"""Text type that both sort by bytes, independent of the database's language."""
_WRITES = "solmap_writes"
_TURN = 0x501_3A9
"""Number of the writers' lock among PostgreSQL's advisory locks; other programs use others."""
_WAIT_S = 30
"""Waiting time for another writer."""
_CONNECT_S = 10
_PRIMARY_CODE = 0xFF
"""Mask of the primary part of an SQLite error code; the rest is detail."""
_SPARE = 20
"""Connections beyond the pool's five, while so many requests are answered at once."""


def engine_of(path: Path, url: str | None = None) -> sa.Engine:
    """A database in a file, or at a URL; one connection pool per URL."""
    if not url and is_read_only(path):
        return _read_only_engine(path)
    if not url:
        return _engine(f"sqlite:///{path}")
    with _AT_URLS_LOCK:
        if url not in _AT_URLS:
            _AT_URLS[url] = _engine(url)
        return _AT_URLS[url]


def close_pools() -> None:
    """Close the connections to databases at URLs; an engine that is used again opens new ones.

    An engine is never dropped before that: its connections would stay open until garbage
    collection, which would warn.
    """
    with _AT_URLS_LOCK:
        for engine in _AT_URLS.values():
            engine.dispose()
        _AT_URLS.clear()


_AT_URLS: dict[str, sa.Engine] = {}
_AT_URLS_LOCK = Lock()
atexit.register(close_pools)


def _engine(url: str) -> sa.Engine:
    try:
        dialect = sa.make_url(url).get_dialect().name
        if dialect == "sqlite":
            engine = sa.create_engine(url)
            sa.event.listen(engine, "connect", _configure)
            sa.event.listen(engine, "begin", _begin)
            return engine
        if dialect != "postgresql":
            raise ProductError(f"the catalogue cannot lie in {dialect}; {_URLS}")
        options = {"connect_timeout": _CONNECT_S}
        return sa.create_engine(
            url, pool_pre_ping=True, max_overflow=_SPARE, connect_args=options, hide_parameters=True
        )
    except (ArgumentError, NoSuchModuleError, ModuleNotFoundError) as error:
        raise ProductError(f"the catalogue's URL cannot be used: {error}; {_URLS}") from error
    except ValueError:  # its text may be a part of the password
        raise ProductError(f"the port in the catalogue's URL is not a number; {_URLS}") from None


def _read_only_engine(path: Path) -> sa.Engine:
    if not path.is_file():
        raise ProductError(f"{path.parent} has no catalogue, and none can be created there")
    creator = partial(read_only_connection, path)
    engine = sa.create_engine("sqlite://", creator=creator, poolclass=sa.NullPool)

    @sa.event.listens_for(engine, "begin")
    def refuse_writers(connection: sa.Connection) -> None:
        if connection.get_execution_options().get(_WRITES):
            require_writable(path)

    return engine


def read_only_connection(path: Path) -> sqlite3.Connection:
    """A connection to an SQLite database beside which no file may be written."""
    uri, log = path.resolve().as_uri(), Path(f"{path}-wal")
    connect = partial(
        sqlite3.connect, uri=True, timeout=_WAIT_S, check_same_thread=False, isolation_level=None
    )
    if not log.exists():
        return connect(f"{uri}?mode=ro&immutable=1")
    connection = connect(f"{uri}?mode=ro")
    try:
        connection.execute("SELECT 1 FROM sqlite_master").fetchone()
    except sqlite3.OperationalError:  # no process has it open; a log was left behind
        connection.close()
        if not log.stat().st_size:
            return connect(f"{uri}?mode=ro&immutable=1")
        changed = tuple((one.stat().st_mtime_ns, one.stat().st_size) for one in (path, log))
        return connect(_copy_with_log(path, changed).as_uri())
    return connection


@lru_cache(maxsize=8)
def _copy_with_log(path: Path, changed: tuple[tuple[int, int], ...]) -> Path:  # noqa: ARG001 - cached by it
    """A copy of a database and its log in a temporary folder, where SQLite may join them."""
    folder = Path(tempfile.mkdtemp(dir=_temporary_folder().name))
    for name in (path.name, f"{path.name}-wal"):
        shutil.copyfile(path.with_name(name), folder / name)
    return folder / path.name


@cache
def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    """Kept until this process ends."""
    return tempfile.TemporaryDirectory(prefix="solmap-")


_URLS = "set SOLMAP_CATALOGUE_URL=postgresql+psycopg://user:password@host/database, or omit it"


def tables_of(engine: sa.Engine) -> set[str]:
    """The names of the tables in a database.

    Raises:
        StoreAwayError: the database does not respond.
        ProductError: its file cannot be opened, or is damaged.
    """
    try:
        with explain_full_disk(_name_of(engine)):
            return set(sa.inspect(engine).get_table_names())
    except OperationalError as error:
        if engine.dialect.name == "sqlite":
            code = getattr(error.orig, "sqlite_errorcode", 0)
            if code & _PRIMARY_CODE != sqlite3.SQLITE_CANTOPEN:
                raise
            raise ProductError(
                f"the catalogue {_name_of(engine)} cannot be opened: does its folder exist, and "
                "may this user read and write it?"
            ) from error
        where = engine.url.render_as_string(hide_password=True)
        raise StoreAwayError(
            f"the catalogue's database {where} does not respond: {str(error.orig).strip()}; is it "
            "running, and is SOLMAP_CATALOGUE_URL right?"
        ) from error
    except DatabaseError as error:
        raise ProductError(
            f"{engine.url.database or 'the catalogue'} is damaged ({error.orig}): restore a backup "
            "with `solmap restore`, or remove it and run the downlinks again"
        ) from error


@contextmanager
def write_transaction(engine: sa.Engine) -> Iterator[sa.Connection]:
    """A write transaction, exclusive among writers from its first statement on."""
    with (
        explain_full_disk(_name_of(engine)),
        engine.connect().execution_options(**{_WRITES: True}) as connection,
        connection.begin(),
    ):
        if connection.dialect.name == "postgresql":
            connection.exec_driver_sql(f"SET LOCAL lock_timeout = '{_WAIT_S}s'")
            connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_TURN)))
        yield connection


def _name_of(engine: sa.Engine) -> str:
    """The file of a database in SQLite, or its name on the server."""
    return engine.url.database or "the catalogue"


@contextmanager
def explain_full_disk(database: Path | str) -> Iterator[None]:
    """Report that a database cannot be written, or opened, because its disk is full."""
    try:
        yield
    except (DBAPIError, sqlite3.Error) as error:
        folder = Path(database).parent
        if is_database_full(error) or (folder.is_dir() and is_disk_full(folder, error)):
            raise StoreFullError(
                f"the disk of {database} is full; free some space and run again: finished "
                "products are kept"
            ) from error
        raise


def upsert(
    connection: sa.Connection, table: sa.Table, keys: dict[str, Any], values: dict[str, Any]
) -> None:
    """Insert a row, or replace the values of the one with these keys."""
    from sqlalchemy.dialects import postgresql, sqlite  # noqa: PLC0415 - who reads needs neither

    dialect = postgresql if connection.dialect.name == "postgresql" else sqlite
    added = dialect.insert(table).values(**keys, **values)
    connection.execute(added.on_conflict_do_update(index_elements=list(keys), set_=values))


def _configure(connection: DBAPIConnection, _record: object) -> None:
    """Readers never wait for a writer, and two writers wait for each other."""
    connection.isolation_level = None  # `_begin` starts transactions
    cursor = connection.cursor()
    for pragma in (f"busy_timeout={1000 * _WAIT_S}", "synchronous=NORMAL"):
        cursor.execute(f"PRAGMA {pragma}")
    give_up_at = monotonic() + _WAIT_S
    while True:
        try:
            cursor.execute("PRAGMA journal_mode=WAL")
        except sqlite3.OperationalError as error:
            # SQLite does not wait where two processes open a new file at the same time
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or monotonic() > give_up_at:
                raise
            sleep(0.01)
        else:
            return


def _begin(connection: sa.Connection) -> None:
    """Writers take the lock at the beginning: a later failure would lose the transaction."""
    writes = connection.get_execution_options().get(_WRITES)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


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
"""Number of ingests of a mission's images, repeated ones included."""

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


def pointer_keys(ref: ProductRef) -> dict[str, str]:
    """The columns that identify the pointer of a scope and kind."""
    return {"scope": ref.scope.name, "kind": str(ref.kind)}


def put_document(
    connection: sa.Connection,
    table: sa.Table,
    keys: dict[str, Any],
    document: dict[str, Any],
    **columns: Any,  # noqa: ANN401 - column values
) -> bool:
    """Insert or replace a row; returns whether its document changed."""
    where = sa.and_(*(table.c[name] == value for name, value in keys.items()))
    before = connection.execute(sa.select(table.c.document).where(where)).scalar_one_or_none()
    if before is not None and before == json.loads(json.dumps(document)):
        return False
    upsert(connection, table, keys, {**columns, "document": document})
    return True


def move_pointer(connection: sa.Connection, ref: ProductRef) -> bool:
    """Move the pointer of a scope and kind; returns whether it moved."""
    keys = pointer_keys(ref)
    where = sa.and_(LATEST.c.scope == keys["scope"], LATEST.c.kind == keys["kind"])
    before = connection.execute(sa.select(LATEST.c.digest).where(where)).scalar_one_or_none()
    if before == ref.digest:
        return False
    upsert(connection, LATEST, keys, {"digest": ref.digest})
    return True


def count_ingested(connection: sa.Connection, mission: str, images: int) -> None:
    """Count ingested images, so that other processes notice them."""
    before = times_ingested(connection, mission)
    upsert(connection, INGESTED, {"mission": mission}, {"times": before + images})


def times_ingested(connection: sa.Connection, mission: str) -> int:
    """Number of ingests of a mission's images."""
    query = sa.select(INGESTED.c.times).where(INGESTED.c.mission == mission)
    return connection.execute(query).scalar_one_or_none() or 0
