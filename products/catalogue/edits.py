"""Edits from the map: edits of tie points, annotations, and requests for runs.

Edits change no product: edits of tie points are requests that the next run applies, like those in
files (`products.formats.documents.edit_requests`). All are in a separate database, `edits.sqlite`.
The log of edits is append-only, which the database enforces: undoing an edit is an edit too, and
can itself be undone. `solmap up` processes requests for runs.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

from solmap.products.catalogue.database import explain_full_disk, read_only_connection
from solmap.products.errors import ProductError, ProductNotFoundError
from solmap.products.store.faults import is_read_only, require_writable

FILE = "edits.sqlite"
_INSERT = (
    "INSERT INTO edits(mission, kind, document, author, at, note, undoes) VALUES(?,?,?,?,?,?,?)"
)
_WAIT_S = 30.0
"""Waiting time for other writers."""


_SCHEMA = """
CREATE TABLE IF NOT EXISTS edits(
    id INTEGER PRIMARY KEY AUTOINCREMENT, mission TEXT NOT NULL, kind TEXT NOT NULL,
    document TEXT NOT NULL, author TEXT NOT NULL, at TEXT NOT NULL, note TEXT NOT NULL,
    undoes INTEGER REFERENCES edits(id));
CREATE INDEX IF NOT EXISTS edits_of_mission ON edits(mission, id);
CREATE TRIGGER IF NOT EXISTS edits_stay BEFORE DELETE ON edits
    BEGIN SELECT RAISE(ABORT, 'edits are never deleted'); END;
CREATE TRIGGER IF NOT EXISTS edits_are BEFORE UPDATE ON edits
    BEGIN SELECT RAISE(ABORT, 'edits are never changed'); END;
CREATE TABLE IF NOT EXISTS requests(
    id INTEGER PRIMARY KEY AUTOINCREMENT, kind TEXT NOT NULL, mission TEXT, author TEXT NOT NULL,
    at TEXT NOT NULL, state TEXT NOT NULL, answer TEXT, parameters TEXT NOT NULL DEFAULT '{}');
"""


@contextmanager
def transaction(path: Path) -> Iterator[sqlite3.Connection]:
    """A transaction on the database, which is created if necessary.

    Raises:
        StoreReadOnlyError: writing is not permitted there.
        StoreFullError: its disk is full.
    """
    require_writable(path)
    with (
        closing(sqlite3.connect(path, timeout=_WAIT_S)) as connection,
        explain_full_disk(path),
        connection,
    ):
        connection.execute("PRAGMA journal_mode=WAL")
        connection.executescript(_SCHEMA)
        yield connection


@contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    """A connection for reading, which needs no write permission."""
    if not is_read_only(path):
        with transaction(path) as connection:
            yield connection
        return
    with closing(read_only_connection(path)) as connection:
        yield connection


class EditKind(StrEnum):
    """Subject of an edit."""

    TIE = "tie"
    """An edit request: a tie point to add, veto or move."""
    ANNOTATION = "annotation"
    """A point, line or area with a text."""
    UNDO = "undo"
    """Another edit, which is then without effect."""


class EditConflictError(ProductError):
    """The edit contradicts an earlier one."""


@dataclass(frozen=True, slots=True)
class Edit:
    """A row of the log."""

    id: int
    mission: str
    kind: EditKind
    document: dict[str, Any]
    author: str
    at: str
    """UTC, ISO 8601."""
    note: str
    """Why, in the author's words."""
    undoes: int | None
    counts: bool
    """Whether it has effect: it has not been undone."""


