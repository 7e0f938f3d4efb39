"""The empty database of Prefect's server, made once and copied.

A server that finds none makes it step by step, in four seconds of processor; a copy is the same.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import closing
from importlib.metadata import version
from pathlib import Path

KEPT = Path(__file__).resolve().parents[2] / ".cache" / "engine"


def copy_empty_database(file: Path) -> None:
    """Copy the database of the installed release of Prefect to a file."""
    kept = KEPT / version("prefect") / "prefect.db"
    KEPT.mkdir(parents=True, exist_ok=True)
    with (KEPT / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # other workers wait for the first
        if not kept.is_file():
            _make(kept)
    shutil.copy(kept, file)


def _make(kept: Path) -> None:
    with tempfile.TemporaryDirectory(dir=KEPT) as home:
        others = {name: value for name, value in os.environ.items() if "PREFECT_" not in name}
        subprocess.run(
            [sys.executable, "-m", "prefect", "server", "database", "upgrade", "--yes"],
            env={**others, "PREFECT_HOME": home},
            cwd=home,
            check=True,
            capture_output=True,
        )
        with closing(sqlite3.connect(Path(home) / "prefect.db")) as database:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        kept.parent.mkdir(exist_ok=True)
        (Path(home) / "prefect.db").rename(kept)
