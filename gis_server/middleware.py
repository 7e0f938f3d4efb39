"""What is done with every request and answer: address, security headers, compression, a limit."""

from __future__ import annotations

import contextlib
from http import HTTPStatus
from urllib.parse import urlsplit

import anyio
from starlette.datastructures import MutableHeaders
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from solmap.gis_server.addresses import ROOT_PATH

MOST_BYTES = 1 << 20
_WITHOUT_BODY = {"GET", "HEAD", "OPTIONS"}
"""Methods whose bodies no endpoint reads."""
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
"""Nothing from elsewhere is loaded, nobody embeds the map, no other origin is let in (no CORS).
`wasm-unsafe-eval` lets the decoder of compressed 3D models, which is served from here, be compiled
in a worker; it allows no JavaScript from text. Pictures inside models are read as blobs."""
_PACKED = ("/tiles/", "/models/", "/download/", "/products/", "/images/", "/panoramas/")
"""What is served below these is compressed already, or asked for by ranges."""


class PublicAddress:
    """Has every request name the address that people reach the map at, so that links do.

    A reverse proxy may hand on paths with or without that of the public address before them.
    """

    def __init__(self, app: ASGIApp, url: str) -> None:
        parts = urlsplit(url)
        self.app, self.root = app, parts.path.rstrip("/")
        self.scheme, self.host = parts.scheme, (b"host", parts.netloc.encode("idna"))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on as one to the public address."""
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
    """Answers HEAD as GET without a body, for every address that has GET."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Ask for the same by GET, and end with the head of the answer."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return
        has_ended = False

        async def send_head(message: Message) -> None:
            nonlocal has_ended
            if message["type"] == "http.response.start":
                await send(message)
            elif not has_ended:
                has_ended = True
                await send({"type": "http.response.body", "body": b""})
                if message.get("more_body", False):
                    answering.cancel()  # a stream would go on for ever

        scope["method"] = "GET"
        with anyio.CancelScope() as answering:
            await self.app(scope, receive, send_head)
        scope["method"] = "HEAD"


class _TooLargeError(Exception):
    """More bytes came than are taken."""


class LimitBodies:
    """Answers 413 where a body is larger than `MOST_BYTES`, announced or not."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Count the bytes that come."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        if _announced_bytes(scope) > MOST_BYTES:
            await _too_large()(scope, receive, send)
            return
        if scope["method"] in _WITHOUT_BODY:
            await self.app(scope, receive, send)
            return
        came, has_started = 0, False

        async def receive_counted() -> Message:
            nonlocal came
            message = await receive()
            came += len(message.get("body", b""))
            if came > MOST_BYTES:
                raise _TooLargeError
            return message

        async def send_unless_too_large(message: Message) -> None:
            nonlocal has_started
            if came <= MOST_BYTES or has_started:  # else the app has its own word for the error
                has_started = True
                await send(message)

        with contextlib.suppress(_TooLargeError):
            await self.app(scope, receive_counted, send_unless_too_large)
        if came > MOST_BYTES and not has_started:
            await _too_large()(scope, receive, send)


def _announced_bytes(scope: Scope) -> int:
    announced = dict(scope["headers"]).get(b"content-length", b"0")
    return int(announced) if announced.isdigit() else 0


def _too_large() -> JSONResponse:
    text = f"a request has at most {MOST_BYTES} bytes; send less at once"
    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    return JSONResponse({"code": status.phrase, "description": text}, status_code=status)


class SecurityHeaders:
    """Adds the headers to every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on and put the headers on the answer."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self.app(scope, receive, with_headers)


class CompressText:
    """Compresses what is text; files asked for by range and pictures go out as they are."""

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
