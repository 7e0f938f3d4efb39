"""Which error becomes which status, and the body that goes with it."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Mapping
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.routing import compile_path

from solmap.gis_server.analysis.bodies import UnanswerableError
from solmap.gis_server.rendering.styles import UnknownStyleError
from solmap.photogrammetry.errors import AdjustmentError, CameraError, MatchingError, TerrainError
from solmap.products.errors import (
    OutsideCoverageError,
    ProductError,
    ProductNotFoundError,
    StoreAwayError,
    StoreFullError,
    StoreReadOnlyError,
)

log = logging.getLogger(__name__)
STATUS: dict[type[Exception], HTTPStatus] = {
    ProductNotFoundError: HTTPStatus.NOT_FOUND,
    OutsideCoverageError: HTTPStatus.NOT_FOUND,
    StoreFullError: HTTPStatus.INSUFFICIENT_STORAGE,
    StoreReadOnlyError: HTTPStatus.FORBIDDEN,
    StoreAwayError: HTTPStatus.SERVICE_UNAVAILABLE,
    UnknownStyleError: HTTPStatus.UNPROCESSABLE_ENTITY,
    ProductError: HTTPStatus.INTERNAL_SERVER_ERROR,
    UnanswerableError: HTTPStatus.UNPROCESSABLE_ENTITY,
    TerrainError: HTTPStatus.UNPROCESSABLE_ENTITY,
    CameraError: HTTPStatus.UNPROCESSABLE_ENTITY,
    MatchingError: HTTPStatus.UNPROCESSABLE_ENTITY,
    AdjustmentError: HTTPStatus.UNPROCESSABLE_ENTITY,
    OverflowError: HTTPStatus.UNPROCESSABLE_ENTITY,
    MemoryError: HTTPStatus.UNPROCESSABLE_ENTITY,
}
HINT = {
    HTTPStatus.UNAUTHORIZED: "reading takes no token; `solmap token add` makes one for writing",
    HTTPStatus.FORBIDDEN: "reading takes no token; `solmap token add` makes one for writing",
    HTTPStatus.CONFLICT: "read what is there now, and ask again",
    HTTPStatus.TOO_MANY_REQUESTS: "wait as long as Retry-After says",
    HTTPStatus.SERVICE_UNAVAILABLE: "try again a little later",
    HTTPStatus.BAD_REQUEST: "/docs says what can be asked, and how",
    HTTPStatus.NOT_FOUND: "GET /api/missions lists what is published, /docs what can be asked",
    HTTPStatus.INSUFFICIENT_STORAGE: "free some space on the disk of the store",
    HTTPStatus.UNPROCESSABLE_ENTITY: "ask anew as the sentence says; /docs describes the question",
    HTTPStatus.INTERNAL_SERVER_ERROR: "make the product again; its provenance names the recipe",
}

_CLIENT_ERRORS = (
    HTTPStatus.BAD_REQUEST,
    HTTPStatus.UNAUTHORIZED,
    HTTPStatus.FORBIDDEN,
    HTTPStatus.NOT_FOUND,
    HTTPStatus.CONFLICT,
    HTTPStatus.UNPROCESSABLE_ENTITY,
    HTTPStatus.TOO_MANY_REQUESTS,
    HTTPStatus.SERVICE_UNAVAILABLE,
)
"""What endpoints answer by themselves."""


def install_error_table(app: FastAPI) -> None:
    """Have every error of the table answered as `detail`: what, where and what to try."""
    for kind, status in STATUS.items():
        app.add_exception_handler(kind, _answer(status))
    for status in _CLIENT_ERRORS:
        app.add_exception_handler(status, _answer(status))
    app.add_exception_handler(RequestValidationError, _answer_invalid)
    app.add_exception_handler(HTTPStatus.METHOD_NOT_ALLOWED, _name_methods)
    app.add_exception_handler(Exception, _fail)


def problem(
    status: HTTPStatus, what: str, where: str, headers: Mapping[str, str] | None = None
) -> JSONResponse:
    """A refusal: what is wrong, where, and what to try."""
    detail = {"what": what, "where": where, "what to try": HINT[status]}
    return JSONResponse(
        {"code": status.phrase, "description": what, "detail": detail},
        status_code=status,
        headers={**(headers or {}), "Cache-Control": "no-store"},
    )


def _answer(status: HTTPStatus) -> Callable[[Request, Exception], Awaitable[JSONResponse]]:
    async def answer(request: Request, error: Exception) -> JSONResponse:
        what = error.detail if isinstance(error, HTTPException) else str(error)
        if isinstance(error, MemoryError):
            what = f"this takes more memory than a request may have: {what or 'ask for less'}"
        return problem(status, what, request.url.path, _headers(error))

    return answer


async def _name_methods(request: Request, _error: Exception) -> JSONResponse:
    """Which methods an address has, of all its routes: a file server would answer with its own."""
    described = request.app.openapi()["paths"].items()
    asked = request.url.path.removeprefix(request.scope.get("root_path", ""))
    fitting = [ways for path, ways in described if compile_path(path)[0].match(asked)]
    methods = sorted({way.upper() for ways in fitting for way in ways}) or ["GET", "HEAD"]
    status = HTTPStatus.METHOD_NOT_ALLOWED
    what = f"{request.method} is not among the methods of this address: {', '.join(methods)}"
    detail = {"what": what, "where": request.url.path, "what to try": HINT[HTTPStatus.BAD_REQUEST]}
    body = {"code": status.phrase, "description": what, "detail": detail}
    return JSONResponse(body, status_code=status, headers={"Allow": ", ".join(methods)})


async def _fail(request: Request, error: Exception) -> JSONResponse:
    """What nobody thought of: the log has it whole, and who asks learns no inside of the server."""
    status = HTTPStatus.INTERNAL_SERVER_ERROR
    what = "the server failed; its log says how"
    log.error("%s %s failed", request.method, request.url.path, exc_info=error)
    detail = {"what": what, "where": request.url.path, "what to try": "tell who runs the server"}
    body = {"code": status.phrase, "description": what, "detail": detail}
    return JSONResponse(body, status_code=status, headers={"Cache-Control": "no-store"})


async def _answer_invalid(_request: Request, error: Exception) -> JSONResponse:
    """What is wrong with a question, without what was sent: that may be no JSON, such as NaN."""
    found = error.errors() if isinstance(error, RequestValidationError) else []
    detail = [{name: row[name] for name in ("type", "loc", "msg")} for row in found]
    return JSONResponse(
        {"detail": detail},
        status_code=HTTPStatus.UNPROCESSABLE_ENTITY,
        headers={"Cache-Control": "no-store"},
    )


def _headers(error: Exception) -> Mapping[str, str]:
    """What an error wants said in the head of its answer."""
    return (error.headers or {}) if isinstance(error, HTTPException) else {}