@dataclass(frozen=True, slots=True)
class EditLog:
    """The log of edits of a store."""

    path: Path

    @classmethod
    def of(cls, root: Path) -> EditLog:
        """The log of the store at `root`; nothing is written before the first edit."""
        return cls(root / FILE)

    def append(
        self, mission: str, kind: EditKind, document: dict[str, Any], author: str, note: str = ""
    ) -> Edit:
        """Add an edit."""
        return self._append(mission, kind, document, author, note, None)

    def undo(self, mission: str, number: int, author: str, note: str = "") -> Edit:
        """Undo an edit; undoing that makes it effective again.

        Raises:
            ProductNotFoundError: the mission has no such edit.
            EditConflictError: it has been undone already.
        """
        self._effective(mission, number)
        return self._append(mission, EditKind.UNDO, {}, author, note, number)

    def replace(
        self, mission: str, number: int, document: dict[str, Any], author: str, note: str = ""
    ) -> Edit:
        """Undo an annotation and add another one instead, both or neither.

        Raises:
            ProductNotFoundError: the mission has no such edit.
            EditConflictError: it has been undone or replaced already.
        """
        old = self._effective(mission, number)
        if old.kind is not EditKind.ANNOTATION:
            raise EditConflictError(
                f"edit {number} of {mission} is not an annotation: undo it instead"
            )
        at = datetime.now(UTC).isoformat(timespec="milliseconds")
        row = (mission, str(old.kind), json.dumps(document), author, at, note, None)
        with transaction(self.path) as connection:
            undo = (mission, str(EditKind.UNDO), "{}", author, at, "replaced", number)
            connection.execute(_INSERT, undo)
            made = connection.execute(_INSERT, row).lastrowid or 0
        return _edit((made, *row), counts=True)

    def _effective(self, mission: str, number: int) -> Edit:
        known = {edit.id: edit for edit in self.edits(mission)}
        if number not in known:
            raise ProductNotFoundError(f"{mission} has no edit {number}")
        if not known[number].counts:
            raise EditConflictError(
                f"edit {number} of {mission} has been undone already; read the log again"
            )
        return known[number]

    def edits(self, mission: str | None = None) -> list[Edit]:
        """All edits, or those of a mission, in their order; also those without effect."""
        if not self.path.is_file():
            return []
        with _reading(self.path) as connection:
            rows = connection.execute(
                "SELECT id, mission, kind, document, author, at, note, undoes FROM edits "
                "WHERE ? IS NULL OR mission = ? ORDER BY id",
                (mission, mission),
            ).fetchall()
        undone: set[int] = set()
        # an undo has a higher number than the edit it undoes
        for number, *_, undoes in reversed(rows):
            if undoes is not None and number not in undone:
                undone.add(undoes)
        return [_edit(row, row[0] not in undone) for row in rows]

    def move(
        self, old: str, new: str, carry: Callable[[dict[str, Any]], dict[str, Any]]
    ) -> list[Edit]:
        """Move edits with effect from one map to another, when its name or its origin changes.

        In the log each edit is undone on the old map and added again on the new one, with its
        author and time. Nothing is moved twice.

        Args:
            old: Name of the old map.
            new: Name of the new map.
            carry: Transforms an annotation of the old map to the new one.
        """
        moved = [edit for edit in self.edits(old) if edit.counts and edit.kind is not EditKind.UNDO]
        if not moved:
            return []
        rows: list[tuple[str | int | None, ...]] = []
        for edit in moved:
            is_place = edit.kind is EditKind.ANNOTATION
            document = json.dumps(carry(edit.document) if is_place else edit.document)
            rows.append((new, str(edit.kind), document, edit.author, edit.at, edit.note, None))
            why = f"moved to {new}"
            rows.append((old, str(EditKind.UNDO), "{}", edit.author, edit.at, why, edit.id))
        with transaction(self.path) as connection:
            connection.executemany(_INSERT, rows)
        return moved

    def effective(self, kind: EditKind, mission: str | None = None) -> list[Edit]:
        """The edits of a kind with effect."""
        return [edit for edit in self.edits(mission) if edit.counts and edit.kind is kind]

    def _append(
        self,
        mission: str,
        kind: EditKind,
        document: dict[str, Any],
        author: str,
        note: str,
        undoes: int | None,
    ) -> Edit:
        at = datetime.now(UTC).isoformat(timespec="milliseconds")
        row = (mission, str(kind), json.dumps(document), author, at, note, undoes)
        with transaction(self.path) as connection:
            added = connection.execute(_INSERT, row)
            number = added.lastrowid or 0
        return _edit((number, *row), counts=True)


def _edit(row: tuple[Any, ...], counts: bool) -> Edit:  # noqa: FBT001 - a fact of the row
    number, mission, kind, document, author, at, note, undoes = row
    known = json.loads(document)
    return Edit(number, mission, EditKind(kind), known, author, at, note, undoes, counts)


