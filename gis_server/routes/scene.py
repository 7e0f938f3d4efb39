"""What a view in three dimensions draws besides the ground: stops, the rover and its cameras."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from solmap.gis_server.analysis.scene import (
    SceneCameras,
    SceneStops,
    scene_cameras,
    scene_stops,
)
from solmap.gis_server.routes.parameters import AGAIN, MissionName
from solmap.gis_server.services import ServicesOf
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.network import network_of, published_networks

router = APIRouter(prefix="/api/missions/{mission}/scene", tags=["models"])


@router.get("/stops")
def stops(mission: MissionName, services: ServicesOf, response: Response) -> SceneStops:
    """Places, attitudes and error ellipsoids of all stops, as last adjusted."""
    response.headers.update(AGAIN)
    services.catalogue.mission(mission)
    published = published_networks(mission, services.catalogue)
    if not published:
        return SceneStops(network=None, body=None, stops=[])
    return scene_stops(published[-1], network_of(published[-1], services.store))


@router.get("/cameras")
def cameras(
    mission: MissionName,
    stop: Annotated[str, Query(max_length=128)],
    services: ServicesOf,
    response: Response,
) -> SceneCameras:
    """Projection centres and viewing rays of the images of a stop, their pointing corrected."""
    response.headers.update(AGAIN)
    services.catalogue.mission(mission)
    published = published_networks(mission, services.catalogue)
    if not published:
        return SceneCameras(network=None, cameras=[])
    workspace = Workspace(services.store, services.catalogue)
    entries = services.catalogue.images(mission, stop)
    network = network_of(published[-1], services.store)
    return scene_cameras(published[-1], network, entries, workspace)
