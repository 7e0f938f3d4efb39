"""The server: the catalogue on the web. It reads the store and changes no product."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from importlib.metadata import version
from pathlib import Path

from fastapi import FastAPI
from starlette.datastructures import MutableHeaders
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from solmap.config.settings import Settings
from solmap.gis_server.errors import install_error_table
from solmap.gis_server.metrics import Measured, Metrics
from solmap.gis_server.ogc import features, landing, wmts
from solmap.gis_server.ogc import tiles as ogc_tiles
from solmap.gis_server.openapi import complete
from solmap.gis_server.routes import (
    account,
    analysis,
    downloads,
    driving,
    edits,
    events,
    images,
    layers,
    metrics,
    missions,
    models,
    network,
    pages,
    panoramas,
    projection,
    runs,
    scene,
    sight,
    stac,
    start,
    styles,
    ties,
    tiles,
    versions,
)
from solmap.gis_server.routes.shortcut import TileShortcut
from solmap.gis_server.services import open_services
from solmap.gis_server.small_bodies import SmallBodies
from solmap.products.store.backends import Elsewhere
from solmap.products.store.process import keep_logs, look_seldom

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


def create_app(
    store_root: Path,
    viewer_dist: Path | None = None,
    catalogue_url: str | None = None,
    elsewhere: Elsewhere | None = None,
    origins: Sequence[str] = (),
) -> FastAPI:
    """The server of the store at `store_root`.

    Args:
        store_root: Folder of products and catalogue; it may be filled while being served.
        viewer_dist: Folder of the built viewer; the one shipped by default.
        catalogue_url: Database of the catalogue; SQLite in the store's folder where there is none.
        elsewhere: Where products lie if not in the store's folder.
        origins: Other sites whose pages may ask this server.
    """
    services = open_services(store_root, catalogue_url, elsewhere)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        with ThreadPoolExecutor(1) as background:
            background.submit(services.ahead.read)
            yield
        services.tail.close()
        services.pool.close()
        services.catalogue.engine.dispose()

    app = FastAPI(
        title="solmap",
        version=version("solmap"),
        summary="Maps made from a Mars rover's stereo images",
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
    )
    app.state.services = services
    app.state.metrics = Metrics(services)
    install_error_table(app)
    for module in (
        start,
        missions,
        layers,
        versions,
        models,
        scene,
        analysis,
        sight,
        driving,
        ties,
        projection,
        network,
        styles,
        tiles,
        images,
        landing,
        downloads,
        stac,
        events,
        account,
        edits,
        runs,
        features,
        ogc_tiles,
        wmts,
        panoramas,
        metrics,
        pages,
    ):
        app.include_router(module.router)
    complete(app)
    pages.install_pages(app, viewer_dist or pages.SHIPPED_VIEWER)
    app.add_middleware(SmallBodies)
    app.add_middleware(CompressText)
    app.add_middleware(TileShortcut, services=services, metrics=app.state.metrics)
    if origins:
        app.add_middleware(
            CORSMiddleware,  # without cookies: there are none
            allow_origins=list(origins),
            allow_methods=["GET", "HEAD", "POST"],
            allow_headers=["Authorization", "Content-Type", "Range", "If-None-Match"],
            expose_headers=["ETag", "Content-Range", "Link", "OGC-NumberMatched"],
        )
    app.add_middleware(SecurityHeaders)
    app.add_middleware(Measured, metrics=app.state.metrics)
    return app


def create_app_from_settings() -> FastAPI:
    """The server of the store that the environment names (`SOLMAP_STORE`), as a process."""
    settings = Settings()
    keep_logs(settings.store, "server")
    look_seldom()
    return create_app(
        settings.store,
        catalogue_url=settings.catalogue_url,
        elsewhere=settings.elsewhere,
        origins=settings.cors_origins.split(),
    )
