"""Bodies of requests are small; whoever sends more is stopped before it fills the memory."""

from __future__ import annotations

import contextlib
from http import HTTPStatus

from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_BYTES = 1 << 20


class _TooLargeError(Exception):
    """More bytes came than are taken."""


class SmallBodies:
    """Answers 413 where a body is larger than `MOST_BYTES`, announced or not."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Count the bytes that come."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        if _announced(scope) > MOST_BYTES:
            await _refusal()(scope, receive, send)
            return
        came, has_started = 0, False

        async def counted() -> Message:
            nonlocal came
            message = await receive()
            came += len(message.get("body", b""))
            if came > MOST_BYTES:
                raise _TooLargeError
            return message

        async def noted(message: Message) -> None:
            nonlocal has_started
            if came <= MOST_BYTES or has_started:  # else the app has its own word for the error
                has_started = True
                await send(message)

        with contextlib.suppress(_TooLargeError):
            await self.app(scope, counted, noted)
        if came > MOST_BYTES and not has_started:
            await _refusal()(scope, receive, send)


def _announced(scope: Scope) -> int:
    told = dict(scope["headers"]).get(b"content-length", b"0")
    return int(told) if told.isdigit() else 0


def _refusal() -> JSONResponse:
    said = f"a request has at most {MOST_BYTES} bytes; send less at once"
    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    return JSONResponse({"code": status.phrase, "description": said}, status_code=status)
