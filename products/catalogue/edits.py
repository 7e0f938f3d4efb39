"""What people write on the map: edits of ties, annotations, and requests for runs.

Nothing here is a product and no product is changed by it: edits of ties are wishes that the next
run carries out, as it does those of files (`photogrammetry.matching.hand_ties`). They lie in a
database of their own, `edits.sqlite`. The log of edits is only ever appended to, and the database
itself refuses anything else: taking one back is an edit too, and so is taking that back.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

from solmap.products.edit_database import FILE, transaction
from solmap.products.errors import ProductError, ProductNotFoundError

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
"""


class EditKind(StrEnum):
    """What is edited."""

    TIE = "tie"
    """A wish: a tie to add, veto or move."""
    ANNOTATION = "annotation"
    """A place, line or area with a text."""
    UNDO = "undo"
    """Another edit, which counts no more."""


class EditConflictError(ProductError):
    """The edit contradicts another that came before."""


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
    """Whether nobody has taken it back."""


@dataclass(frozen=True, slots=True)
class EditLog:
    """The log of edits of a store."""

    path: Path

    @classmethod
    def of(cls, root: Path) -> EditLog:
        """That of the store at `root`; nothing is written before the first edit is."""
        return cls(root / FILE)

    def append(
        self, mission: str, kind: EditKind, document: dict[str, Any], author: str, note: str = ""
    ) -> Edit:
        """Add an edit."""
        return self._append(mission, kind, document, author, note, None)

    def undo(self, mission: str, number: int, author: str, note: str = "") -> Edit:
        """Take an edit back; taking that back again makes it count once more.

        Raises:
            ProductNotFoundError: the mission has no such edit.
            EditConflictError: it has been taken back already.
        """
        known = {edit.id: edit for edit in self.edits(mission)}
        if number not in known:
            raise ProductNotFoundError(f"{mission} has no edit {number}")
        if not known[number].counts:
            raise EditConflictError(
                f"edit {number} of {mission} has been taken back already; read the log again"
            )
        return self._append(mission, EditKind.UNDO, {}, author, note, number)

    def edits(self, mission: str | None = None) -> list[Edit]:
        """All edits, or those of a mission, in their order; also those that count no more."""
        if not self.path.is_file():
            return []
        with transaction(self.path, _SCHEMA) as connection:
            rows = connection.execute(
                "SELECT id, mission, kind, document, author, at, note, undoes FROM edits "
                "WHERE ? IS NULL OR mission = ? ORDER BY id",
                (mission, mission),
            ).fetchall()
        undone: set[int] = set()
        for number, *_, undoes in reversed(rows):  # who undoes comes after what is undone
            if undoes is not None and number not in undone:
                undone.add(undoes)
        return [_edit(row, row[0] not in undone) for row in rows]

    def counting(self, kind: EditKind, mission: str | None = None) -> list[Edit]:
        """The edits of a kind that count."""
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
        with transaction(self.path, _SCHEMA) as connection:
            added = connection.execute(
                "INSERT INTO edits(mission, kind, document, author, at, note, undoes) "
                "VALUES(?,?,?,?,?,?,?)",
                row,
            )
            number = added.lastrowid or 0
        return _edit((number, *row), counts=True)


def _edit(row: tuple[Any, ...], counts: bool) -> Edit:  # noqa: FBT001 - a fact of the row
    number, mission, kind, document, author, at, note, undoes = row
    known = json.loads(document)
    return Edit(number, mission, EditKind(kind), known, author, at, note, undoes, counts)
