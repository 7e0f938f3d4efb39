"""WMTS 1.0.0: the same tiles for QGIS, GDAL and others that do not speak OGC API yet.

    /ogc/{mission}/wmts/1.0.0/WMTSCapabilities.xml
    /ogc/{mission}/wmts?service=WMTS&request=GetCapabilities    and GetTile

Names of parameters may be written in any case. What is wrong is answered with an exception report.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from http import HTTPStatus
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from solmap.gis_server.ogc.links import BaseOf, Link, link
from solmap.gis_server.ogc.maps import (
    Known,
    Matrix,
    Raster,
    StyleName,
    check_tms,
    latest_tile,
    raster_named,
    rasters,
)
from solmap.gis_server.ogc.wmts_document import capabilities, exception_report
from solmap.gis_server.rendering.looks import Look, UnknownLookError
from solmap.gis_server.rendering.styles import DEFAULT
from solmap.gis_server.routes.looks import AskedLook
from solmap.gis_server.routes.parameters import AGAIN, MissionName
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.errors import OutsideCoverageError, ProductNotFoundError
from solmap.products.formats.raster.tiling import TileAddress

router = APIRouter(prefix="/ogc/{mission}/wmts", tags=["ogc tiles"])
CONFORMANCE: tuple[str, ...] = ()
_XML = "application/xml"


class _RequestError(Exception):
    def __init__(self, code: str, text: str, locator: str) -> None:
        super().__init__(text)
        self.code, self.text, self.locator = code, text, locator


def landing_links(base: str) -> list[Link]:
    """What the landing page says of WMTS."""
    address = f"{base}/wmts/1.0.0/WMTSCapabilities.xml"
    return [link("service", address, _XML, "Web Map Tile Service")]


def collections(_mission: MissionEntry, _services: Services, _base: str) -> list[dict[str, Any]]:
    """None of its own: those of OGC API Tiles."""
    return []


@router.get("/1.0.0/WMTSCapabilities.xml", response_class=Response)
def document(mission: MissionName, services: ServicesOf, base: BaseOf) -> Response:
    """All layers, their styles and the tile matrix set."""
    body = _capabilities(mission, services, base, services.catalogue.published())
    return Response(body, media_type=_XML, headers=AGAIN)


@router.get("/1.0.0/{collection}/{style}/{tms}/{zoom}/{row}/{column}.png", response_class=Response)
def tile(
    layer: Raster,
    style: StyleName,
    address: Matrix,
    services: ServicesOf,
    asked: Annotated[AskedLook, Query()],
    known: Known = "",
) -> Response:
    """A tile of the latest version of a layer."""
    look = asked.look if style == DEFAULT else replace(asked.look, style=style)
    return latest_tile(layer, address, look, services, known)


@router.get("", response_class=Response)
def by_parameters(
    mission: MissionName,
    request: Request,
    services: ServicesOf,
    base: BaseOf,
    known: Known = "",
) -> Response:
    """GetCapabilities and GetTile, by parameters in the query."""
    asked = {name.lower(): value for name, value in request.query_params.items()}
    if asked.get("request", "").lower() == "getcapabilities":
        return document(mission, services, base)
    try:
        return _tile(mission, asked, services, known)
    except _RequestError as error:
        body = exception_report(error.code, error.text, error.locator)
        return Response(body, HTTPStatus.BAD_REQUEST, {"Cache-Control": "no-store"}, _XML)


@lru_cache(maxsize=4)
def _capabilities(mission: str, services: Services, base: str, _version: int) -> bytes:
    """Written anew when something has been published: of 5500 layers it takes seconds."""
    entry = services.catalogue.mission(mission)
    return capabilities(entry, rasters(mission, services), base)


def _tile(mission: str, asked: Mapping[str, str], services: Services, known: str) -> Response:
    operation = asked.get("request", "")
    if operation.lower() != "gettile":
        raise _RequestError(
            "OperationNotSupported",
            f"request={operation} is neither GetCapabilities nor GetTile",
            "request",
        )
    try:
        check_tms(_given(asked, "tilematrixset"), services.catalogue.mission(mission))
        layer = raster_named(_given(asked, "layer"), mission, services)
        address = TileAddress(*(_number(asked, n) for n in ("tilematrix", "tilecol", "tilerow")))
        _check_format(asked)
        look = Look(asked.get("style") or DEFAULT)
        return latest_tile(layer, address, look, services, known)
    except OutsideCoverageError as error:
        raise _RequestError("TileOutOfRange", str(error), "tilematrix") from error
    except (ProductNotFoundError, UnknownLookError) as error:
        raise _RequestError("InvalidParameterValue", str(error), "layer") from error


def _check_format(asked: Mapping[str, str]) -> None:
    found = asked.get("format", "image/png")
    if found != "image/png":
        raise _RequestError("InvalidParameterValue", f"format={found} is not image/png", "format")


def _given(asked: Mapping[str, str], name: str) -> str:
    if not asked.get(name):
        raise _RequestError("MissingParameterValue", f"GetTile asks for {name}", name)
    return asked[name]


def _number(asked: Mapping[str, str], name: str) -> int:
    text = _given(asked, name)
    if not (text.isascii() and text.isdigit() and len(text) < 10):  # noqa: PLR2004 - digits
        raise _RequestError("InvalidParameterValue", f"{name}={text} is no number", name)
    return int(text)
