"""One file from one of several mirrors, whole or not at all.

A file grows under `NAME.part` and takes its name when it is whole. What a transfer must know to go
on where it broke off stands beside it in `NAME.source`: the address, the length, and the validator
(strong ETag, else Last-Modified) that the server gave. The next attempt, in this run or a later
one, asks for the rest under the condition that the file is still the same (`Range`, `If-Range`); a
server that gives it from the beginning is obeyed, and lengths that disagree mean a new beginning.

    transport errors, 408, 429, 5xx, cut transfers   the same address again, after a wait
    other 4xx, redirects off the list, wrong content the next mirror
    a host that cannot be reached at all             not asked again in this run

Redirects are followed to listed hosts only, and never from https to http.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from http import HTTPStatus
from pathlib import Path
from typing import BinaryIO
from urllib.parse import urlsplit

import httpx

log = logging.getLogger(__name__)

CHUNK_BYTES = 1 << 16
"""Read at a time; an attempt that brought less is counted as fruitless."""
MAX_REDIRECTS = 5
MAX_FILE_BYTES = 1 << 30
"""Three times the largest index; a server that sends more is stopped."""
AGAIN = frozenset(
    {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_EARLY, HTTPStatus.TOO_MANY_REQUESTS}
    | {HTTPStatus(code) for code in (500, 502, 503, 504)}
)

USER_AGENT = "solmap"

Progress = Callable[[int, int | None], None]
"""Told the bytes of a file that are here, and its length if the server says."""


class FetchError(Exception):
    """Something could not be fetched; names the file and what every mirror answered."""


class WrongContentError(FetchError):
    """A file came whole, but is not what it should be."""


class DiskError(FetchError):
    """The disk is full or the folder cannot be written: nothing further can be fetched."""


class _TryAgainError(Exception):
    """A fault that may pass."""

    def __init__(self, reason: str, wait_s: float = 0.0, *, reached: bool = True) -> None:
        super().__init__(reason)
        self.wait_s = wait_s
        self.reached = reached


class _NextMirrorError(Exception):
    """A fault that asking again does not mend."""


@dataclass(frozen=True, slots=True)
class TransferParams:
    """How patient a transfer is."""

    connections: int = 3
    """Files at a time: the archive is shared by many."""
    attempts: int = 5
    """In a row that bring nothing new, per file and mirror."""
    first_wait_s: float = 1.0
    """Before the second attempt; doubled for each further one."""
    longest_wait_s: float = 60.0
    """Also caps what a server asks for by Retry-After."""
    timeout_s: float = 60.0
    """Without a byte."""

    def __post_init__(self) -> None:
        if min(self.connections, self.attempts) < 1 or self.timeout_s <= 0:
            raise ValueError("connections, attempts and timeout_s should be above zero")
        if min(self.first_wait_s, self.longest_wait_s) < 0:
            raise ValueError("waits should not be negative")


@dataclass(frozen=True, slots=True)
class Fetched:
    """A file that is here."""

    path: Path
    url: str
    """The address that gave it."""
    received_bytes: int
    """0 where it was here already and unchanged."""


@dataclass(frozen=True, slots=True)
class _Source:
    """What is known of a file that is not whole yet, or may have to be asked for again."""

    url: str
    validator: str | None = None
    length: int | None = None

    @property
    def conditions(self) -> dict[str, str]:
        """The headers that ask whether the file has changed."""
        if self.validator is None:
            return {}
        is_tag = self.validator.startswith('"')
        return {"If-None-Match" if is_tag else "If-Modified-Since": self.validator}


class Transfer:
    """Fetches files; safe to use from several threads."""

    def __init__(
        self,
        client: httpx.Client,
        hosts: Iterable[str],
        params: TransferParams,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        """Fetch with a client; redirects are followed to `hosts`."""
        self.client, self.hosts, self.params = client, frozenset(hosts), params
        self._wait = wait
        self._unreachable: dict[str, str] = {}

    def fetch(
        self,
        urls: Sequence[str],
        target: Path,
        check: Callable[[Path], None],
        progress: Progress = lambda _here, _length: None,
    ) -> Fetched:
        """Bring a file here from the first address that gives it.

        A target that is there already is asked for only under the condition that it has changed.

        Args:
            urls: the same file on several mirrors, in the order of trust.
            target: where it shall lie.
            check: raises `WrongContentError` for a file that is not what it should be.
            progress: told of every chunk.

        Raises:
            FetchError: no mirror gave it, or it cannot be written here.
        """
        reasons: list[str] = []
        for url in urls:
            try:
                return self._from_mirror(url, target, check, progress)
            except (_NextMirrorError, _TryAgainError, WrongContentError) as error:
                if isinstance(error, _TryAgainError) and not error.reached:
                    self._unreachable[urlsplit(url).netloc] = str(error)
                if str(error) not in reasons:
                    reasons.append(str(error))
            except OSError as error:
                raise DiskError(f"{target} cannot be written: {error.strerror or error}") from error
        raise FetchError(f"{target.name}: {'; '.join(reasons)}")

    def _from_mirror(
        self, url: str, target: Path, check: Callable[[Path], None], progress: Progress
    ) -> Fetched:
        """Attempt after attempt, until as many as are allowed in a row brought nothing new."""
        fruitless, best, part = 0, 0, _beside(target, ".part")
        while True:
            try:
                return self._attempt(url, target, check, progress)
            except _TryAgainError as error:
                log.info("%s: %s", url, error)
                here = part.stat().st_size if part.is_file() else 0
                fruitless = 1 if here >= best + CHUNK_BYTES else fruitless + 1
                best = max(best, here)
                if fruitless >= self.params.attempts:
                    raise
                wait_s = self.params.first_wait_s * 2 ** (fruitless - 1)
                self._wait(min(max(wait_s, error.wait_s), self.params.longest_wait_s))

    def _attempt(
        self, url: str, target: Path, check: Callable[[Path], None], progress: Progress
    ) -> Fetched:
        if down := self._unreachable.get(urlsplit(url).netloc):
            raise _NextMirrorError(down)
        part, notes = _beside(target, ".part"), _beside(target, ".source")
        known = _read_source(notes, url)
        here = part.stat().st_size if part.is_file() and known and known.length else 0
        headers = _range_headers(known, here)
        if known is not None and target.is_file() and not part.exists():
            headers = known.conditions
        with self._answer(url, headers) as response:
            if response.status_code == HTTPStatus.NOT_MODIFIED and target.is_file():
                return Fetched(target, url, 0)
            start = _start_of(response, known, here)
            if start is None:
                part.unlink(missing_ok=True)
                notes.unlink(missing_ok=True)
                raise _TryAgainError(f"{_host(url)} does not go on where it broke off")
            source = _source_of(url, response, start)
            if start == 0:
                _begin(part, notes, source)
            received = 0
            if response.status_code != HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
                received = _receive(response, part, start, source.length, progress)
        try:
            _finish(part, target, source, check)
        except WrongContentError:
            notes.unlink(missing_ok=True)
            raise
        return Fetched(target, url, received)

    @contextmanager
    def _answer(self, url: str, headers: dict[str, str]) -> Iterator[httpx.Response]:
        """The answer to a request, redirects followed, that has or may have the file in it."""
        for _ in range(MAX_REDIRECTS + 1):
            request = self.client.build_request("GET", url, headers=headers)
            try:
                response = self.client.send(request, stream=True, follow_redirects=False)
            except httpx.TransportError as error:
                unreached = isinstance(error, httpx.ConnectError | httpx.ConnectTimeout)
                raise _TryAgainError(
                    f"{_host(url)} {'cannot be reached' if unreached else 'broke off'}"
                    f" ({_said(error)})",
                    reached=not unreached,
                ) from error
            except httpx.HTTPError as error:
                raise _NextMirrorError(f"{_host(url)}: {_said(error)}") from error
            try:
                if not response.has_redirect_location:
                    _check_status(response)
                    yield response
                    return
                url = self._redirected(response)
            finally:
                response.close()
        raise _NextMirrorError(f"{_host(url)} redirects more than {MAX_REDIRECTS} times")

    def _redirected(self, response: httpx.Response) -> str:
        try:
            target = response.url.join(response.headers["location"])
        except httpx.InvalidURL as error:
            raise _NextMirrorError(f"{response.url.host} redirects to no address") from error
        if target.host not in self.hosts or target.scheme not in {"http", "https"}:
            raise _NextMirrorError(
                f"{response.url.host} redirects to {target.host or str(target)!r}, which is not "
                "among the hosts of the archive's file (redirect_hosts)"
            )
        if response.url.scheme == "https" and target.scheme != "https":
            raise _NextMirrorError(f"{response.url.host} redirects from https to http")
        return str(target)


def _begin(part: Path, notes: Path, source: _Source) -> None:
    """Start anew: an empty part first, so that notes never stand beside bytes of another file."""
    part.parent.mkdir(parents=True, exist_ok=True)
    part.write_bytes(b"")
    notes.write_text(json.dumps(asdict(source)))


def _finish(part: Path, target: Path, source: _Source, check: Callable[[Path], None]) -> None:
    """Let a whole file take its name; remove one that is not what it should be."""
    size = part.stat().st_size
    if source.length is not None and size < source.length:
        raise _TryAgainError(f"the transfer broke off at {size} of {source.length} bytes")
    try:
        check(part)
    except WrongContentError as error:
        part.unlink()
        if source.length is None:  # nobody said how long it is: it may have been cut
            raise _TryAgainError(str(error)) from error
        raise
    part.replace(target)


def open_client(params: TransferParams) -> httpx.Client:
    """A client for a transfer; close it."""
    return httpx.Client(
        headers={"User-Agent": USER_AGENT, "Accept-Encoding": "identity"},
        timeout=httpx.Timeout(params.timeout_s),
        limits=httpx.Limits(max_connections=params.connections),
    )


def _receive(
    response: httpx.Response, part: Path, start: int, length: int | None, progress: Progress
) -> int:
    """Write what comes behind the first `start` bytes; how many bytes came."""
    with part.open("r+b") as file:
        file.truncate(start)
        file.seek(start)
        for chunk in _chunks(response):
            _write(file, chunk, length)
            progress(file.tell(), length)
        return file.tell() - start


def _write(file: BinaryIO, chunk: bytes, length: int | None) -> None:
    limit = MAX_FILE_BYTES if length is None else length
    if file.tell() + len(chunk) > limit:
        raise _NextMirrorError(f"the server sends more than {limit} bytes")
    file.write(chunk)


def _chunks(response: httpx.Response) -> Iterable[bytes]:
    try:
        yield from response.iter_raw()
    except httpx.TransportError as error:
        raise _TryAgainError(
            f"{response.url.host} broke off the transfer ({_said(error)})"
        ) from error


def _check_status(response: httpx.Response) -> None:
    status, host = response.status_code, response.url.host
    fits = {HTTPStatus.OK, HTTPStatus.PARTIAL_CONTENT, HTTPStatus.NOT_MODIFIED}
    if status in fits | {HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE}:
        coding = response.headers.get("content-encoding", "identity")
        if coding != "identity":  # byte ranges would be those of the compressed file
            raise _NextMirrorError(f"{host} sends the file {coding}-coded, though asked not to")
        return
    said = f"{host} answers {status} {response.reason_phrase} for {response.url.path}"
    if status in AGAIN:
        raise _TryAgainError(said, _retry_after(response))
    raise _NextMirrorError(said)


def _start_of(response: httpx.Response, known: _Source | None, here: int) -> int | None:
    """Byte from which the answer goes on; None where it does not go on from what is here."""
    if response.status_code == HTTPStatus.OK:
        return 0
    if known is None or not here:
        return None
    unit, _, rest = response.headers.get("content-range", "").partition(" ")
    span, _, total = rest.partition("/")
    if unit != "bytes" or total != str(known.length):
        return None
    if response.status_code == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
        return here if here == known.length else None
    return here if span.partition("-")[0] == str(here) else None


def _range_headers(known: _Source | None, here: int) -> dict[str, str]:
    if known is None or not here:
        return {}
    headers = {"Range": f"bytes={here}-"}
    if known.validator is not None:
        headers["If-Range"] = known.validator
    return headers


def _source_of(url: str, response: httpx.Response, start: int) -> _Source:
    """What the answer says of the whole file."""
    if response.status_code == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
        return _Source(url, None, start)
    tag = response.headers.get("etag", "")
    validator = tag if tag.startswith('"') else response.headers.get("last-modified")
    length = response.headers.get("content-length", "")
    return _Source(url, validator, start + int(length) if length.isdecimal() else None)


def _read_source(notes: Path, url: str) -> _Source | None:
    """The notes of an earlier attempt at the same address, if they can be read."""
    try:
        source = _Source(**json.loads(notes.read_text()))
    except (OSError, ValueError, TypeError):
        return None
    return source if source.url == url else None


def forget_source(target: Path) -> None:
    """Remove the notes of a file that will not be asked for again."""
    _beside(target, ".source").unlink(missing_ok=True)


def _beside(target: Path, ending: str) -> Path:
    return target.with_name(target.name + ending)


def _retry_after(response: httpx.Response) -> float:
    seconds = response.headers.get("retry-after", "")
    return float(seconds) if seconds.isdecimal() else 0.0


def _host(url: str) -> str:
    return urlsplit(url).hostname or url


def _said(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
