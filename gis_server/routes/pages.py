"""Pages for people: the viewer, the description of the API, and whether the server is ready."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, FastAPI
from fastapi.responses import HTMLResponse, Response

from solmap.gis_server.services import ServicesOf
from solmap.gis_server.viewer_files import ViewerFiles

router = APIRouter()
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
<p><a href="/docs">The API</a> works without it.</p>""",
)
_DOCS = _FRAME.format(
    head='<link rel="stylesheet" href="/swagger/swagger-ui.css">',
    body='<div id="swagger-ui"></div><script src="/swagger/swagger-ui-bundle.js"></script>'
    '<script src="/docs/start.js"></script>',
)
_DOCS_START = (
    'SwaggerUIBundle({url: "/openapi.json", dom_id: "#swagger-ui", deepLinking: true, '
    "validatorUrl: null});\n"  # by default it asks a validator elsewhere
)


@router.get("/healthz", tags=["server"])
def healthz(services: ServicesOf) -> dict[str, str]:
    """Answers when the server is ready and the catalogue can be read."""
    services.catalogue.missions()
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
    head = '<h1>solmap API</h1><p>In full: <a href="/openapi.json">openapi.json</a></p>'
    return _FRAME.format(head="", body=f"{head}<dl>{rows}</dl>")
