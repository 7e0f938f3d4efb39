"""Status and body of the response for each error.

Every refusal is a problem document of RFC 9457 (`application/problem+json`): `type`, `title`,
`status`, `detail` and `instance`, and a remedy as `hint`. `code` and `description` repeat title and
detail under the names of OGC API; `errors` lists the wrong parts of a request.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

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
LACKED_MEMORY = "solmap.lacked_memory"
"""Key in the scope of a request that lacked memory."""
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
    HTTPStatus.UNAUTHORIZED: "reading needs no token; `solmap token add` makes one for writing",
    HTTPStatus.FORBIDDEN: "reading needs no token; `solmap token add` makes one for writing",
    HTTPStatus.CONFLICT: "read the present state, and try again",
    HTTPStatus.TOO_MANY_REQUESTS: "wait for the time in Retry-After",
    HTTPStatus.SERVICE_UNAVAILABLE: "try again a little later",
    HTTPStatus.BAD_REQUEST: "/docs describes all requests",
    HTTPStatus.NOT_FOUND: "GET /api/missions lists published layers, /docs all requests",
    HTTPStatus.INSUFFICIENT_STORAGE: "free some space on the disk of the store",
    HTTPStatus.UNPROCESSABLE_ENTITY: "correct the request as stated; /docs describes it",
    HTTPStatus.INTERNAL_SERVER_ERROR: "make the product again; its provenance names the recipe",
}

PROBLEM = "application/problem+json"
_NAMED = 5
"""Most faults of a request in the detail; `errors` has all of them."""


def install_error_table(app: FastAPI) -> None:
    """Answer every error of the table with a problem document."""
    for kind in (*STATUS, HTTPException):
        app.add_exception_handler(kind, _answer)
    app.add_exception_handler(RequestValidationError, _answer_invalid)
    app.add_exception_handler(HTTPStatus.METHOD_NOT_ALLOWED, _name_methods)
    app.add_exception_handler(Exception, _fail)


def problem(
    status: HTTPStatus,
    what: str,
    where: str,
    headers: Mapping[str, str] | None = None,
    **more: Any,  # noqa: ANN401 - members of JSON
) -> JSONResponse:
    """An error response: the fault, its address, the remedy, and further members."""
    hint = {"hint": HINT[status]} if status in HINT else {}
    return JSONResponse(
        {
            "type": "about:blank",
            "title": status.phrase,
            "status": int(status),
            "detail": what,
            "instance": where,
            "code": status.phrase,
            "description": what,
            **hint,
            **more,
        },
        status_code=status,
        headers={**(headers or {}), "Cache-Control": "no-store"},
        media_type=PROBLEM,
    )


async def _answer(request: Request, error: Exception) -> JSONResponse:
    if isinstance(error, HTTPException):
        status, what = HTTPStatus(error.status_code), str(error.detail)
    else:
        status = next(STATUS[kind] for kind in type(error).mro() if kind in STATUS)
        what = str(error)
    if isinstance(error, MemoryError):
        request.scope[LACKED_MEMORY] = True
        what = f"this takes more memory than a request may have: {what or 'request less'}"
    return problem(status, what, request.url.path, _headers(error))


async def _name_methods(request: Request, _error: Exception) -> JSONResponse:
    """Refuse a method, naming those of all routes of the URL: a file server names only its own."""
    described = request.app.openapi()["paths"].items()
    requested = request.url.path.removeprefix(request.scope.get("root_path", ""))
    fitting = [ways for path, ways in described if compile_path(path)[0].match(requested)]
    methods = sorted({way.upper() for ways in fitting for way in ways}) or ["GET", "HEAD"]
    status = HTTPStatus.METHOD_NOT_ALLOWED
    what = f"{request.method} is not among the methods of this address: {', '.join(methods)}"
    allow = {"Allow": ", ".join(methods)}
    return problem(status, what, request.url.path, allow, hint=HINT[HTTPStatus.BAD_REQUEST])


async def _fail(request: Request, error: Exception) -> JSONResponse:
    """An unexpected error: it is logged completely, and the response has no internal details."""
    status = HTTPStatus.INTERNAL_SERVER_ERROR
    what = "the server failed; the error is in its log"
    log.error("%s %s failed", request.method, request.url.path, exc_info=error)
    return problem(status, what, request.url.path, hint="report it to the operator of the server")


async def _answer_invalid(request: Request, error: Exception) -> JSONResponse:
    """Errors of a request body without its values, which may not be valid JSON (NaN)."""
    found = error.errors() if isinstance(error, RequestValidationError) else []
    errors = [{name: row[name] for name in ("type", "loc", "msg")} for row in found]
    what = "; ".join(f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in errors[:_NAMED])
    status = HTTPStatus.UNPROCESSABLE_ENTITY
    return problem(status, what or "the question is wrong", request.url.path, errors=errors)


def _headers(error: Exception) -> Mapping[str, str]:
    """Headers of an error's response."""
    return (error.headers or {}) if isinstance(error, HTTPException) else {}
