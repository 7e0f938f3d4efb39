"""OGC API Tiles: the rasters of a mission as tiles of maps."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import JSONResponse

from solmap.gis_server.ogc.links import JSON, BaseOf, Link, link
from solmap.gis_server.ogc.maps import (
    KNOWN_TMS,
    Known,
    Matrix,
    Raster,
    StyleName,
    check_tms,
    latest_tile,
    rasters,
)
from solmap.gis_server.ogc.tilesets import (
    TILING_SCHEMES,
    collection_document,
    styles_document,
    tileset_document,
    tilesets_document,
    tms_document,
)
from solmap.gis_server.rendering.styles import DEFAULT
from solmap.gis_server.routes.looks import AskedLook
from solmap.gis_server.routes.parameters import AGAIN, MissionName
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.catalogue import MissionEntry

router = APIRouter(prefix="/ogc/{mission}", tags=["ogc tiles"])
_PART = "http://www.opengis.net/spec/ogcapi-tiles-1/1.0/conf"
CONFORMANCE = (
    *(f"{_PART}/{name}" for name in ("core", "tileset", "tilesets-list", "geodata-tilesets")),
    f"{_PART}/png",
    "http://www.opengis.net/spec/tms/2.0/conf/tilematrixset",
    "http://www.opengis.net/spec/tms/2.0/conf/json-tilematrixset",
    "http://www.opengis.net/spec/tms/2.0/conf/tilesetmetadata",
    "http://www.opengis.net/spec/tms/2.0/conf/json-tilesetmetadata",
)


def landing_links(base: str) -> list[Link]:
    """What the landing page says of tiles."""
    return [link(TILING_SCHEMES, f"{base}/tileMatrixSets", JSON, "Tile matrix sets")]


def collections(mission: MissionEntry, services: Services, base: str) -> list[dict[str, Any]]:
    """The raster layers of a mission as collections."""
    found = rasters(mission.mission, services)
    return [collection_document(layer, mission, base) for layer in found]


class _TileQuery(AskedLook):
    """A look, and the format, of which there is one."""

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


_TILE = "/map/tiles/{tms}/{zoom}/{row}/{column}"


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
    asked: Annotated[_TileQuery, Query()],
    known: Known = "",
) -> Response:
    """A tile of the latest version of a layer."""
    look = asked.look if style == DEFAULT else replace(asked.look, style=style)
    return latest_tile(layer, address, look, services, known)


def _json(body: dict[str, Any]) -> JSONResponse:
    return JSONResponse(body, headers=AGAIN)