class RequestKind(StrEnum):
    """Kind of a request: a run, or an action on a run or a deployment."""

    DOWNLINK = "downlink"
    """Process the files in the inbox."""
    OVERALL = "overall adjustment"
    """Adjust all stops of a mission, or of all missions, together."""
    REGION = "region"
    """Join stops into regions again."""
    FETCH = "fetch"
    """Fetch images of some sols from the archive to the inbox."""
    CANCEL = "cancel"
    """Cancel the run `run` of the engine."""
    PAUSE = "pause"
    """Pause the schedule of `deployment`."""
    RESUME = "resume"
    """Resume it."""


class RequestState(StrEnum):
    """State of a request."""

    WAITING = "waiting"
    TAKEN = "taken"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class RunRequest:
    """A request for a run."""

    id: int
    kind: RequestKind
    mission: str | None
    """Mission to list; None: all."""
    author: str
    at: str
    """UTC, ISO 8601."""
    state: RequestState
    answer: str | None
    """The name of the run, or the reason why there is none."""
    parameters: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RunRequests:
    """The requests of a store."""

    path: Path

    @classmethod
    def of(cls, root: Path) -> RunRequests:
        """The requests of the store at `root`; nothing is written before the first."""
        return cls(root / FILE)

    def add(
        self,
        kind: RequestKind,
        mission: str | None,
        author: str,
        parameters: Mapping[str, Any] | None = None,
    ) -> RunRequest:
        """Add a request, unless an equal one is waiting; returns the waiting one."""
        given = json.dumps(parameters or {}, sort_keys=True)
        with transaction(self.path) as connection:
            connection.execute("BEGIN IMMEDIATE")
            same = connection.execute(
                "SELECT * FROM requests "
                "WHERE kind = ? AND mission IS ? AND parameters = ? AND state = ?",
                (kind, mission, given, RequestState.WAITING),
            ).fetchone()
            if same:
                return _request(same)
            at = datetime.now(UTC).isoformat(timespec="milliseconds")
            row = (kind, mission, author, at, RequestState.WAITING, None, given)
            number = connection.execute(
                "INSERT INTO requests(kind, mission, author, at, state, answer, parameters) "
                "VALUES(?,?,?,?,?,?,?)",
                row,
            ).lastrowid
        return _request((number or 0, *row))

    def requests(self, limit: int = 50) -> list[RunRequest]:
        """The newest first."""
        if not self.path.is_file():
            return []
        with _reading(self.path) as connection:
            rows = connection.execute("SELECT * FROM requests ORDER BY id DESC LIMIT ?", (limit,))
            return [_request(row) for row in rows]

    def waiting(self) -> list[RunRequest]:
        """Requests that have not been processed, oldest first."""
        pending = self.requests(limit=1000)
        return [one for one in reversed(pending) if one.state is RequestState.WAITING]

    def trim(self, before: str) -> None:
        """Delete the answered requests made before a time."""
        if self.path.is_file():
            with transaction(self.path) as connection:
                connection.execute(
                    "DELETE FROM requests WHERE state != ? AND at < ?",
                    (RequestState.WAITING, before),
                )

    def answer(self, number: int, state: RequestState, answer: str) -> None:
        """Record the answer to a request."""
        with transaction(self.path) as connection:
            connection.execute(
                "UPDATE requests SET state = ?, answer = ? WHERE id = ?", (state, answer, number)
            )


def _request(row: tuple[Any, ...]) -> RunRequest:
    """A request of a row; stores before version 2 have no parameters."""
    number, kind, mission, author, at, state, answer, *rest = row
    parameters = json.loads(rest[0]) if rest else {}
    known = RequestKind(kind), mission, author, at, RequestState(state), answer
    return RunRequest(number, *known, parameters)


def add_parameters(path: Path) -> None:
    """Add the column of parameters to the requests of an older store."""
    with transaction(path) as connection:
        names = {row[1] for row in connection.execute("PRAGMA table_info(requests)")}
        if "parameters" not in names:
            connection.execute(
                "ALTER TABLE requests ADD COLUMN parameters TEXT NOT NULL DEFAULT '{}'"
            )
