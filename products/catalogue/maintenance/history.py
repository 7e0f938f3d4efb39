"""Trim the history of a store by age: runs, events, answered requests, old logs and copies.

Published layers do not depend on it. Edits, tokens and the outcomes of files and sols are kept.
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
    """Delete the history of a store that is older than a number of days."""
    oldest = datetime.now(UTC) - timedelta(days=days)
    before = oldest.isoformat(timespec="milliseconds")
    with write_transaction(workspace.catalogue.engine) as connection:
        connection.execute(RUNS.delete().where(RUNS.c.started_at < before))
        trim_events(connection, before)
    RunRequests.of(workspace.store.root).trim(before)
    for path in _old_files(workspace.store.root):
        with contextlib.suppress(OSError):  # another process has just removed it
            if path.stat().st_mtime < oldest.timestamp():
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _old_files(root: Path) -> Iterator[Path]:
    """Logs that are no longer written, and copies of databases kept before a change."""
    yield from (root / "logs").glob("*.[0-9]")
    yield from root.glob(f"{schema.SAFETY_COPIES}*")
