"""The schema of a store: the version of its tables and folders, and the migrations between them.

One number is the version of the tables of the catalogue, the databases of edits and tokens, and the
layout of the folder. It is stored in the catalogue, with a row for every migration, and in the
folder, in the file `schema`. A store without either is of version 0.

An older store is migrated when it is opened, with no other process on it. Each migration changes
the catalogue in one transaction, together with its row; its changes of the folder may be repeated
by the next process if this one is killed. Copies of the previous SQLite databases are kept in
`before-schema-N`.
"""

from __future__ import annotations

import logging
import os
import shutil
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import sqlalchemy as sa

from solmap.products.catalogue import edits, events, tokens
from solmap.products.catalogue.database import (
    TABLES,
    explain_full_disk,
    read_only_connection,
    tables_of,
    upsert,
    write_transaction,
)
from solmap.products.catalogue.turns import maintenance_turn
from solmap.products.errors import (
    ProductError,
    StoreBusyError,
    StoreFullError,
    StoreReadOnlyError,
)
from solmap.products.store.faults import is_disk_full, is_read_only

log = logging.getLogger(__name__)
FILE = "schema"
CATALOGUE = "catalogue.sqlite"
DATABASES = (CATALOGUE, edits.FILE, tokens.FILE)
RESTORING = "restoring"
"""File in a store that is being restored: the store is incomplete."""
SAFETY_COPIES = "before-"
"""Prefix of folders with copies of the databases; they are deleted when old (`history`)."""
STEPS = sa.Table(
    "schema_steps",
    TABLES,
    sa.Column("version", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("at", sa.String, nullable=False),
)
"""Every migration applied to the catalogue."""
_WAIT_S, _POLL_S = 60.0, 0.2
"""Waiting time for another process that migrates the same store."""


def _add_missing_tables(root: Path, connection: sa.Connection) -> None:
    """Earlier versions made some tables only when they first wrote to them."""
    TABLES.create_all(connection)
    if (root / edits.FILE).is_file():
        with edits.transaction(root / edits.FILE):
            pass


def _add_parameters_of_requests(root: Path, _connection: sa.Connection) -> None:
    """Requests for runs had no parameters before."""
    if (root / edits.FILE).is_file():
        edits.add_parameters(root / edits.FILE)


Migration = Callable[[Path, sa.Connection], None]
"""Changes the folder of a store and its catalogue; must be repeatable after a kill."""
MIGRATIONS: list[Migration] = [_add_missing_tables, _add_parameters_of_requests]
"""Migrations in order: the first leads to version 1. Append to them, and never change one."""
OLDEST_READABLE = 0
"""Stores from this version on are read without migration if they are read-only."""


def latest_version() -> int:
    """The version that this solmap reads and writes."""
    return len(MIGRATIONS)


def prepare(root: Path, engine: sa.Engine) -> None:
    """Create the tables of a new store, migrate those of an older one, reject those of a newer one.

    Raises:
        ProductError: the store is newer, or being restored; or a run is working on an older one.
        StoreFullError: there is no space for the migration; the store is unchanged.
    """
    _refuse_half_restored(root)
    version = version_of(root, engine)
    if version is None:
        version = _found(root, engine)
    if version > latest_version():
        raise ProductError(
            f"{root} has schema {version}, this solmap reads up to {latest_version()}: "
            "update solmap"
        )
    if version < latest_version():
        if not is_read_only(root):
            _migrate_when_free(root, engine)
        elif version < OLDEST_READABLE:
            raise StoreReadOnlyError(
                f"{root} has schema {version} and can only be read, this solmap reads from "
                f"{OLDEST_READABLE} to {latest_version()}: migrate a copy of it"
            )
    elif root.is_dir() and not ((root / FILE).exists() or is_read_only(root)):
        write_version(root, version)  # the folder of another machine, new beside its catalogue


def version_of(root: Path, engine: sa.Engine) -> int | None:
    """The version of a store: the lower of folder and catalogue, or the higher if it is newer.

    None: there are no tables yet.
    """
    tables, in_catalogue = tables_of(engine), 0
    if events.EVENTS.name not in tables:
        return None
    if STEPS.name in tables:
        with engine.connect() as connection:
            in_catalogue = connection.execute(sa.select(sa.func.max(STEPS.c.version))).scalar() or 0
    versions = in_catalogue, _version_of_folder(root)
    return max(versions) if max(versions) > latest_version() else min(versions)


def _version_of_folder(root: Path) -> int:
    """The version in its file; a folder without one is new, or of a version without such a file."""
    try:
        return int((root / FILE).read_text())
    except FileNotFoundError:
        is_old = any((root / name).exists() for name in (edits.FILE, tokens.FILE, "products"))
        return 0 if is_old else latest_version()
    except ValueError as error:
        raise ProductError(
            f"{root / FILE} has no version; remove it, and the store is migrated again"
        ) from error


def _found(root: Path, engine: sa.Engine) -> int:
    """Create the tables of a new store; processes that start together do so one after the other."""
    root.mkdir(parents=True, exist_ok=True)
    version = _version_of_folder(root)
    if version == latest_version():
        write_version(root, version)
    with write_transaction(engine) as connection:
        TABLES.create_all(connection)
        _note_step(connection, latest_version())
    return version


def _migrate_when_free(root: Path, engine: sa.Engine) -> None:
    """Migrate with no other process on the store; wait if another one is migrating."""
    end = time.monotonic() + _WAIT_S
    while True:
        try:
            with maintenance_turn(root, engine, "open it again"):
                _migrate(root, engine)
                return
        except StoreBusyError:
            if version_of(root, engine) == latest_version():
                return
            if time.monotonic() > end:
                raise
        time.sleep(_POLL_S)


def _migrate(root: Path, engine: sa.Engine) -> None:
    version = version_of(root, engine)
    if version is None or version >= latest_version():
        return  # another process has
    keep_safety_copies(root, f"{SAFETY_COPIES}schema-{latest_version()}")
    for number, migration in enumerate(MIGRATIONS[version:], version + 1):
        with explain_full_disk(root / CATALOGUE), write_transaction(engine) as connection:
            migration(root, connection)
            _note_step(connection, number)
        write_version(root, number)
        log.info("%s was migrated to schema %d", root, number)


def _note_step(connection: sa.Connection, number: int) -> None:
    at = datetime.now(UTC).isoformat(timespec="seconds")
    STEPS.create(connection, checkfirst=True)
    upsert(connection, STEPS, {"version": number}, {"at": at})


def write_version(root: Path, number: int) -> None:
    """Write the version of a store's folder."""
    draft = root / f".{FILE}.{os.getpid()}"
    draft.write_text(f"{number}\n")
    draft.replace(root / FILE)


def keep_safety_copies(root: Path, folder: str) -> None:
    """Copy the SQLite databases to a new folder of the store, all or none.

    Raises:
        StoreFullError: there is no space for them.
    """
    kept, databases = root / folder, [name for name in DATABASES if (root / name).is_file()]
    if kept.exists() or not databases:
        return
    draft = kept.with_name(f"{kept.name}.draft")
    shutil.rmtree(draft, ignore_errors=True)
    try:
        draft.mkdir()
        for name in databases:
            _copy_even_damaged(root / name, draft / name)
        draft.replace(kept)
    except (OSError, sqlite3.Error) as error:
        shutil.rmtree(draft, ignore_errors=True)
        if is_disk_full(root, error):
            raise StoreFullError(
                f"the disk of {root} is full: there is no space to copy its databases before they "
                "are changed; free some and try again; nothing was changed"
            ) from error
        raise


def _copy_even_damaged(source: Path, target: Path) -> None:
    try:
        copy_database(source, target)
    except sqlite3.OperationalError:
        raise
    except sqlite3.DatabaseError:  # its bytes, for recovery by hand
        for end in ("", "-wal"):
            file, copy = Path(f"{source}{end}"), Path(f"{target}{end}")
            if file.is_file():
                copy.touch(mode=file.stat().st_mode & 0o777)
                shutil.copyfile(file, copy)


def copy_database(source: Path, target: Path) -> None:
    """Copy an SQLite database as a snapshot, also while it is written to."""
    is_new = not target.exists()
    target.touch(mode=source.stat().st_mode & 0o777)
    with (
        closing(database_reader(source)) as original,
        closing(sqlite3.connect(target)) as copy,
    ):
        original.backup(copy)
        if is_new:  # an open database keeps its log; the copy needs none
            copy.execute("PRAGMA journal_mode=DELETE")


def database_reader(database: Path) -> sqlite3.Connection:
    """A connection that reads a database of a store, whether or not it may be written."""
    if is_read_only(database):
        return read_only_connection(database)
    return sqlite3.connect(database)


def _refuse_half_restored(root: Path) -> None:
    if (root / RESTORING).exists():
        raise ProductError(
            f"{root} was not restored completely: run `solmap restore "
            f"{(root / RESTORING).read_text().strip()} --store {root}` again"
        )
