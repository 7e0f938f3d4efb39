"""Records of runs, and of the sols that they finished.

A flow records its own run, its progress and its end, so that the map does not depend on the
orchestrator. Every change is also an event. A run whose process ended without recording it is
`lost`: it was killed.

The key of a finished sol names all its inputs; while the key is the same, so is the outcome, and a
run skips the sol. A mission of years has thousands of sols, and a downlink changes the last.
"""

from __future__ import annotations

import dataclasses
import os
import secrets
import socket
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from solmap.products.catalogue.database import (
    FINISHED,
    RUNS,
    put_document,
    upsert,
    write_transaction,
)
from solmap.products.catalogue.events import RUN_CHANGED, append
from solmap.products.errors import ProductNotFoundError

KEPT = 500
"""Most records; older ones are deleted."""
_LINES = 500
"""Most messages kept for a run."""


class RunState(StrEnum):
    """The state of a run."""

    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    LOST = "lost"
    CANCELLED = "cancelled"
    """Stopped by people before its end: on the map, by Ctrl-C, or together with the service."""


RESTARTABLE = (RunState.FAILED, RunState.LOST, RunState.CANCELLED)
"""States after which a run may be repeated with the same parameters."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a flow."""

    id: str
    kind: str
    """The flow: `downlink`, `overall adjustment`."""
    subject: str
    """Its input: the name of a folder, a mission."""
    state: RunState
    started_at: str
    """UTC, ISO 8601, as for all times."""
    changed_at: str
    ended_at: str | None = None
    stage: str | None = None
    done: int = 0
    total: int = 0
    """Finished parts of the stage, and their total."""
    lines: tuple[str, ...] = ()
    """Messages, oldest first."""
    process: str = ""
    """Host and number of the process."""
    flow_run: str | None = None
    """Its run in the engine, of a deployment; None: it was started by a command."""
    parameters: dict[str, Any] = field(default_factory=dict)
    """Parameters of the deployment's run."""

    @classmethod
    def start(
        cls,
        kind: str,
        subject: str,
        flow_run: str | None = None,
        parameters: Mapping[str, Any] | None = None,
    ) -> Run:
        """A run of this process that begins now."""
        now = _now()
        name = f"{now[:19].replace(':', '').replace('-', '')}-{secrets.token_hex(3)}"
        return cls(
            name,
            kind,
            subject,
            RunState.RUNNING,
            now,
            now,
            process=_this_process(),
            flow_run=flow_run,
            parameters=dict(parameters or {}),
        )

    def with_progress(self, stage: str, done: int, total: int) -> Run:
        """The run with its progress."""
        return dataclasses.replace(self, changed_at=_now(), stage=stage, done=done, total=total)

    def with_lines(self, lines: Iterable[str]) -> Run:
        """The run with further lines."""
        kept = (*self.lines, *lines)[-_LINES:]
        return dataclasses.replace(self, changed_at=_now(), lines=kept)

    def with_end(self, state: RunState) -> Run:
        """The run with its end."""
        now = _now()
        return dataclasses.replace(self, changed_at=now, ended_at=now, state=state)


@dataclass(frozen=True, slots=True, eq=False)
class RunRecords:
    """The records of runs in the catalogue's database."""

    engine: sa.Engine

    def write(self, run: Run) -> None:
        """Insert or replace a record, with an event."""
        event = {
            name: getattr(run, name)
            for name in ("id", "kind", "subject", "state", "stage", "done", "total")
        }
        with write_transaction(self.engine) as connection:
            columns = {"started_at": run.started_at}
            put_document(connection, RUNS, {"id": run.id}, dataclasses.asdict(run), **columns)
            append(connection, RUN_CHANGED, {**event, "state": str(run.state)})
            oldest = sa.select(RUNS.c.id).order_by(RUNS.c.started_at.desc()).offset(KEPT)
            connection.execute(RUNS.delete().where(RUNS.c.id.in_(oldest.limit(KEPT))))

    def runs(self, limit: int = 50) -> list[Run]:
        """The newest first."""
        query = sa.select(RUNS.c.document).order_by(RUNS.c.started_at.desc()).limit(limit)
        with self.engine.connect() as connection:
            return [_run(row[0]) for row in connection.execute(query)]

    def run(self, name: str) -> Run:
        """One run.

        Raises:
            ProductNotFoundError: there is none of that name.
        """
        query = sa.select(RUNS.c.document).where(RUNS.c.id == name)
        with self.engine.connect() as connection:
            for row in connection.execute(query):
                return _run(row[0])
        raise ProductNotFoundError(f"there is no run {name!r}")


def _run(document: dict[str, Any]) -> Run:
    state, lines = RunState(document["state"]), tuple(document["lines"])
    found = Run(**{**document, "state": state, "lines": lines})
    if state is RunState.RUNNING and _is_gone(found.process):
        return dataclasses.replace(found, state=RunState.LOST)
    return found


def _this_process() -> str:
    return f"{socket.gethostname()}-{os.getpid()}"


def _is_gone(process: str) -> bool:
    """Whether a process of this machine has ended; unknown for others."""
    host, _, number = process.rpartition("-")
    return host == socket.gethostname() and not Path(f"/proc/{number}").exists()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


@dataclass(frozen=True, slots=True, eq=False)
class FinishedSolRecords:
    """The finished sols in the catalogue's database."""

    engine: sa.Engine

    def find(self, scope: str, key: str) -> dict[str, Any] | None:
        """The document of a sol that was processed with the inputs of `key`; None if it was not."""
        query = sa.select(FINISHED.c.document).where(
            FINISHED.c.scope == scope, FINISHED.c.key == key
        )
        with self.engine.connect() as connection:
            return connection.execute(query).scalar_one_or_none()

    def note(self, scope: str, key: str, document: dict[str, Any]) -> None:
        """Record a finished sol, replacing an earlier record."""
        with write_transaction(self.engine) as connection:
            upsert(connection, FINISHED, {"scope": scope}, {"key": key, "document": document})

    def forget(self, first: str, of: str) -> None:
        """Delete the sols from the scope `first` on, of those whose names begin with `of`."""
        later = (FINISHED.c.scope >= first) & FINISHED.c.scope.startswith(of, autoescape=True)
        with write_transaction(self.engine) as connection:
            connection.execute(FINISHED.delete().where(later))
