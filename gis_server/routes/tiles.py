"""Map tiles."""

from __future__ import annotations

from fastapi import APIRouter, Response

from gis_server.rendering.tiles import render_tile
from gis_server.routes.parameters import FOREVER, Address, LayerPath
from gis_server.services import ServicesOf

router = APIRouter(tags=["tiles"])


@router.get("/tiles/{scope}/{kind}/{digest}/{z}/{x}/{y}.png", response_class=Response)
def tile(layer: LayerPath, address: Address, services: ServicesOf) -> Response:
    """One tile of 256 x 256 pixels, transparent where nothing was measured."""
    body = render_tile(layer, address, services.store, services.pool)
    return Response(body, media_type="image/png", headers=FOREVER)
