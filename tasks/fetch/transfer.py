"""Fetch one file from one of several mirrors, complete or not at all.

A mirror is tried until a number of consecutive attempts brought no new bytes, each continuing where
the last one ended (`partial`), with doubling waits. After a permanent error (`answers`) or wrong
content the next mirror is tried. A host that could not be reached at all is not tried again in the
same run, so that a dead mirror costs the attempts of only one file.
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

PROGRESS_BYTES = 1 << 16
"""An attempt with fewer new bytes counts as without progress."""
Wait = Annotated[float, Interval(ge=0.0, le=3600.0)]


@dataclass(frozen=True, slots=True)
class TransferParams:
    """Retry limits of a transfer."""

    connections: Annotated[int, Interval(ge=1, le=32)] = 3
    """Files at a time: the archive has many users."""
    attempts: Few = 5
    """Consecutive attempts without progress, per file and mirror."""
    first_wait_s: Wait = 1.0
    """Pause before the second attempt; doubled for each further one."""
    longest_wait_s: Wait = 60.0
    """Longest pause, also if the server's Retry-After is longer."""
    timeout_s: Annotated[float, Interval(gt=0.0, le=3600.0)] = 60.0
    """Longest time without receiving a byte."""

    def __post_init__(self) -> None:
        if min(self.connections, self.attempts) < 1 or self.timeout_s <= 0:
            raise ValueError("connections, attempts and timeout_s should be above zero")
        if min(self.first_wait_s, self.longest_wait_s) < 0:
            raise ValueError("waits should not be negative")


@dataclass(frozen=True, slots=True)
class Fetched:
    """A fetched file."""

    path: Path
    url: str
    """Its source address."""
    received_bytes: int
    """0 where it existed already and is unchanged."""


class Transfer:
    """Fetches files; safe to use from several threads."""

    def __init__(
        self,
        client: httpx.Client,
        hosts: Iterable[str],
        params: TransferParams,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        """Fetch with a client; only redirects to `hosts` are followed."""
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
        """Fetch a file from the first address that provides it.

        An existing target is requested only on condition that it has changed.

        Args:
            urls: the same file on several mirrors, in the order of preference.
            target: local path.
            check: raises `WrongContentError` for wrong content.
            progress: called for every chunk.

        Raises:
            FetchError: no mirror provides it.
            DiskError: it cannot be written.
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
        """Repeated attempts, see the module."""
        failed, best = 0, 0
        while True:
            if unreachable := self._unreachable.get(urlsplit(url).netloc):
                raise NextMirrorError(unreachable)
            try:
                return self._attempt(url, file, check, progress)
            except TryAgainError as error:
                log.info("%s: %s", url, error)
                failed = 1 if file.size >= best + PROGRESS_BYTES else failed + 1
                best = max(best, file.size)
                if failed >= self.params.attempts:
                    raise
                wait_s = self.params.first_wait_s * 2 ** (failed - 1)
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
                raise TryAgainError(f"{host_of(url)} does not continue an interrupted transfer")
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
