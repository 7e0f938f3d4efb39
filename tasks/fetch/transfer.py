"""One file from one of several mirrors, whole or not at all.

A mirror is asked until as many attempts as are allowed in a row brought nothing new, each going on
where the last one broke off (`partial`), with waits that double. A fault that does not pass
(`answers`) or wrong content mean the next mirror. A host that could not be reached at all is not
asked again in the same run, so that a dead mirror costs one file's attempts and not every file's.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import httpx
from annotated_types import Interval

from solmap.photogrammetry.ranges import Few
from solmap.tasks.fetch.answers import (
    DiskError,
    FetchError,
    NextMirrorError,
    TryAgainError,
    WrongContentError,
    answer,
    body,
    host_of,
)
from solmap.tasks.fetch.partial import PartialFile, Progress, Source

log = logging.getLogger(__name__)

FRUITFUL_BYTES = 1 << 16
"""An attempt that brought less brought nothing new."""
Wait = Annotated[float, Interval(ge=0.0, le=3600.0)]


@dataclass(frozen=True, slots=True)
class TransferParams:
    """How patient a transfer is."""

    connections: Annotated[int, Interval(ge=1, le=32)] = 3
    """Files at a time: the archive is shared by many."""
    attempts: Few = 5
    """In a row that bring nothing new, per file and mirror."""
    first_wait_s: Wait = 1.0
    """Before the second attempt; doubled for each further one."""
    longest_wait_s: Wait = 60.0
    """Also caps what a server asks for by Retry-After."""
    timeout_s: Annotated[float, Interval(gt=0.0, le=3600.0)] = 60.0
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
        self.params = params
        self.hosts = frozenset(hosts)
        self._client, self._wait = client, wait
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
            FetchError: no mirror gave it.
            DiskError: it cannot be written here.
        """
        reasons: list[str] = []
        file = PartialFile(target)
        for url in urls:
            try:
                return self._from_mirror(url, file, check, progress)
            except (NextMirrorError, TryAgainError, WrongContentError) as error:
                if isinstance(error, TryAgainError) and not error.reached:
                    self._unreachable[urlsplit(url).netloc] = str(error)
                if str(error) not in reasons:
                    reasons.append(str(error))
            except OSError as error:
                raise DiskError(f"{target} cannot be written: {error.strerror or error}") from error
        raise FetchError(f"{target.name}: {'; '.join(reasons)}")

    def _from_mirror(
        self, url: str, file: PartialFile, check: Callable[[Path], None], progress: Progress
    ) -> Fetched:
        """Attempt after attempt, see the module."""
        fruitless, best = 0, 0
        while True:
            if unreachable := self._unreachable.get(urlsplit(url).netloc):
                raise NextMirrorError(unreachable)
            try:
                return self._attempt(url, file, check, progress)
            except TryAgainError as error:
                log.info("%s: %s", url, error)
                fruitless = 1 if file.size >= best + FRUITFUL_BYTES else fruitless + 1
                best = max(best, file.size)
                if fruitless >= self.params.attempts:
                    raise
                wait_s = self.params.first_wait_s * 2 ** (fruitless - 1)
                self._wait(min(max(wait_s, error.wait_s), self.params.longest_wait_s))

    def _attempt(
        self, url: str, file: PartialFile, check: Callable[[Path], None], progress: Progress
    ) -> Fetched:
        with answer(self._client, url, file.headers(url), self.hosts) as response:
            if response.status_code == HTTPStatus.NOT_MODIFIED and file.target.is_file():
                return Fetched(file.target, url, 0)
            start = file.start_of(url, response)
            if start is None:
                file.forget()
                raise TryAgainError(f"{host_of(url)} does not go on where it broke off")
            length = Source.of(url, response, start).length
            received = 0
            if start == 0:
                file.begin(Source.of(url, response, start))
            if response.status_code == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
                length = start
            else:
                received = file.append(body(response), start, length, progress)
        file.finish(length, check)
        return Fetched(file.target, url, received)
