"""Processing of every request and answer: public URL, security headers, compression, limits."""

from __future__ import annotations

import contextlib
import math
import re
from http import HTTPStatus
from urllib.parse import urlsplit

import anyio
from fastapi import Request
from starlette.datastructures import MutableHeaders
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from solmap.gis_server.addresses import ROOT_PATH
from solmap.gis_server.budgets import ROUTE
from solmap.gis_server.errors import problem

MOST_BYTES = 1 << 20
BODY_S = 30.0
"""Longest time that a body may take to arrive."""
_WITHOUT_BODY = {"GET", "HEAD", "OPTIONS"}
"""Methods whose bodies no endpoint reads."""
_BEYOND = HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE
_RANGE = re.compile(rb"(\d*)-(\d*)")
_ENDLESS, _LARGEST = re.compile(rb"\d{19,}"), b"9" * 18
"""Byte positions beyond any file."""
_HEAD = "solmap.head"
"""Key in the scope of a HEAD request."""
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; connect-src 'self' blob:; "
        "img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; worker-src 'self' blob:; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
    "Permissions-Policy": (
        "camera=(), microphone=(), geolocation=(), payment=(), usb=(), serial=(), midi=(), "
        "display-capture=()"
    ),
}
"""Nothing is loaded from other origins, the map cannot be embedded, other origins have no
access (no CORS). `wasm-unsafe-eval` lets the decoder of compressed 3D models, which is served
from here, be compiled in a worker; it allows no JavaScript from text. Images inside models are
read as blobs."""
_PACKED = ("/tiles/", "/models/", "/download/", "/products/", "/images/", "/panoramas/")
"""Paths whose content is compressed already, or requested by ranges."""


class PublicAddress:
    """Set scheme, host and path of every request to the public URL, so that links use it.

    A reverse proxy may forward paths with or without the prefix of the public address.
    """

    def __init__(self, app: ASGIApp, url: str) -> None:
        parts = urlsplit(url)
        self.app, self.root = app, parts.path.rstrip("/")
        self.scheme, self.host = parts.scheme, (b"host", parts.netloc.encode("idna"))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward the request as a request to the public URL."""
        if scope["type"] == "http":
            ROOT_PATH.set(self.root)
            path = scope["path"]
            headers = [pair for pair in scope["headers"] if pair[0] != b"host"]
            scope = {
                **scope,
                "scheme": self.scheme,
                "headers": [*headers, self.host],
                "root_path": self.root,
                "path": path if f"{path}/".startswith(f"{self.root}/") else self.root + path,
            }
        await self.app(scope, receive, send)


class AnswerHead:
    """Answers HEAD wherever GET is answered: routes are matched as GET."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Process the request as GET, and omit the body."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return

        async def send_head(message: Message) -> None:
            if message["type"] == "http.response.start":
                await send(message)

        requested = {**scope, "method": "GET", _HEAD: True}
        await self.app(requested, receive, send_head)
        await send({"type": "http.response.body", "body": b""})
        scope.update({name: requested[name] for name in (ROUTE, "route") if name in requested})


async def restore_head(request: Request) -> None:
    """Whether a request is HEAD, so that its endpoint need not read files."""
    if _HEAD in request.scope:
        request.scope["method"] = "HEAD"


class ReadableRanges:
    """Removes `Range` headers that violate RFC 9110, and limits their numbers to 64 bits.

    Ranges beyond the end of a file are answered with a problem document.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, with ranges that files and objects support."""
        if scope["type"] == "http" and any(name == b"range" for name, _ in scope["headers"]):
            headers = [
                (name, ranges if name == b"range" else value)
                for name, value in scope["headers"]
                if name != b"range" or (ranges := readable_ranges(value))
            ]
            scope["headers"] = headers
        is_refused = False

        async def send_problem(message: Message) -> None:
            """File servers refuse a range in plain text."""
            nonlocal is_refused
            if message["type"] == "http.response.start" and message["status"] == _BEYOND:
                is_refused = True
                size = MutableHeaders(scope=message).get("content-range", "bytes */0")
                text = f"the range lies beyond the end: {size.rpartition('/')[2]} bytes"
                path = scope["path"]
                answer = problem(_BEYOND, text, path, {"Content-Range": size})
                await answer(scope, receive, send)
            elif not is_refused:
                await send(message)

        await self.app(scope, receive, send_problem if scope["type"] == "http" else send)


