"""An incomplete file, and the data needed to continue its download.

A file is downloaded to `NAME.part` and renamed when it is complete. Beside it is `NAME.source`: the
address, the length, and the validator (strong ETag, else Last-Modified) of the server. The next
attempt, in this run or a later one, requests the rest on condition that the file is still the same
(`Range`, `If-Range`). If the server sends it from the beginning, or lengths differ, the download
restarts. For a complete file the notes are used to check whether it has changed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from http import HTTPStatus
from pathlib import Path

import httpx

from solmap.tasks.fetch.answers import NextMirrorError, TryAgainError, WrongContentError

MAX_FILE_BYTES = 1 << 30
"""Size at which a transfer of unknown length is stopped: three times the largest index."""

Progress = Callable[[int, int | None], None]
"""Called with the local bytes of a file, and its length if the server gives it."""


@dataclass(frozen=True, slots=True)
class Source:
    """Address, length and validator of a file on a server."""

    url: str
    validator: str | None = None
    length: int | None = None

    @classmethod
    def of(cls, url: str, response: httpx.Response, start: int) -> Source:
        """From a response that continues at byte `start`."""
        tag = response.headers.get("etag", "")
        validator = tag if tag.startswith('"') else response.headers.get("last-modified")
        length = response.headers.get("content-length", "")
        return cls(url, validator, start + int(length) if length.isdecimal() else None)


@dataclass(frozen=True, slots=True)
class PartialFile:
    """The local part of a file."""

    target: Path

    @property
    def part(self) -> Path:
        """Path of the incomplete file."""
        return self.target.with_name(self.target.name + ".part")

    @property
    def notes(self) -> Path:
        """Path of the notes on its source."""
        return self.target.with_name(self.target.name + ".source")

    @property
    def size(self) -> int:
        """Bytes of the local part."""
        return self.part.stat().st_size if self.part.is_file() else 0

    def source(self, url: str) -> Source | None:
        """The source recorded by an earlier attempt at the same address."""
        try:
            source = Source(**json.loads(self.notes.read_text()))
        except (OSError, ValueError, TypeError):
            return None
        return source if source.url == url else None

    def headers(self, url: str) -> dict[str, str]:
        """Headers of a request for the missing bytes, or for changes of a complete file."""
        known = self.source(url)
        if known is None:
            return {}
        if self.target.is_file() and not self.part.exists():
            return _if_changed(known.validator)
        if not self.size or known.length is None:
            return {}
        condition = {} if known.validator is None else {"If-Range": known.validator}
        return {"Range": f"bytes={self.size}-", **condition}

    def start_of(self, url: str, response: httpx.Response) -> int | None:
        """Byte at which a response continues; None where it does not continue the local part."""
        if response.status_code == HTTPStatus.OK:
            return 0
        known, here = self.source(url), self.size
        unit, _, rest = response.headers.get("content-range", "").partition(" ")
        span, _, total = rest.partition("/")
        if known is None or unit != "bytes" or total != str(known.length):
            return None
        is_all = response.status_code == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE
        goes_on = here == known.length if is_all else span.partition("-")[0] == str(here)
        return here if goes_on and here else None

    def begin(self, source: Source) -> None:
        """Start again: an empty part first, so that no notes exist beside bytes of another file."""
        self.part.parent.mkdir(parents=True, exist_ok=True)
        self.part.write_bytes(b"")
        self.notes.write_text(json.dumps(asdict(source)))

    def append(
        self, chunks: Iterable[bytes], start: int, length: int | None, progress: Progress
    ) -> int:
        """Write the bytes after the first `start`; returns how many arrived."""
        limit = MAX_FILE_BYTES if length is None else length
        with self.part.open("r+b") as file:
            file.seek(start)
            for chunk in chunks:
                if file.tell() + len(chunk) > limit:
                    raise NextMirrorError(f"the server sends more than {limit} bytes")
                file.write(chunk)
                progress(file.tell(), length)
            return file.tell() - start

    def finish(self, length: int | None, check: Callable[[Path], None]) -> None:
        """Rename a complete file; remove one with wrong content.

        Raises:
            TryAgainError: it is not complete yet.
            WrongContentError: it is complete, but `check` rejects it.
        """
        if length is not None and self.size < length:
            raise TryAgainError(f"the transfer ended at {self.size} of {length} bytes")
        try:
            check(self.part)
        except WrongContentError as error:
            self.forget()
            if length is None:  # its length is unknown: it may be truncated
                raise TryAgainError(str(error)) from error
            raise
        self.part.replace(self.target)

    def forget(self) -> None:
        """Remove the part and the notes, so that the next attempt starts again."""
        self.part.unlink(missing_ok=True)
        self.notes.unlink(missing_ok=True)


def _if_changed(validator: str | None) -> dict[str, str]:
    if validator is None:
        return {}
    return {"If-None-Match" if validator.startswith('"') else "If-Modified-Since": validator}
