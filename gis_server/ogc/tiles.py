"""OGC API Tiles: the rasters of a mission as tiles of maps.

Here and in WMTS layers are named without a digest, and are the latest version. The addresses of
`/tiles/...` contain a digest and are cached forever; these are revalidated each time, with 304
while the layer is the same.
"""

from __future__ import annotations

import hashlib
from http import HTTPStatus
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Header, Path, Query, Request, Response
from fastapi.responses import JSONResponse

from solmap.gis_server.ogc.documents import JSON, Link, link
from solmap.gis_server.ogc.tilesets import (
    TILING_SCHEMES,
    collection_document,
    collection_id,
    styles_document,
    tileset_document,
    tilesets_document,
    tms_document,
    tms_id,
)
from solmap.gis_server.parameters import REVALIDATE, BaseOf, MissionName
from solmap.gis_server.rendering.styles import (
    DEFAULT,
    StyleQuery,
    UnknownStyleError,
    styles_of,
)
from solmap.gis_server.rendering.tiles import render_tile
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.raster.styles import (
    STYLES,
)
from solmap.products.formats.raster.tiling import MAX_ZOOM, TileAddress
from solmap.products.model import Layer, ProductKind

Number = Annotated[int, Path(ge=0)]
ClientEtag = Annotated[str, Header(alias="if-none-match", include_in_schema=False)]
router = APIRouter(prefix="/ogc/{mission}", tags=["ogc tiles"])
_PART = "http://www.opengis.net/spec/ogcapi-tiles-1/1.0/conf"
_TILE = "/map/tiles/{tms}/{zoom}/{row}/{column}"


def rasters(mission: str, services: Services) -> list[Layer]:
    """The latest layers that have tiles."""
    layers = services.catalogue.layers(mission)
    return [one for one in layers if one.type == "raster" and one.ref.kind in STYLES]


def raster_named(name: str, mission: str, services: Services) -> Layer:
    """The latest version of the raster layer that a collection's name means.

    Raises:
        ProductNotFoundError: there is none.
    """
    scope, _, kind = name.rpartition(".")
    if scope and kind in STYLES:
        layer = services.catalogue.layer(scope, ProductKind(kind))
        if layer.mission == mission and layer.type == "raster":
            return layer
    raise ProductNotFoundError(
        f"{mission} has no map {name}; names are those of {{scope}}.{{kind}} in its collections, "
        f"such as {', '.join(collection_id(one) for one in rasters(mission, services)[:3])}"
    )


def _raster(
    collection: Annotated[str, Path(pattern=r"^[a-z0-9][a-z0-9_.-]{0,191}$")],
    mission: MissionName,
    services: ServicesOf,
) -> Layer:
    services.catalogue.mission(mission)
    return raster_named(collection, mission, services)


Raster = Annotated[Layer, Depends(_raster)]


async def _style(layer: Raster, request: Request) -> str:
    style: str = request.path_params.get("style", DEFAULT)
    known = styles_of(layer.ref.kind)
    if style not in known:
        raise UnknownStyleError(f"{layer.id} has no style {style}; it has {', '.join(known)}")
    return style


StyleName = Annotated[str, Depends(_style)]
"""The style that the path names, if it names one."""


async def _address(
    zoom: Annotated[int, Path(ge=0, le=MAX_ZOOM)], row: Number, column: Number
) -> TileAddress:
    return TileAddress(zoom, column, row)


Matrix = Annotated[TileAddress, Depends(_address)]
"""Zoom, row and column, in the order of OGC."""


def _known_tms(tms: str, mission: MissionName, services: ServicesOf) -> None:
    check_tms(tms, services.catalogue.mission(mission))


KNOWN_TMS = Depends(_known_tms)
"""That the path names the mission's tile matrix set."""


def in_style(style: str, query: StyleQuery) -> StyleQuery:
    """The query in the style that the path names."""
    return query if style == DEFAULT else query.model_copy(update={"style": style})


def latest_tile(
    layer: Layer, address: TileAddress, query: StyleQuery, services: Services, known: str
) -> Response:
    """A tile, or that the client has it already.

    Args:
        layer: The latest version of a layer.
        address: The tile.
        query: How to draw it.
        services: Store and open rasters.
        known: The client's version (`If-None-Match`).
    """
    drawn = hashlib.sha256(f"{address} {query}".encode()).hexdigest()[:16]
    tag = f'"{layer.ref.digest}-{drawn}"'
    headers = {**REVALIDATE, "ETag": tag}
    if tag in known:
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    body = render_tile(layer, address, services.store, services.pool, query)
    return Response(body, media_type="image/png", headers=headers)


