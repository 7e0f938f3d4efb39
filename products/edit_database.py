"""The database of what people write on the map: edits, and requests for runs."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FILE = "edits.sqlite"
_WAIT_S = 30.0
"""For others who write."""


@contextmanager
def transaction(path: Path, schema: str) -> Iterator[sqlite3.Connection]:
    """A transaction on the database, which is made with the schema where it is not there yet."""
    connection = sqlite3.connect(path, timeout=_WAIT_S)
    try:
        with connection:
            connection.execute("PRAGMA journal_mode=WAL")
            connection.executescript(schema)
            yield connection
    finally:
        connection.close()
