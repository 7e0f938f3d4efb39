"""Copies of remote files on this machine, the least recently used removed first.

A copy appears by renaming, so it is whole; all processes of a machine share the folder. What was
asked for a moment ago stays, even over the limit: somebody is about to open it.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

_JUST_USED_S = 300.0
_TOUCHED_S = 10.0
"""Uses closer together than this are one use."""
_SLACK = 20
"""Room is made whenever a process has added this part of the limit, and that much more of it."""
_DEAD_S = 3600.0
"""A copy that has been half done for so long belongs to a process that was killed."""
_HALF = ".half-"


@dataclass(slots=True, eq=False)
class ReadCache:
    """A folder of copies."""

    folder: Path
    limit: int
    """Bytes of copies to keep."""
    _added: int = field(default=0, init=False)
    """Bytes since room was last made."""

    def path(self, name: str, fetch: Callable[[Path], None]) -> Path:
        """The copy of a file; `fetch` writes it where it is not here yet."""
        path = self.folder / name
        try:
            _touch(path)
        except FileNotFoundError:
            path.parent.mkdir(parents=True, exist_ok=True)
            descriptor, half = tempfile.mkstemp(prefix=_HALF, dir=path.parent)
            os.close(descriptor)
            try:
                fetch(Path(half))
                self.adopt(Path(half), name)
            finally:
                Path(half).unlink(missing_ok=True)
        return path

    def adopt(self, file: Path, name: str) -> None:
        """Take a whole file of the same disk as the copy."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        self._added += file.stat().st_size
        os.utime(file)
        file.replace(path)
        if self._added >= self.limit // _SLACK:
            self._added = 0
            self.make_room()

    def forget(self, name: str) -> None:
        """Have no copy of a file."""
        (self.folder / name).unlink(missing_ok=True)

    def make_room(self) -> None:
        """Remove what was not used for longest, until there is some room below the limit."""
        now, copies = time.time(), []
        for path in self.folder.rglob("*"):
            with contextlib.suppress(FileNotFoundError):  # others make room too
                stat = path.stat()
                if path.is_file():
                    copies.append((stat.st_mtime, stat.st_size, path))
        held = sum(size for _, size, _ in copies)
        for used, size, path in sorted(copies):
            half = path.name.startswith(_HALF)
            if now - used < (_DEAD_S if half else _JUST_USED_S):
                continue
            if half or held > self.limit - 2 * self.limit // _SLACK:
                path.unlink(missing_ok=True)
                held -= size


def _touch(path: Path) -> None:
    """Note that a copy is used.

    Raises:
        FileNotFoundError: there is none.
    """
    if time.time() - path.stat().st_mtime > _TOUCHED_S:
        os.utime(path)
