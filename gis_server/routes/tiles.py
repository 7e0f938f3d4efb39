"""Map tiles: pictures and values."""

from __future__ import annotations

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Header, Query, Response

from solmap.gis_server.parameters import FOREVER, Address, LayerPath
from solmap.gis_server.rendering.png import gunzip
from solmap.gis_server.rendering.styles import StyleQuery
from solmap.gis_server.rendering.tiles import MEDIA_TYPE, render_tile, render_values
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.formats.raster.tiling import TileAddress
from solmap.products.model import Layer

router = APIRouter(tags=["tiles"])
BandName = Annotated[str, Query(pattern=r"^[a-z_]{0,64}$", description="the first by default")]


@router.get("/tiles/{scope}/{kind}/{digest}/{z}/{x}/{y}.png", response_class=Response)
def tile(
    layer: LayerPath, address: Address, services: ServicesOf, query: Annotated[StyleQuery, Query()]
) -> Response:
    """One tile of 256 x 256 pixels, transparent where nothing was measured.

    Which styles a layer has says `GET /api/layers/{scope}/{kind}/{digest}/styles`.
    """
    return picture_of(layer, address, services, query)


@router.get("/tiles/{scope}/{kind}/{digest}/{z}/{x}/{y}.values", response_class=Response)
def values(
    layer: LayerPath,
    address: Address,
    services: ServicesOf,
    band: BandName = "",
    accept_encoding: Annotated[str, Header(include_in_schema=False)] = "",
) -> Response:
    """The values of a tile and of the pixels around it; status 204 where nothing was measured.

    The format stands in the documentation of the stage "Serve".
    """
    return values_of(layer, address, services, accept_encoding, band)


def picture_of(
    layer: Layer, address: TileAddress, services: Services, query: StyleQuery
) -> Response:
    """The answer with the picture of a tile."""
    body = render_tile(layer, address, services.store, services.pool, query)
    return Response(body, media_type="image/png", headers=FOREVER)


def values_of(
    layer: Layer, address: TileAddress, services: Services, accept_encoding: str, band: str = ""
) -> Response:
    """The answer with the values of a tile, compressed if the client can undo that."""
    body = render_values(layer, address, services.store, services.pool, band)
    headers = {**FOREVER, "Vary": "Accept-Encoding"}
    if body is None:
        return Response(status_code=HTTPStatus.NO_CONTENT, headers=headers)
    if "gzip" in accept_encoding:
        headers["Content-Encoding"] = "gzip"
    else:
        body = gunzip(body)
    return Response(body, media_type=MEDIA_TYPE, headers=headers)
