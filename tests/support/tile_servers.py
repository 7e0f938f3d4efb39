"""Servers of tiles that are compared: ours, TiTiler, and files drawn before by Starlette.

python -m tests.support.tile_servers ours|titiler|files ROOT PORT
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.support import live_server
from tests.support.live_server import Server

ROOT = Path(__file__).parents[2]


@contextlib.contextmanager
def running(name: str, root: Path) -> Iterator[Server]:
    """One of the servers as a process of its own, of one worker."""
    command = [sys.executable, "-m", "tests.support.tile_servers", name, str(root)]
    with live_server.running(command, {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}) as server:
        yield server


def _ours(root: Path) -> Any:
    from solmap.gis_server.app import create_app  # noqa: PLC0415

    return create_app(root)


def _files(root: Path) -> Any:
    from fastapi.staticfiles import StaticFiles  # noqa: PLC0415
    from starlette.applications import Starlette  # noqa: PLC0415
    from starlette.responses import PlainTextResponse  # noqa: PLC0415
    from starlette.routing import Mount, Route  # noqa: PLC0415

    ready = Route("/healthz", lambda _request: PlainTextResponse("ok"))
    return Starlette(routes=[ready, Mount("/", StaticFiles(directory=root / "drawn"))])


def _titiler(root: Path) -> Any:
    from fastapi import FastAPI  # noqa: PLC0415
    from morecantile.defaults import TileMatrixSets  # noqa: PLC0415
    from titiler.core import factory  # noqa: PLC0415

    from solmap.products.catalogue.catalogue import Catalogue  # noqa: PLC0415
    from solmap.products.formats.raster.tiling import tile_matrix_set  # noqa: PLC0415

    (mission,) = Catalogue.open(root).missions()
    sets = TileMatrixSets({"local": tile_matrix_set(mission.landing)})
    app = FastAPI()
    app.add_api_route("/healthz", lambda: "ok")
    # For a header it looks for the CRS in all lists of authorities, at every tile and in vain: a
    # tenth of a second that would hide what its tiles cost.
    factory.CRS_to_uri = lambda _crs: None
    app.include_router(factory.TilerFactory(supported_tms=sets).router)
    return app


if __name__ == "__main__":
    import uvicorn

    made = {"ours": _ours, "titiler": _titiler, "files": _files}[sys.argv[1]]
    uvicorn.run(made(Path(sys.argv[2])), port=int(sys.argv[3]), log_level="error")
