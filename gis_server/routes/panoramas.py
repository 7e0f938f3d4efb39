"""Panoramas of the stops: list, tiles, and conversion between panorama and map."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel

from solmap.gis_server.addresses import ServerPath
from solmap.gis_server.analysis.ground import BEST
from solmap.gis_server.analysis.image_to_ground import point_on_map
from solmap.gis_server.analysis.panoramas import (
    DirectionSeen,
    PanoramaView,
    PlaceSeen,
    facts_of,
    tile_of,
)
from solmap.gis_server.parameters import (
    FOREVER,
    REVALIDATE,
    Digest,
    Metres,
    MissionName,
    ScopeName,
    ground_of,
)
from solmap.gis_server.rendering.png import indexed_png
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import Layer, ProductKind

router = APIRouter(tags=["panoramas"])
TILE = 256
_GREYS = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
_MAX_ZOOM = 16


class PanoramaBody(BaseModel):
    """A panorama: azimuth across and elevation down, both linear in pixels, degrees."""

    id: str
    scope: str
    digest: str
    title: str
    sols: tuple[int, ...]
    made_at: str
    eye: str
    images: tuple[str, ...]
    centre: tuple[float, float, float]
    """East, north and elevation that it is seen from, metres."""
    west_deg: float
    """Azimuth of its left edge, clockwise from north."""
    top_deg: float
    """Elevation of its upper edge above the horizon."""
    cell_deg: float
    rows: int
    cols: int
    registration_px: float | None
    """Median shift between neighbouring images where both show the same, pixels."""
    tiles: ServerPath
    tile_size: int
    max_zoom: int
    """Zoom at which a pixel of a tile is one of the panorama; each zoom below halves it."""
    download: ServerPath
    provenance: ServerPath


@router.get("/api/missions/{mission}/panoramas")
def panoramas(mission: MissionName, services: ServicesOf, response: Response) -> list[PanoramaBody]:
    """The latest panorama of every stop."""
    response.headers.update(REVALIDATE)
    services.catalogue.mission(mission)
    layers = services.catalogue.layers(mission)
    return [_body(layer, services) for layer in layers if layer.type == "panorama"]


@router.get("/panoramas/{scope}/{digest}/{z}/{x}/{y}.png", response_class=Response)
def tile(
    scope: ScopeName,
    digest: Digest,
    z: Annotated[int, Path(ge=0, le=_MAX_ZOOM)],
    x: Annotated[int, Path(ge=0, le=10_000)],
    y: Annotated[int, Path(ge=0, le=10_000)],
    services: ServicesOf,
) -> Response:
    """One tile of a panorama, for deep zoom; zoom 0 is the whole in one tile."""
    layer = services.layer(scope, ProductKind.PANORAMA, digest)
    with services.pool.reading(services.store.address(layer.ref)) as dataset:
        deepest = _max_zoom(dataset.height, dataset.width)
        grey = tile_of(dataset, 1 << max(0, deepest - z), x, y, TILE)
    return Response(indexed_png(grey, _GREYS), media_type="image/png", headers=FOREVER)


@router.get("/api/missions/{mission}/panoramas/{scope}/{digest}/direction")
def identify_direction(
    mission: MissionName,
    scope: ScopeName,
    digest: Digest,
    services: ServicesOf,
    azimuth: Annotated[float, Query(ge=-720, le=720, allow_inf_nan=False)],
    elevation: Annotated[float, Query(ge=-90, le=90, allow_inf_nan=False)],
) -> DirectionSeen:
    """The ground in a direction, degrees, and the pixel of the image that shows it."""
    panorama = _panorama(scope, digest, services)
    oriented = OrientedMission.latest(mission, Workspace(services.store, services.catalogue))
    return panorama.direction(azimuth, elevation, oriented)


@router.get("/api/missions/{mission}/panoramas/{scope}/{digest}/place")
def project_place(  # noqa: PLR0913, PLR0917 - the address
    mission: MissionName,
    scope: ScopeName,
    digest: Digest,
    services: ServicesOf,
    east: Metres,
    north: Metres,
    elevation: Metres | None = None,
) -> PlaceSeen:
    """Direction of a place of the map, and whether nearer ground hides it."""
    panorama = _panorama(scope, digest, services)
    if elevation is None:
        oriented = OrientedMission.latest(mission, Workspace(services.store, services.catalogue))
        point, _ = point_on_map((east, north), oriented, ground_of(mission, BEST, services))
        elevation = float(point.on_map[2])
    return panorama.place(np.array([east, north, elevation]))


def _panorama(scope: str, digest: str, services: Services) -> PanoramaView:
    layer = services.layer(scope, ProductKind.PANORAMA, digest)
    return PanoramaView.of(layer, services.store, services.pool)


def _max_zoom(rows: int, cols: int) -> int:
    return max(0, math.ceil(math.log2(max(rows, cols) / TILE)))


def _body(layer: Layer, services: Services) -> PanoramaBody:
    facts, ref = facts_of(layer, services.store, services.pool), layer.ref
    place = f"{ref.scope.name}/{ref.kind}/{ref.digest}"
    east, north, up = facts.centre.tolist()
    return PanoramaBody(
        id=layer.id,
        scope=ref.scope.name,
        digest=ref.digest,
        title=layer.title,
        sols=layer.sols,
        made_at=layer.made_at,
        eye=facts.eye,
        images=facts.images,
        centre=(east, north, up),
        west_deg=facts.grid.west_deg,
        top_deg=facts.grid.top_deg,
        cell_deg=facts.grid.cell_deg,
        rows=facts.grid.rows,
        cols=facts.grid.cols,
        registration_px=facts.registration.get("median_px"),
        tiles=f"/panoramas/{ref.scope.name}/{ref.digest}/{{z}}/{{x}}/{{y}}.png",
        tile_size=TILE,
        max_zoom=_max_zoom(*facts.grid.shape),
        download=f"/download/{place}",
        provenance=f"/api/layers/{place}/provenance",
    )
