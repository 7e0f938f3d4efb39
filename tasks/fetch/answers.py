"""Responses of a server: a file, a part of it, "not modified", or an error.

    transport errors, 408, 425, 429, 5xx              the same address again, after a wait
    other 4xx, redirects off the list, coded bytes    the next mirror

Redirects are followed to listed hosts only, and never from https to http. This module also defines
the errors of fetching.
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
"""Transient HTTP statuses."""
ANSWERS = frozenset(
    {HTTPStatus.OK, HTTPStatus.PARTIAL_CONTENT, HTTPStatus.NOT_MODIFIED}
    | {HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE}
)
"""Statuses that concern the file; the caller interprets each."""


class FetchError(Exception):
    """Something could not be fetched; names the file and what every mirror answered."""


class WrongContentError(FetchError):
    """A file was transferred completely, but has the wrong content."""


class DiskError(FetchError):
    """The disk is full or the folder cannot be written: nothing further can be fetched."""


class TryAgainError(Exception):
    """A transient error; `reached` is whether the host was reached at all."""

    def __init__(self, reason: str, wait_s: float = 0.0, *, reached: bool = True) -> None:
        super().__init__(reason)
        self.wait_s = wait_s
        self.reached = reached


class NextMirrorError(Exception):
    """An error that a retry on the same server does not resolve."""


def open_client(timeout_s: float, connections: int) -> httpx.Client:
    """A client that requests files without compression; close it."""
    return httpx.Client(
        headers={"User-Agent": USER_AGENT, "Accept-Encoding": "identity"},
        timeout=httpx.Timeout(timeout_s),
        limits=httpx.Limits(max_connections=connections),
    )


@contextmanager
def answer(
    client: httpx.Client, url: str, headers: dict[str, str], hosts: frozenset[str]
) -> Iterator[httpx.Response]:
    """The response for a file, after redirects within `hosts`; its body is not read yet.

    Raises:
        TryAgainError: the connection broke, or the server is temporarily unavailable.
        NextMirrorError: the server has no such file, or redirects elsewhere.
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
    """The bytes of a response, as they arrive.

    Raises:
        TryAgainError: the connection broke before the end.
    """
    try:
        yield from response.iter_raw()
    except httpx.TransportError as error:
        host = response.url.host
        raise TryAgainError(f"{host} broke off the transfer ({_reason(error)})") from error


def host_of(url: str) -> str:
    """The host of an address, for messages."""
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
            raise NextMirrorError(
                f"{host} sends the file {coding}-coded, although no coding was requested"
            )
        return
    message = f"{host} answers {status} {response.reason_phrase} for {response.url.path}"
    if status in TRANSIENT:
        seconds = response.headers.get("retry-after", "")
        raise TryAgainError(message, float(seconds) if seconds.isdecimal() else 0.0)
    raise NextMirrorError(message)


def _redirect_target(response: httpx.Response, hosts: frozenset[str]) -> str:
    host = response.url.host
    try:
        target = response.url.join(response.headers["location"])
    except httpx.InvalidURL as error:
        raise NextMirrorError(f"{host} redirects without an address") from error
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
