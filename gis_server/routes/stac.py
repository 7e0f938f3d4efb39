"""The STAC catalogue of the store over HTTP, and the files that its assets point to.

Its links are relative. Served from here they lead from the catalogue to its items, and from an item
to its file, as they do on disk.
"""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import FileResponse, JSONResponse

from solmap.gis_server.routes.files import product_response
from solmap.gis_server.routes.layers import MEDIA_TYPES
from solmap.gis_server.routes.parameters import AGAIN, Digest, LayerPath, MissionName
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.errors import ProductNotFoundError
from solmap.products.model import SUFFIX
from solmap.products.reports.stac import FOLDER

router = APIRouter(tags=["stac"])
ItemName = Annotated[str, Path(pattern=r"^[a-z0-9][a-z0-9_.-]{0,191}$")]
Suffix = Annotated[str, Path(pattern=r"^[a-z0-9]{1,8}$")]


@router.get("/stac/catalog.json")
def catalogue(services: ServicesOf) -> JSONResponse:
    """The missions of the store as a STAC catalogue."""
    return _document("catalog.json", services, "application/json")


@router.get("/stac/{mission}/collection.json")
def collection(mission: MissionName, services: ServicesOf) -> JSONResponse:
    """The layers of a mission as a STAC collection."""
    return _document(f"{mission}/collection.json", services, "application/json")


@router.get("/stac/{mission}/{item}.json")
def item(mission: MissionName, item: ItemName, services: ServicesOf) -> JSONResponse:
    """A layer as a STAC item, with its files."""
    return _document(f"{mission}/{item}.json", services, "application/geo+json")


@router.get("/products/{kind}/{scope}/{digest}.provenance.json")
def provenance(layer: LayerPath, services: ServicesOf) -> dict[str, Any]:
    """How the file of a STAC item was made."""
    return services.store.provenance(layer.ref)


@router.head("/products/{kind}/{scope}/{digest}.{suffix}", include_in_schema=False)
@router.get("/products/{kind}/{scope}/{digest}.{suffix}", response_class=FileResponse)
def file(
    layer: LayerPath, digest: Digest, suffix: Suffix, services: ServicesOf, request: Request
) -> Response:
    """The file of a STAC item, whole or by ranges."""
    wanted = SUFFIX[layer.ref.kind]
    if suffix != wanted.removeprefix("."):
        raise ProductNotFoundError(f"{layer.id} is a {wanted}: {digest}{wanted}")
    media_type = MEDIA_TYPES.get(wanted, "application/octet-stream")
    return product_response(layer.ref, services.store, request, media_type)


def _document(name: str, services: Services, media_type: str) -> JSONResponse:
    body = services.store.document(f"{FOLDER}/{name}")
    if body is None:
        raise ProductNotFoundError(f"the STAC catalogue has no {name}; publishing writes it")
    return JSONResponse(json.loads(body), headers=AGAIN, media_type=media_type)
