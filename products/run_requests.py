"""Requests for runs: asked for on the map, taken by whoever runs flows (`solmap up`)."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from solmap.products.edit_database import FILE, transaction

_SCHEMA = """CREATE TABLE IF NOT EXISTS requests(
    id INTEGER PRIMARY KEY AUTOINCREMENT, kind TEXT NOT NULL, mission TEXT, author TEXT NOT NULL,
    at TEXT NOT NULL, state TEXT NOT NULL, answer TEXT)"""
_COLUMNS = "id, kind, mission, author, at, state, answer"


class RequestKind(StrEnum):
    """What is to be run."""

    DOWNLINK = "downlink"
    """Process what is in the inbox."""
    OVERALL = "overall adjustment"
    """Adjust all stops of a mission, or of all, together."""
    REGION = "region"
    """Join stops to regions anew."""


class RequestState(StrEnum):
    """What became of it."""

    WAITING = "waiting"
    TAKEN = "taken"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class RunRequest:
    """Somebody wants a run."""

    id: int
    kind: RequestKind
    mission: str | None
    """Of which mission; None: of all."""
    author: str
    at: str
    """UTC, ISO 8601."""
    state: RequestState
    answer: str | None
    """The name of the run, or why there is none."""


@dataclass(frozen=True, slots=True)
class RequestBook:
    """The requests of a store."""

    path: Path

    @classmethod
    def of(cls, root: Path) -> RequestBook:
        """Those of the store at `root`; nothing is written before the first."""
        return cls(root / FILE)

    def ask(self, kind: RequestKind, mission: str | None, author: str) -> RunRequest:
        """Add a request, unless the same is waiting already; the one that waits."""
        with transaction(self.path, _SCHEMA) as connection:
            connection.execute("BEGIN IMMEDIATE")
            same = connection.execute(
                f"SELECT {_COLUMNS} FROM requests "  # noqa: S608 - our own words
                "WHERE kind = ? AND mission IS ? AND state = ?",
                (kind, mission, RequestState.WAITING),
            ).fetchone()
            if same:
                return _request(same)
            at = datetime.now(UTC).isoformat(timespec="milliseconds")
            number = connection.execute(
                "INSERT INTO requests(kind, mission, author, at, state) VALUES(?,?,?,?,?)",
                (kind, mission, author, at, RequestState.WAITING),
            ).lastrowid
        return RunRequest(number or 0, kind, mission, author, at, RequestState.WAITING, None)

    def requests(self, limit: int = 50) -> list[RunRequest]:
        """The newest first."""
        if not self.path.is_file():
            return []
        with transaction(self.path, _SCHEMA) as connection:
            rows = connection.execute(
                f"SELECT {_COLUMNS} FROM requests ORDER BY id DESC LIMIT ?",  # noqa: S608
                (limit,),
            )
            return [_request(row) for row in rows]

    def waiting(self) -> list[RunRequest]:
        """Those that nobody has taken, oldest first."""
        asked = self.requests(limit=1000)
        return [one for one in reversed(asked) if one.state is RequestState.WAITING]

    def answer(self, number: int, state: RequestState, answer: str) -> None:
        """Say what became of a request."""
        with transaction(self.path, _SCHEMA) as connection:
            connection.execute(
                "UPDATE requests SET state = ?, answer = ? WHERE id = ?", (state, answer, number)
            )


def _request(row: tuple[int, str, str | None, str, str, str, str | None]) -> RunRequest:
    number, kind, mission, author, at, state, answer = row
    return RunRequest(number, RequestKind(kind), mission, author, at, RequestState(state), answer)