def readable_ranges(header: bytes) -> bytes | None:
    """The ranges of a header with numbers that fit into 64 bits; None if they must be ignored.

    That is so for units other than bytes, and for malformed or reversed ranges.
    """
    unit, _, given = _ENDLESS.sub(_LARGEST, header).partition(b"=")
    ranges = [part.strip() for part in given.split(b",")]
    for one in ranges:
        found = _RANGE.fullmatch(one)
        if found is None or one == b"-" or (all(found.groups()) and int(found[1]) > int(found[2])):
            return None
    return b"bytes=" + b",".join(ranges) if unit.strip().lower() == b"bytes" else None


class _RefusedError(Exception):
    """A body is too large, or too slow."""


class LimitBodies:
    """Answers 413 where a body is larger than `MOST_BYTES`, and 408 where it takes too long."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Count the bytes that come."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        if _announces_too_much(scope):
            await _too_large(scope["path"])(scope, receive, send)
            return
        if scope["method"] in _WITHOUT_BODY:
            await self.app(scope, receive, send)
            return
        came, has_started, is_whole = 0, False, False
        refusal: JSONResponse | None = None
        deadline = anyio.current_time() + BODY_S

        async def receive_counted() -> Message:
            nonlocal came, is_whole, refusal
            with anyio.CancelScope(deadline=math.inf if is_whole else deadline) as waiting:
                message = await receive()
            if waiting.cancelled_caught:
                refusal = _too_slow(scope["path"])
                raise _RefusedError
            came += len(message.get("body", b""))
            is_whole = not message.get("more_body", False)
            if came > MOST_BYTES:
                refusal = _too_large(scope["path"])
                raise _RefusedError
            return message

        async def send_unless_refused(message: Message) -> None:
            nonlocal has_started
            if refusal is None or has_started:  # else the app answers with an error of its own
                has_started = True
                await send(message)

        with contextlib.suppress(_RefusedError):
            await self.app(scope, receive_counted, send_unless_refused)
        if refusal is not None and not has_started:
            await refusal(scope, receive, send)


def _announces_too_much(scope: Scope) -> bool:
    announced = dict(scope["headers"]).get(b"content-length", b"0").lstrip(b"0")
    is_long = len(announced) > len(str(MOST_BYTES))
    return announced.isdigit() and (is_long or int(announced) > MOST_BYTES)


def _too_large(where: str) -> JSONResponse:
    text = f"a request has at most {MOST_BYTES} bytes; send less at once"
    return problem(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, text, where)


def _too_slow(where: str) -> JSONResponse:
    text = f"the body did not arrive within {BODY_S:.0f} s; send it faster, or less"
    return problem(HTTPStatus.REQUEST_TIMEOUT, text, where)


class SecurityHeaders:
    """Adds the headers to every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on and add the headers to the answer."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self.app(scope, receive, with_headers)


class CompressText:
    """Compresses text; files requested by range and images are sent unchanged."""

    def __init__(self, app: ASGIApp) -> None:
        excluded = (*DEFAULT_EXCLUDED_CONTENT_TYPES, "image/tiff", "application/octet-stream")
        self.plain = app
        self.compressing = GZipMiddleware(
            app, minimum_size=1000, compresslevel=5, exclude_content_types=excluded
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Choose by the address: tiles, models, downloads and images are never compressed."""
        path = scope.get("path", "").removeprefix(scope.get("root_path", ""))
        raw = path.startswith(_PACKED)
        await (self.plain if raw else self.compressing)(scope, receive, send)
