"""Locks of a store: runs share one, changes of a mission take turns, maintenance is exclusive.

The locks are those of the store's folder (`products.store.locks`). Where the catalogue is in
PostgreSQL, flows of several machines may use it, each with its own folder: there the same locks are
taken in the database too. They belong to a session, so the database releases them when the process
that holds them ends in any way.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from solmap.products.errors import StoreBusyError
from solmap.products.store.locks import exclusive_lock, run_lock_path, shared_run_lock, try_lock

_RUNS = "runs"
_LOST_AFTER_S = 60
"""Seconds of silence after which the database considers a client machine lost."""


@contextmanager
def run_turn(
    root: Path, engine: sa.Engine, on_wait: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Use a store beside other runs; nothing is pruned, migrated or restored meanwhile."""
    with shared_run_lock(root, on_wait), _database_lock(engine, _RUNS, on_wait, shared=True):
        yield


@contextmanager
def exclusive_mission(
    root: Path, engine: sa.Engine, mission: str, on_wait: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Change a mission exclusively; waits for another run that does."""
    with exclusive_lock(root, mission, on_wait), _database_lock(engine, mission, on_wait):
        yield


@contextmanager
def maintenance_turn(root: Path, engine: sa.Engine, what: str) -> Iterator[None]:
    """Use a store exclusively: no run, backup or other maintenance is in progress. Never waits.

    Raises:
        StoreBusyError: one is.
    """
    with try_lock(run_lock_path(root)) as is_alone, _database_lock(engine, _RUNS) as is_free:
        if not (is_alone and is_free):
            raise StoreBusyError(
                f"a run, a backup or maintenance is using {root}: {what} when it has ended"
            )
        yield


@contextmanager
def _database_lock(
    engine: sa.Engine,
    name: str,
    on_wait: Callable[[], None] | None = None,
    *,
    shared: bool = False,
) -> Iterator[bool]:
    """Hold a lock of the database; whether it is held. Without `on_wait` nothing is waited for."""
    if engine.dialect.name != "postgresql":
        yield True
        return
    digest = hashlib.sha256(f"solmap {name.lower()}".encode()).digest()
    key = int.from_bytes(digest[:8], signed=True)
    suffix = "_shared" if shared else ""
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        for setting, value in (("idle", _LOST_AFTER_S // 2), ("interval", 10), ("count", 3)):
            connection.exec_driver_sql(f"SET tcp_keepalives_{setting} = {value}")
        is_held = _query(connection, f"pg_try_advisory_lock{suffix}", key)
        if not is_held and on_wait is not None:
            on_wait()
            _query(connection, f"pg_advisory_lock{suffix}", key)
            is_held = True
        try:
            yield is_held
        finally:
            with contextlib.suppress(SQLAlchemyError):  # the connection was lost, and the lock
                if is_held:
                    _query(connection, f"pg_advisory_unlock{suffix}", key)


def _query(connection: sa.Connection, function: str, key: int) -> bool:
    return bool(connection.execute(sa.select(getattr(sa.func, function)(key))).scalar_one())
