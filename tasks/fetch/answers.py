"""What a server answers: a file, a part of it, that nothing has changed, or a fault.

    transport errors, 408, 425, 429, 5xx              the same address again, after a wait
    other 4xx, redirects off the list, coded bytes    the next mirror

Redirects are followed to listed hosts only, and never from https to http. The errors of fetching
stand here, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from urllib.parse import urlsplit

import httpx

USER_AGENT = "solmap"
MAX_REDIRECTS = 5
TRANSIENT = frozenset(
    {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_EARLY, HTTPStatus.TOO_MANY_REQUESTS}
    | {HTTPStatus(code) for code in (500, 502, 503, 504)}
)
"""Faults that may pass."""
ANSWERS = frozenset(
    {HTTPStatus.OK, HTTPStatus.PARTIAL_CONTENT, HTTPStatus.NOT_MODIFIED}
    | {HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE}
)
"""What tells of the file; who asked for a range knows what to make of each."""


class FetchError(Exception):
    """Something could not be fetched; names the file and what every mirror answered."""


class WrongContentError(FetchError):
    """A file came whole, but is not what it should be."""


class DiskError(FetchError):
    """The disk is full or the folder cannot be written: nothing further can be fetched."""


class TryAgainError(Exception):
    """A fault that may pass; `reached` says whether the host was there at all."""

    def __init__(self, reason: str, wait_s: float = 0.0, *, reached: bool = True) -> None:
        super().__init__(reason)
        self.wait_s = wait_s
        self.reached = reached


class NextMirrorError(Exception):
    """A fault that asking the same server again does not mend."""


def open_client(timeout_s: float, connections: int) -> httpx.Client:
    """A client that asks for files as they are, not compressed on the way; close it."""
    return httpx.Client(
        headers={"User-Agent": USER_AGENT, "Accept-Encoding": "identity"},
        timeout=httpx.Timeout(timeout_s),
        limits=httpx.Limits(max_connections=connections),
    )


@contextmanager
def answer(
    client: httpx.Client, url: str, headers: dict[str, str], hosts: frozenset[str]
) -> Iterator[httpx.Response]:
    """The answer that tells of a file, redirects to `hosts` followed; its body is still to come.

    Raises:
        TryAgainError: the connection broke, or the server said that it cannot at present.
        NextMirrorError: the server has no such file, or sends elsewhere.
    """
    for _ in range(MAX_REDIRECTS + 1):
        response = _send(client, url, headers)
        try:
            if not response.has_redirect_location:
                _check(response)
                yield response
                return
            url = _redirect_target(response, hosts)
        finally:
            response.close()
    raise NextMirrorError(f"{host_of(url)} redirects more than {MAX_REDIRECTS} times")


def body(response: httpx.Response) -> Iterable[bytes]:
    """The bytes of an answer, as they come.

    Raises:
        TryAgainError: the connection broke before the end.
    """
    try:
        yield from response.iter_raw()
    except httpx.TransportError as error:
        host = response.url.host
        raise TryAgainError(f"{host} broke off the transfer ({_reason(error)})") from error


def host_of(url: str) -> str:
    """The host of an address, to name it in a complaint."""
    return urlsplit(url).hostname or url


def _send(client: httpx.Client, url: str, headers: dict[str, str]) -> httpx.Response:
    request = client.build_request("GET", url, headers=headers)
    try:
        return client.send(request, stream=True, follow_redirects=False)
    except (httpx.ConnectError, httpx.ConnectTimeout) as error:
        raise TryAgainError(
            f"{host_of(url)} cannot be reached ({_reason(error)})", reached=False
        ) from error
    except httpx.TransportError as error:
        raise TryAgainError(f"{host_of(url)} broke off ({_reason(error)})") from error


def _check(response: httpx.Response) -> None:
    status, host = response.status_code, response.url.host
    if status in ANSWERS:
        coding = response.headers.get("content-encoding", "identity")
        if coding != "identity":  # byte ranges would be those of the compressed file
            raise NextMirrorError(f"{host} sends the file {coding}-coded, though asked not to")
        return
    said = f"{host} answers {status} {response.reason_phrase} for {response.url.path}"
    if status in TRANSIENT:
        seconds = response.headers.get("retry-after", "")
        raise TryAgainError(said, float(seconds) if seconds.isdecimal() else 0.0)
    raise NextMirrorError(said)


def _redirect_target(response: httpx.Response, hosts: frozenset[str]) -> str:
    host = response.url.host
    try:
        target = response.url.join(response.headers["location"])
    except httpx.InvalidURL as error:
        raise NextMirrorError(f"{host} redirects to no address") from error
    if target.host not in hosts or target.scheme not in {"http", "https"}:
        raise NextMirrorError(
            f"{host} redirects to {target.host or str(target)!r}, which is not among the hosts of "
            "the archive's file (redirect_hosts)"
        )
    if response.url.scheme == "https" and target.scheme != "https":
        raise NextMirrorError(f"{host} redirects from https to http")
    return str(target)


def _reason(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
