"""What is done with every request and answer: security headers, compression, a limit of bodies."""

from __future__ import annotations

import contextlib
from http import HTTPStatus

from starlette.datastructures import MutableHeaders
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

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
        path = scope.get("path", "")
        raw = path.startswith(_PACKED)
        await (self.plain if raw else self.compressing)(scope, receive, send)
