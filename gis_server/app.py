"""The server application. It reads the store and changes no product."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from anyio import to_thread
from fastapi import Depends, FastAPI
from starlette.middleware.cors import CORSMiddleware

from solmap.config.settings import Settings
from solmap.gis_server.budgets import FILES, QUESTIONS, Budgets, HeavyRequests
from solmap.gis_server.collaboration import accounts, edits, engine, runs
from solmap.gis_server.errors import install_error_table
from solmap.gis_server.launcher import Launcher
from solmap.gis_server.metrics import MeasureRequests, Metrics
from solmap.gis_server.middleware import (
    AnswerHead,
    CompressText,
    LimitBodies,
    PublicAddress,
    ReadableRanges,
    SecurityHeaders,
    restore_head,
)
from solmap.gis_server.ogc import features, landing, wmts
from solmap.gis_server.ogc import tiles as ogc_tiles
from solmap.gis_server.openapi import complete
from solmap.gis_server.routes import (
    analysis,
    downloads,
    events,
    images,
    layers,
    missions,
    models,
    network,
    panoramas,
    projection,
    server,
    tiles,
)
from solmap.gis_server.services import open_services
from solmap.gis_server.workers import Worker, limit_arenas
from solmap.products.store.backends import ObjectStorage
from solmap.products.store.garbage import collect_garbage_rarely, exempt_objects_from_collection
from solmap.products.store.process import log_to_store

_THREADS = 8
"""Threads for light requests: with more, they and the event loop would wait for each other."""
_SWITCH_S = 0.0005
"""Time after which a waiting thread gets Python's lock. With Python's default of 5 ms the event
loop, which releases the lock at every read and write, waited 0.2 s for eight threads."""


def create_app(  # noqa: PLR0913, PLR0917 - all that differs from one server to the next
    store_root: Path,
    viewer_dist: Path | None = None,
    catalogue_url: str | None = None,
    object_storage: ObjectStorage | None = None,
    origins: Sequence[str] = (),
    public_url: str | None = None,
    worker_memory_mb: int | None = None,
) -> FastAPI:
    """The server of the store at `store_root`.

    Args:
        store_root: Folder of products and catalogue; it may be filled while being served.
        viewer_dist: Folder of the built viewer; the one shipped by default.
        catalogue_url: Database of the catalogue; SQLite in the store's folder where there is
            none.
        object_storage: Where products are if not in the store's folder.
        origins: Other sites whose pages may use this server.
        public_url: Address at which a reverse proxy serves the map; default: that of each request.
        worker_memory_mb: Memory that a worker may use for one heavy request; None: no workers.
    """
    services = open_services(store_root, catalogue_url, object_storage)
    workers = {}
    if worker_memory_mb is not None:
        given = (store_root, viewer_dist, catalogue_url, object_storage, (), public_url)
        launcher = Launcher()
        workers = {lane: Worker(given, worker_memory_mb, launcher) for lane in (QUESTIONS, FILES)}
    budgets = Budgets(workers)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        to_thread.current_default_thread_limiter().total_tokens = _THREADS
        sys.setswitchinterval(_SWITCH_S)
        with budgets.running_workers(), ThreadPoolExecutor(1) as background:
            if workers:
                _app.openapi()  # FastAPI builds its routes here, which would stop the event loop
                await _answer_once(_app)
                exempt_objects_from_collection()
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
        dependencies=[Depends(restore_head)],
    )
    app.state.services = services
    app.state.metrics = Metrics(services, budgets)
    install_error_table(app)
    app.include_router(server.health)
    for module in (
        tiles,  # the most frequent requests first: routes are tried in this order
        missions,
        layers,
        models,
        analysis,
        projection,
        network,
        images,
        landing,
        downloads,
        events,
        accounts,
        edits,
        runs,
        engine,
        features,
        ogc_tiles,
        wmts,
        panoramas,
        server,
    ):
        app.include_router(module.router)
    app.include_router(features.of_all)
    complete(app)
    server.install_pages(app, viewer_dist or server.SHIPPED_VIEWER)
    app.add_middleware(HeavyRequests, budgets=budgets)
    app.add_middleware(LimitBodies)
    app.add_middleware(ReadableRanges)
    app.add_middleware(CompressText)
    if origins:
        app.add_middleware(
            CORSMiddleware,  # without cookies: there are none
            allow_origins=list(origins),
            allow_methods=["GET", "HEAD", "POST"],
            allow_headers=["Authorization", "Content-Type", "Range", "If-None-Match"],
            expose_headers=["ETag", "Content-Range", "Link", "OGC-NumberMatched"],
        )
    app.add_middleware(AnswerHead)
    app.add_middleware(SecurityHeaders)
    app.add_middleware(MeasureRequests, metrics=app.state.metrics)
    if public_url:
        app.add_middleware(PublicAddress, url=public_url)
    return app


async def _answer_once(app: FastAPI) -> None:
    """Answer the viewer's first request before clients are: it prepares what all answers need."""
    path = "/api/start"
    scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": "GET",
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "query_string": b"",
        "headers": [(b"host", b"localhost")],
        "client": None,
        "server": None,
    }

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(_: Any) -> None:  # noqa: ANN401 - a message of ASGI
        pass

    with suppress(Exception):  # what fails here fails for the first client too
        await app(scope, receive, send)


def create_app_from_settings() -> FastAPI:
    """The server of the store that the environment names (`SOLMAP_STORE`), as a process."""
    settings = Settings()
    log_to_store(settings.store, "server")
    collect_garbage_rarely()
    limit_arenas()
    return create_app(
        settings.store,
        catalogue_url=settings.catalogue_url,
        object_storage=settings.object_storage,
        origins=settings.cors_origins.split(),
        public_url=settings.public_url,
        worker_memory_mb=settings.server_memory_mb // 3,
    )