def check_tms(tms: str, mission: MissionEntry) -> None:
    """Refuse a tile matrix set that is not the mission's."""
    known = tms_id(mission.landing)
    if tms != known:
        raise ProductNotFoundError(f"there is no tile matrix set {tms}; there is {known}")


CONFORMANCE = (
    *(f"{_PART}/{name}" for name in ("core", "tileset", "tilesets-list", "geodata-tilesets")),
    f"{_PART}/png",
    "http://www.opengis.net/spec/tms/2.0/conf/tilematrixset",
    "http://www.opengis.net/spec/tms/2.0/conf/json-tilematrixset",
    "http://www.opengis.net/spec/tms/2.0/conf/tilesetmetadata",
    "http://www.opengis.net/spec/tms/2.0/conf/json-tilesetmetadata",
)


def landing_links(base: str) -> list[Link]:
    """Links to tiles on the landing page."""
    return [
        link(TILING_SCHEMES, f"{base}/tileMatrixSets", JSON, "Tile matrix sets"),
        link("data", f"{base}/maps", JSON, "Collections of rasters"),
    ]


def collections(mission: MissionEntry, services: Services, base: str) -> list[dict[str, Any]]:
    """The raster layers of a mission as collections."""
    found = rasters(mission.mission, services)
    return [collection_document(layer, mission, base) for layer in found]


class _TileQuery(StyleQuery):
    """A style, and the format, of which there is one."""

    f: Literal["png"] = "png"


@router.get("/tileMatrixSets")
def tile_matrix_sets(mission: MissionName, services: ServicesOf, base: BaseOf) -> Response:
    """The only tile matrix set of the mission's map, in a list."""
    landing = services.catalogue.mission(mission).landing
    document = tms_document(landing, base)
    links = [link("self", document["uri"], JSON, "Tile matrix set")]
    listed = {"id": document["id"], "title": document["title"], "uri": document["uri"]}
    return _json({"tileMatrixSets": [{**listed, "links": links}]})


@router.get("/tileMatrixSets/{tms}")
def tile_matrix_set(mission: MissionName, tms: str, services: ServicesOf, base: BaseOf) -> Response:
    """How the mission's map is cut into tiles."""
    entry = services.catalogue.mission(mission)
    check_tms(tms, entry)
    return _json(tms_document(entry.landing, base))


@router.get("/collections/{collection}/styles")
def styles(layer: Raster, base: BaseOf) -> Response:
    """The styles that a layer's tiles come in."""
    return _json(styles_document(layer, base))


@router.get("/collections/{collection}/map/tiles")
@router.get("/collections/{collection}/styles/{style}/map/tiles")
def tilesets(layer: Raster, services: ServicesOf, base: BaseOf, style: StyleName) -> Response:
    """The tilesets of a layer."""
    landing = services.catalogue.mission(layer.mission).landing
    return _json(tilesets_document(layer, landing, style, base))


@router.get("/collections/{collection}/map/tiles/{tms}")
@router.get("/collections/{collection}/styles/{style}/map/tiles/{tms}")
def tileset(
    layer: Raster, tms: str, services: ServicesOf, base: BaseOf, style: StyleName
) -> Response:
    """A tileset: its limits and the address of its tiles."""
    entry = services.catalogue.mission(layer.mission)
    check_tms(tms, entry)
    return _json(tileset_document(layer, entry.landing, style, base))


@router.get(
    f"/collections/{{collection}}{_TILE}", response_class=Response, dependencies=[KNOWN_TMS]
)
@router.get(
    f"/collections/{{collection}}/styles/{{style}}{_TILE}",
    response_class=Response,
    dependencies=[KNOWN_TMS],
)
def tile(
    layer: Raster,
    address: Matrix,
    services: ServicesOf,
    style: StyleName,
    query: Annotated[_TileQuery, Query()],
    known: ClientEtag = "",
) -> Response:
    """A tile of the latest version of a layer."""
    return latest_tile(layer, address, in_style(style, query), services, known)


def _json(body: dict[str, Any]) -> JSONResponse:
    return JSONResponse(body, headers=REVALIDATE)
