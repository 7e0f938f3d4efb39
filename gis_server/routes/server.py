"""The server itself: the viewer's files, pages for people, health and metrics.

The viewer's files were compressed by its build; those whose names carry a digest of their content
are cached forever.
"""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath

from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.datastructures import Headers
from starlette.types import Scope

from solmap.gis_server.services import ServicesOf

_ENCODINGS = {"br": ".br", "gzip": ".gz"}
"""Encodings, best first, with the suffix of the compressed file."""
_FOREVER = "public, max-age=31536000, immutable"
_PINNED = "assets"
"""Folder of files whose names carry a digest of their content."""
router, health = APIRouter(), APIRouter()
SHIPPED_VIEWER = Path(__file__).parents[1] / "viewer" / "dist"
_SWAGGER = ("swagger/swagger-ui-bundle.js", "swagger/swagger-ui.css")
_FRAME = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>solmap</title>
<link rel="icon" href="data:,">{head}</head>
<body>{body}</body></html>
"""
_UNBUILT = _FRAME.format(
    head="",
    body="""<h1>solmap</h1><p>The server runs, but the viewer has not been built. Run
<code>make viewer</code> (or <code>npm ci &amp;&amp; npm run build</code> in
<code>gis_server/viewer</code>) and reload.</p>
<p><a href="docs">The API</a> works without it.</p>""",
)
_DOCS = _FRAME.format(
    head='<link rel="stylesheet" href="swagger/swagger-ui.css">',
    body='<div id="swagger-ui"></div><script src="swagger/swagger-ui-bundle.js"></script>'
    '<script src="docs/start.js"></script>',
)
_DOCS_START = (
    'SwaggerUIBundle({url: "openapi.json", dom_id: "#swagger-ui", deepLinking: true, '
    "validatorUrl: null});\n"  # by default it uses an external validator
)


class ViewerFiles(StaticFiles):
    """Static files with compressed copies made by the build."""

    def file_response(
        self,
        full_path: str | os.PathLike[str],
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        """The file, compressed as the browser accepts it."""
        accepted = _accepted_encodings(Headers(scope=scope).get("accept-encoding", ""))
        plain, used = os.fspath(full_path), None
        for encoding, suffix in _ENCODINGS.items():
            if encoding in accepted and os.path.isfile(plain + suffix):  # noqa: PTH113 - cheapest
                full_path, used = plain + suffix, encoding
                stat_result = os.stat(full_path)  # noqa: PTH116 - as the parent class passes it
                break
        # Its type follows from its name: that of a file `name.js.br` is that of `name.js`.
        answer = super().file_response(full_path, stat_result, scope, status_code)
        if used:
            answer.headers["content-encoding"] = used
        answer.headers["vary"] = "Accept-Encoding"
        is_pinned = _PINNED in PurePosixPath(scope["path"]).parts
        answer.headers["cache-control"] = _FOREVER if is_pinned else "no-cache"
        return answer


def _accepted_encodings(header: str) -> set[str]:
    """Names of encodings in an Accept-Encoding header, without those of weight 0."""
    parts = (part.replace(" ", "").lower().partition(";") for part in header.split(","))
    return {name for name, _, weight in parts if weight not in {"q=0", "q=0.0"}}


@router.get("/metrics", tags=["server"], response_class=Response)
def metrics(request: Request) -> Response:
    """Metrics of requests, times, caches, publications and runs."""
    body = request.app.state.metrics.text()
    return Response(body, media_type=CONTENT_TYPE_LATEST, headers={"Cache-Control": "no-store"})


@health.get("/healthz", tags=["server"])
async def healthz(services: ServicesOf) -> dict[str, str]:
    """Answers when the server is ready and the catalogue can be read."""
    await services.health.check()
    return {"status": "ok"}


def install_pages(app: FastAPI, viewer_dist: Path) -> None:
    """Add /docs and, after all other routes, the viewer's files at /."""
    app.add_api_route("/docs/start.js", _docs_start, include_in_schema=False)
    has_swagger = all((viewer_dist / name).is_file() for name in _SWAGGER)
    app.add_api_route(
        "/docs",
        lambda: HTMLResponse(_DOCS if has_swagger else _plain_docs(app)),
        include_in_schema=False,
    )
    if (viewer_dist / "index.html").is_file():
        app.mount("/", ViewerFiles(directory=viewer_dist, html=True), name="viewer")
    else:
        app.add_api_route("/", lambda: HTMLResponse(_UNBUILT), include_in_schema=False)


def _docs_start() -> Response:
    return Response(_DOCS_START, media_type="text/javascript")


def _plain_docs(app: FastAPI) -> str:
    """The operations as a list, for installations without the built viewer."""
    rows = "".join(
        f"<dt><code>{method.upper()} {path}</code></dt><dd>{operation['description']}</dd>"
        for path, operations in app.openapi()["paths"].items()
        for method, operation in operations.items()
    )
    head = '<h1>solmap API</h1><p>In full: <a href="openapi.json">openapi.json</a></p>'
    return _FRAME.format(head="", body=f"{head}<dl>{rows}</dl>")
