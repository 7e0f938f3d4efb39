"""Maps as OGC API Tiles and WMTS name them: layers without a digest, of which the latest is meant.

The addresses of `/tiles/...` carry a digest and are kept forever; these are asked again each time,
and answered with 304 where the layer is still the same.
"""

from __future__ import annotations

import hashlib
from http import HTTPStatus
from typing import Annotated

from fastapi import Depends, Header, Path, Request, Response

from solmap.gis_server.ogc.tilesets import collection_id, tms_id
from solmap.gis_server.rendering.looks import Look, UnknownLookError
from solmap.gis_server.rendering.styles import DEFAULT, STYLES, styles_of
from solmap.gis_server.rendering.tiles import render_tile
from solmap.gis_server.routes.parameters import AGAIN, MissionName
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.raster.tiling import MAX_ZOOM, TileAddress
from solmap.products.model import Layer, ProductKind

Number = Annotated[int, Path(ge=0)]


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


def _style(layer: Raster, request: Request) -> str:
    style: str = request.path_params.get("style", DEFAULT)
    known = styles_of(layer.ref.kind)
    if style not in known:
        raise UnknownLookError(f"{layer.id} has no style {style}; it has {', '.join(known)}")
    return style


StyleName = Annotated[str, Depends(_style)]
"""The style that the path names, if it names one."""


def _address(
    zoom: Annotated[int, Path(ge=0, le=MAX_ZOOM)], row: Number, column: Number
) -> TileAddress:
    return TileAddress(zoom, column, row)


Matrix = Annotated[TileAddress, Depends(_address)]
"""Zoom, row and column, in the order of OGC."""
Known = Annotated[str, Header(alias="if-none-match", include_in_schema=False)]


def _known_tms(tms: str, mission: MissionName, services: ServicesOf) -> None:
    check_tms(tms, services.catalogue.mission(mission))


KNOWN_TMS = Depends(_known_tms)
"""That the path names the mission's tile matrix set."""


def latest_tile(
    layer: Layer, address: TileAddress, look: Look, services: Services, known: str
) -> Response:
    """A tile, or that the client has it already.

    Args:
        layer: The latest version of a layer.
        address: The tile.
        look: How to draw it.
        services: Store and open rasters.
        known: What the client says it has (`If-None-Match`).
    """
    drawn = hashlib.sha256(f"{address} {look}".encode()).hexdigest()[:16]
    tag = f'"{layer.ref.digest}-{drawn}"'
    headers = {**AGAIN, "ETag": tag}
    if tag in known:
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    body = render_tile(layer, address, services.store, services.pool, look)
    return Response(body, media_type="image/png", headers=headers)


def check_tms(tms: str, mission: MissionEntry) -> None:
    """Refuse a tile matrix set that is not the mission's."""
    known = tms_id(mission.landing)
    if tms != known:
        raise ProductNotFoundError(f"there is no tile matrix set {tms}; there is {known}")
