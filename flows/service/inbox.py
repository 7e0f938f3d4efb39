"""The folder in which downlinks arrive: its complete and unprocessed files.

A file is complete when its size and date have not changed for a while. Names that transfer programs
use for incomplete files (`.x`, `x.part`, `x.tmp`) are skipped.
"""

from __future__ import annotations

import hashlib
import json
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_PAUSES_S = (60.0, 300.0, 900.0, 3600.0)
"""Pauses between attempts at a delivery whose run failed; after the last it waits for other
files."""
_ON_THE_WAY = (".part", ".partial", ".tmp", ".filepart", ".crdownload")


@dataclass(frozen=True, slots=True)
class FileState:
    """Size and time of a file, which show whether it still changes."""

    size: int
    modified_ns: int


@dataclass(frozen=True, slots=True)
class InboxParams:
    """How an inbox is watched."""

    settle_s: float = 20.0
    """A file that has not changed for this long is complete."""
    patience_s: float = 600.0
    """Complete files wait this long for arriving ones, then they are processed without them."""


@dataclass(slots=True)
class Inbox:
    """A watched folder.

    Processed files are recorded in a file: a restart processes nothing twice, and repeats a
    delivery whose processing was interrupted.
    """

    folder: Path
    memory: Path
    params: InboxParams
    _seen: dict[str, tuple[FileState, float]] = field(default_factory=dict)
    """Every file as last seen, and since when it is unchanged."""
    _waiting_since: float | None = None
    _not_before: float = 0.0
    """Time at which a failed delivery may be retried."""

    def poll(self, now: float | None = None) -> str | None:
        """Look once; returns the name of a delivery to process now, or None.

        Args:
            now: Seconds of a clock that only goes forward.
        """
        at = time.monotonic() if now is None else now
        self._note(at)
        whole = {
            name: state
            for name, (state, since) in self._seen.items()
            if at - since >= self.params.settle_s
        }
        delivery = _digest(whole)
        memory = self._read_memory()
        if not whole or delivery == memory.get("delivery"):
            self._waiting_since = None
            return None
        attempts = _attempts(memory, delivery)
        if attempts > len(_PAUSES_S) or (attempts and at < self._not_before):
            return None
        if self._waiting_since is None:
            self._waiting_since = at
        all_here = len(whole) == len(self._seen)
        if not all_here and at - self._waiting_since < self.params.patience_s:
            return None
        return delivery

    def mark_processed(self, delivery: str) -> None:
        """Remember that a delivery was processed."""
        self._write_memory({"delivery": delivery})
        self._waiting_since = None

    def mark_failed(self, delivery: str, now: float | None = None) -> float | None:
        """Remember that the run of a delivery failed; seconds until it is tried again.

        None if it was tried often enough: it then waits until files arrive or change.
        """
        memory = self._read_memory()
        attempts = _attempts(memory, delivery) + 1
        failed = {"delivery": delivery, "attempts": attempts}
        self._write_memory({**memory, "failed": failed})
        if attempts > len(_PAUSES_S):
            return None
        pause = _PAUSES_S[attempts - 1]
        self._not_before = (time.monotonic() if now is None else now) + pause
        return pause

    def _write_memory(self, memory: dict[str, Any]) -> None:
        draft = self.memory.with_suffix(".draft")
        draft.write_text(json.dumps(memory))
        draft.replace(self.memory)

    def _read_memory(self) -> dict[str, Any]:
        """The files processed last and those that failed; empty if unreadable.

        Processing again is safe.
        """
        try:
            memory = json.loads(self.memory.read_text())
        except (OSError, ValueError):
            return {}
        return memory if isinstance(memory, dict) else {}

    def _note(self, at: float) -> None:
        found: dict[str, tuple[FileState, float]] = {}
        for path in _files(self.folder):
            try:
                facts = path.stat()
            except OSError:
                continue  # removed meanwhile, or in a folder without permission
            if not stat.S_ISREG(facts.st_mode):
                continue
            state = FileState(facts.st_size, facts.st_mtime_ns)
            name = str(path.relative_to(self.folder))
            before = self._seen.get(name)
            found[name] = before if before and before[0] == state else (state, at)
        self._seen = found


def _attempts(memory: dict[str, Any], delivery: str) -> int:
    """How often a delivery has failed."""
    failed = memory.get("failed")
    if not isinstance(failed, dict) or failed.get("delivery") != delivery:
        return 0
    attempts = failed.get("attempts")
    return attempts if isinstance(attempts, int) else 0


def _files(folder: Path) -> Iterator[Path]:
    """Files below a folder, including labels, without files that are still arriving."""
    for path in folder.rglob("*"):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if not hidden and path.suffix.lower() not in _ON_THE_WAY:
            yield path


def _digest(files: dict[str, FileState]) -> str:
    digest = hashlib.sha256()
    for name, state in sorted(files.items()):
        line = f"{name}\0{state.size}\0{state.modified_ns}\n"
        digest.update(line.encode(errors="surrogateescape"))  # names need not be UTF-8
    return digest.hexdigest()[:16]
