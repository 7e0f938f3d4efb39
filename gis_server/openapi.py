"""The description of the API at /openapi.json, with additions to those of the routes.

These are possible errors, formats of responses other than JSON, and parameters of paths that are
parsed by code. Tests compare the server with it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI

from solmap.gis_server.budgets import kind_of
from solmap.gis_server.errors import PROBLEM

JSON, HTML, GEOJSON, PNG = "application/json", "text/html", "application/geo+json", "image/png"
WEBP = "image/webp"
_FILES = (
    "image/tiff",
    GEOJSON,
    "application/geopackage+sqlite3",
    "model/gltf-binary",
    "application/vnd.maxar.archive.3tz+zip",
    "application/octet-stream",
)
FORMS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"\.png$|/map/tiles/\{tms\}/\{zoom\}/\{row\}/\{column\}$", (PNG,)),
    (r"\.webp$", (WEBP,)),
    (r"\.values$", ("application/vnd.solmap.values",)),
    (r"^/api/.*\.geojson$", (GEOJSON,)),
    (r"^/download/.*\.gpkg$", ("application/geopackage+sqlite3",)),
    (r"^/stac/\{mission\}/\{item\}\.json$", (GEOJSON,)),
    (r"^/download/|^/products/.*\{suffix\}$|/original$", _FILES),
    (r"\.stl$", ("model/stl",)),
    (r"^/models/", (JSON, "model/gltf-binary")),
    (r"\.csv$", ("text/csv",)),
    (r"\.tif$", ("image/tiff",)),
    (r"^/api/.*(\.html|/report)$", (HTML,)),
    (r"^/metrics$", ("text/plain",)),
    (r"WMTSCapabilities\.xml$", ("application/xml",)),
    (r"/wmts$", ("application/xml", PNG)),
    (r"/items(/\{feature\})?$", (GEOJSON, HTML, "application/flatgeobuf", "text/csv")),
    (r"/queryables$", ("application/schema+json",)),
    (r"/crs/\{name\}$", (JSON, "text/plain", HTML)),
    (
        r"^/ogc(/\{mission\})?(/conformance|/maps|/collections(/(\{mission\}:)?\{collection\})?)?$",
        (JSON, HTML),
    ),
)
"""Media types of the responses at addresses: the first that fits, else that of the route."""

_PROBLEM_SCHEMA = {
    "title": "Problem",
    "description": "A problem document of RFC 9457",
    "type": "object",
    "required": ["type", "title", "status", "detail", "instance", "code", "description"],
    "properties": {
        "type": {"type": "string", "description": "about:blank: the status describes it"},
        "title": {"type": "string", "description": "the status in words"},
        "status": {"type": "integer"},
        "detail": {"type": "string", "description": "what is wrong"},
        "instance": {"type": "string", "description": "the path of the request"},
        "hint": {"type": "string", "description": "what to try"},
        "code": {"type": "string", "description": "the title, as OGC API names it"},
        "description": {"type": "string", "description": "the detail, as OGC API names it"},
        "errors": {
            "type": "array",
            "description": "each part of the question that is wrong",
            "items": {
                "type": "object",
                "required": ["type", "loc", "msg"],
                "properties": {
                    "type": {"type": "string"},
                    "loc": {"type": "array", "items": {"type": ["string", "integer"]}},
                    "msg": {"type": "string"},
                },
            },
        },
    },
}


def complete(app: FastAPI) -> None:
    """Replace the app's description by a complete one, by FastAPI's documented hook."""
    write = app.openapi

    def describe() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _complete_document(write())
        return app.openapi_schema

    app.openapi = describe  # type: ignore[method-assign]


def _complete_document(document: dict[str, Any]) -> dict[str, Any]:
    schemas = document["components"]["schemas"]
    schemas["Problem"] = _PROBLEM_SCHEMA
    for name in ("HTTPValidationError", "ValidationError"):  # of FastAPI's own answers
        schemas.pop(name, None)
    for path, operations in document["paths"].items():
        for operation in operations.values():
            operation.setdefault("parameters", []).extend(_undeclared_parameters(path, operation))
            operation["summary"] = _first_sentence(operation["description"])
            _put_forms(path, operation)
            for status in _error_statuses(path, operation):
                operation["responses"][str(int(status))] = _error_response(status)
            if path.endswith("/wmts"):  # which has its own exception reports
                operation["responses"]["400"]["content"]["application/xml"] = {}
    return document


def _first_sentence(description: str) -> str:
    """Summary of an operation in one line: FastAPI would use the name of its function."""
    paragraph = " ".join(description.split("\n\n", maxsplit=1)[0].split())
    return re.split(r"(?<=[.;]) ", paragraph)[0].rstrip(".;")


def _undeclared_parameters(path: str, operation: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Parameters in the path that no dependency declares."""
    described = {one["name"] for one in operation.get("parameters", ()) if one["in"] == "path"}
    for name in re.findall(r"\{(\w+)\}", path):
        if name not in described:
            text = {"type": "string", "maxLength": 128}
            yield {"name": name, "in": "path", "required": True, "schema": text}


def _put_forms(path: str, operation: dict[str, Any]) -> None:
    forms = next((forms for pattern, forms in FORMS if re.search(pattern, path)), None)
    answer = operation["responses"].get("200")
    if forms is None or answer is None:
        return
    schema = answer.get("content", {}).get(JSON, {}).get("schema", {})
    answer["content"] = {form: {"schema": schema} if "json" in form else {} for form in forms}
    if forms[0] in {PNG, WEBP} or ".values" in path:
        operation["responses"]["304"] = {"description": "The client has it already"}
    if forms[0] == WEBP or ".values" in path:
        operation["responses"]["204"] = {"description": "Nothing was measured there"}
    if forms == _FILES:
        operation["responses"]["206"] = {"description": "The requested range"}
        status = HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE
        operation["responses"]["416"] = _error_response(status)


def _error_statuses(path: str, operation: dict[str, Any]) -> Iterator[HTTPStatus]:
    if operation["parameters"]:
        yield HTTPStatus.BAD_REQUEST
        yield HTTPStatus.UNPROCESSABLE_ENTITY
    if "{" in path or operation.get("requestBody") or path.startswith("/stac/"):
        yield HTTPStatus.NOT_FOUND
    if operation.get("requestBody"):
        yield from (HTTPStatus.BAD_REQUEST, HTTPStatus.UNPROCESSABLE_ENTITY)
        yield HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    if operation.get("requestBody") or (operation.get("security") and "{" in path):
        yield HTTPStatus.CONFLICT
    if kind_of(path) or path == "/api/events":
        yield HTTPStatus.TOO_MANY_REQUESTS
    if operation.get("requestBody"):
        yield HTTPStatus.REQUEST_TIMEOUT
    if operation.get("security"):
        yield from (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.TOO_MANY_REQUESTS)
    yield HTTPStatus.SERVICE_UNAVAILABLE


def _error_response(status: HTTPStatus) -> dict[str, Any]:
    schema = {"$ref": "#/components/schemas/Problem"}
    return {"description": status.phrase, "content": {PROBLEM: {"schema": schema}}}
