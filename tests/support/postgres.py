"""A PostgreSQL server of Debian's packages, on a Unix socket, for as long as tests need it."""

from __future__ import annotations

import itertools
import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

_SETTINGS = ("-F", "-c", "listen_addresses=", "-c", "shared_buffers=32MB")
"""No fsync: what is tested is not the disk."""


class NoPostgresError(Exception):
    """There is none on this machine."""


@dataclass(frozen=True)
class Postgres:
    """The server; every caller creates a database of its own."""

    folder: Path
    programs: Path
    user: str
    _numbers: Iterator[int] = field(default_factory=itertools.count)

    def database(self, driver: str = "psycopg") -> str:
        """The URL of a new, empty database."""
        name = f"test{next(self._numbers)}"
        # sorted by a language: what must be sorted by bytes has to state that
        made = ("createdb", "--template=template0", "--locale-provider=icu", "--icu-locale=en")
        self._run(*made, "-h", str(self.folder), name)
        return f"postgresql+{driver}://{self.user}@/{name}?host={self.folder}"

    def stop(self) -> None:
        """Stop at once; `start` continues with the same databases."""
        data = str(self.folder / "data")
        self._run("pg_ctl", "-D", data, "-m", "immediate", "-w", "stop")

    def start(self) -> None:
        """Start and wait until it answers."""
        options = " ".join((*_SETTINGS, "-k", str(self.folder)))
        data, log = str(self.folder / "data"), str(self.folder / "log")
        self._run("pg_ctl", "-D", data, "-l", log, "-o", options, "-w", "-t", "120", "start")

    def _run(self, program: str, *arguments: str) -> None:
        own = os.geteuid() != 0
        subprocess.run(
            (str(self.programs / program), *arguments),
            check=True,
            cwd=self.folder,
            user=None if own else self.user,
            env={**os.environ, "PGUSER": self.user},
            stdout=subprocess.DEVNULL,
        )


@contextmanager
def running_postgres() -> Iterator[Postgres]:
    """A server with its data in a temporary folder.

    Raises:
        NoPostgresError: its programs are not installed.
    """
    programs = _programs()
    user = "postgres" if os.geteuid() == 0 else pwd.getpwuid(os.geteuid()).pw_name
    folder = Path(tempfile.mkdtemp(prefix="solmap-pg-"))  # short: a socket's path has 107 letters
    if os.geteuid() == 0:
        try:
            shutil.chown(folder, user)
        except LookupError as error:
            raise NoPostgresError("there is no user postgres to run it as") from error
    server = Postgres(folder, programs, user)
    try:
        server._run("initdb", "-D", str(folder / "data"), "-U", user, "-A", "trust", "-N")
        server.start()
        try:
            yield server
        finally:
            server.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _programs() -> Path:
    found = shutil.which("initdb")
    folders = [Path(found).resolve().parent] if found else []
    folders += sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    for folder in folders:
        if (folder / "initdb").is_file():
            return folder
    raise NoPostgresError("PostgreSQL is not installed (Debian: postgresql)")
