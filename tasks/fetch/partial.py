"""A file that is not whole yet, and what must be known to go on with it.

A file grows under `NAME.part` and takes its name when it is whole. Beside it stands `NAME.source`:
the address, the length, and the validator (strong ETag, else Last-Modified) that the server gave.
The next attempt, in this run or a later one, asks for the rest under the condition that the file is
still the same (`Range`, `If-Range`); a server that gives it from the beginning is obeyed, and
lengths that disagree mean a new beginning. Of a file that is whole the notes serve to ask whether
it has changed.
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
"""Three times the largest index; a server that sends more without saying so is stopped."""

Progress = Callable[[int, int | None], None]
"""Told the bytes of a file that are here, and its length if the server says."""


@dataclass(frozen=True, slots=True)
class Source:
    """What a server said of a file."""

    url: str
    validator: str | None = None
    length: int | None = None

    @classmethod
    def of(cls, url: str, response: httpx.Response, start: int) -> Source:
        """What an answer says that goes on from byte `start`."""
        tag = response.headers.get("etag", "")
        validator = tag if tag.startswith('"') else response.headers.get("last-modified")
        length = response.headers.get("content-length", "")
        return cls(url, validator, start + int(length) if length.isdecimal() else None)


@dataclass(frozen=True, slots=True)
class PartialFile:
    """What is here of a file."""

    target: Path

    @property
    def part(self) -> Path:
        """Where it grows."""
        return self.target.with_name(self.target.name + ".part")

    @property
    def notes(self) -> Path:
        """Where it is written down whence it comes."""
        return self.target.with_name(self.target.name + ".source")

    @property
    def size(self) -> int:
        """Bytes of the part that are here."""
        return self.part.stat().st_size if self.part.is_file() else 0

    def source(self, url: str) -> Source | None:
        """What an earlier attempt at the same address wrote down."""
        try:
            source = Source(**json.loads(self.notes.read_text()))
        except (OSError, ValueError, TypeError):
            return None
        return source if source.url == url else None

    def headers(self, url: str) -> dict[str, str]:
        """How to ask for what is missing, or whether a whole file has changed."""
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
        """Byte from which an answer goes on; None where it does not go on from what is here."""
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
        """Start anew: an empty part first, so that no notes stand beside bytes of another file."""
        self.part.parent.mkdir(parents=True, exist_ok=True)
        self.part.write_bytes(b"")
        self.notes.write_text(json.dumps(asdict(source)))

    def append(
        self, chunks: Iterable[bytes], start: int, length: int | None, progress: Progress
    ) -> int:
        """Write what comes behind the first `start` bytes; how many bytes came."""
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
        """Let a whole file take its name; remove one that is not what it should be.

        Raises:
            TryAgainError: it is not whole yet.
            WrongContentError: it is whole, but `check` refuses it.
        """
        if length is not None and self.size < length:
            raise TryAgainError(f"the transfer broke off at {self.size} of {length} bytes")
        try:
            check(self.part)
        except WrongContentError as error:
            self.forget()
            if length is None:  # nobody said how long it is: it may have been cut
                raise TryAgainError(str(error)) from error
            raise
        self.part.replace(self.target)

    def forget(self) -> None:
        """Remove the part and the notes: the next attempt begins anew."""
        self.part.unlink(missing_ok=True)
        self.notes.unlink(missing_ok=True)


def _if_changed(validator: str | None) -> dict[str, str]:
    if validator is None:
        return {}
    return {"If-None-Match" if validator.startswith('"') else "If-Modified-Since": validator}
