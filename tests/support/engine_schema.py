"""The tables that Prefect's server makes in an empty folder.

`python -m tests.support.engine_schema` writes them to `flows/runtime/engine.sql`; to repeat for
another version of Prefect.
"""

from __future__ import annotations

import os
import sqlite3
import tempfile
from contextlib import closing
from importlib.metadata import version
from pathlib import Path
from unittest.mock import patch

from solmap.flows.runtime.engine import (
    SCHEMA,
    await_engine,
    engine_child,
    free_port,
    prepare_engine,
)


def made_by_prefect(folder: Path) -> str:
    """The tables as SQL, after a line with the version."""
    database = folder / "made.db"
    settings = {
        "PREFECT_HOME": str(folder / "prefect"),
        "PREFECT_API_DATABASE_CONNECTION_URL": f"sqlite+aiosqlite:///{database}",
    }
    with patch.dict(os.environ, settings):
        prepare_engine(folder)
        port = free_port()
        child = engine_child(folder, port, has_pages=False)
        child.start()
        try:
            await_engine(child, port)
        finally:
            child.stop()
    with closing(sqlite3.connect(database)) as connection:
        lines = "\n".join(connection.iterdump())
    return f"-- Prefect {version('prefect')}\n{lines}\n"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        SCHEMA.write_text(made_by_prefect(Path(name)))
