"""The history of a store, trimmed by age: runs, events, answered requests, old logs and copies.

What a store publishes does not depend on any of it. Edits, tokens and the outcomes of files and
sols stay.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from solmap.products.catalogue import schema
from solmap.products.catalogue.database import RUNS, write_transaction
from solmap.products.catalogue.edits import RunRequests
from solmap.products.catalogue.events import trim_events
from solmap.products.catalogue.workspace import Workspace


def trim_history(workspace: Workspace, days: float) -> None:
    """Delete what is older than so many days of the history of a store."""
    oldest = datetime.now(UTC) - timedelta(days=days)
    before = oldest.isoformat(timespec="milliseconds")
    with write_transaction(workspace.catalogue.engine) as connection:
        connection.execute(RUNS.delete().where(RUNS.c.started_at < before))
        trim_events(connection, before)
    RunRequests.of(workspace.store.root).trim(before)
    for path in _old_files(workspace.store.root):
        with contextlib.suppress(OSError):  # another run has just removed it
            if path.stat().st_mtime < oldest.timestamp():
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _old_files(root: Path) -> Iterator[Path]:
    """Logs that nothing is written to any more, and copies of databases kept before a change."""
    yield from (root / "logs").glob("*.[0-9]")
    yield from root.glob(f"{schema.SAFETY_COPIES}*")
