"""The STAC catalogue of the store over HTTP, and the files that its assets point to.

Its links are relative. Served from here they lead from the catalogue to its items, and from an item
to its file, as they do on disk.
"""

from __future__ import annotations

import json
from pathlib import Path as FilePath
from typing import Annotated, Any

from fastapi import APIRouter, Path
from fastapi.responses import FileResponse, JSONResponse

from gis_server.routes.layers import MEDIA_TYPES
from gis_server.routes.parameters import AGAIN, FOREVER, Digest, LayerPath, MissionName
from gis_server.services import ServicesOf
from products.errors import ProductNotFoundError
from products.model import SUFFIX
from products.stac import FOLDER

router = APIRouter(tags=["stac"])
ItemName = Annotated[str, Path(pattern=r"^[a-z0-9][a-z0-9_.-]{0,191}$")]
Suffix = Annotated[str, Path(pattern=r"^[a-z0-9]{1,8}$")]


@router.get("/stac/catalog.json")
def catalogue(services: ServicesOf) -> JSONResponse:
    """The missions of the store as a STAC catalogue."""
    return _document(services.store.root / FOLDER / "catalog.json", "application/json")


@router.get("/stac/{mission}/collection.json")
def collection(mission: MissionName, services: ServicesOf) -> JSONResponse:
    """The layers of a mission as a STAC collection."""
    path = services.store.root / FOLDER / mission / "collection.json"
    return _document(path, "application/json")


@router.get("/stac/{mission}/{item}.json")
def item(mission: MissionName, item: ItemName, services: ServicesOf) -> JSONResponse:
    """A layer as a STAC item, with its files."""
    path = services.store.root / FOLDER / mission / f"{item}.json"
    return _document(path, "application/geo+json")


@router.get("/products/{kind}/{scope}/{digest}.provenance.json")
def provenance(layer: LayerPath, services: ServicesOf) -> dict[str, Any]:
    """How the file of a STAC item was made."""
    return services.store.provenance(layer.ref)


@router.head("/products/{kind}/{scope}/{digest}.{suffix}", include_in_schema=False)
@router.get("/products/{kind}/{scope}/{digest}.{suffix}", response_class=FileResponse)
def file(layer: LayerPath, digest: Digest, suffix: Suffix, services: ServicesOf) -> FileResponse:
    """The file of a STAC item, whole or by ranges."""
    wanted = SUFFIX[layer.ref.kind]
    if suffix != wanted.removeprefix("."):
        raise ProductNotFoundError(f"{layer.id} is a {wanted}: {digest}{wanted}")
    media_type = MEDIA_TYPES.get(wanted, "application/octet-stream")
    return FileResponse(services.store.path(layer.ref), media_type=media_type, headers=FOREVER)


def _document(path: FilePath, media_type: str) -> JSONResponse:
    try:
        body = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ProductNotFoundError(
            f"the STAC catalogue has no {path.parent.name}/{path.name}; publishing writes it"
        ) from error
    return JSONResponse(body, headers=AGAIN, media_type=media_type)
