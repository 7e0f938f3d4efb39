"""What a view in three dimensions draws besides the ground: stops, the rover and its cameras."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from gis_server.analysis.scene import (
    SceneCameras,
    SceneStops,
    latest_network,
    network_of,
    scene_cameras,
    scene_stops,
)
from gis_server.routes.parameters import AGAIN, MissionName
from gis_server.services import ServicesOf
from products.workspace import Workspace

router = APIRouter(prefix="/api/missions/{mission}/scene", tags=["models"])


@router.get("/stops")
def stops(mission: MissionName, services: ServicesOf, response: Response) -> SceneStops:
    """Places, attitudes and error ellipsoids of all stops, as last adjusted."""
    response.headers.update(AGAIN)
    services.catalogue.mission(mission)
    ref = latest_network(mission, services.catalogue)
    if ref is None:
        return SceneStops(network=None, body=None, stops=[])
    return scene_stops(ref, network_of(ref, services.store))


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
    ref = latest_network(mission, services.catalogue)
    if ref is None:
        return SceneCameras(network=None, cameras=[])
    workspace = Workspace(services.store, services.catalogue)
    entries = services.catalogue.images(mission, stop)
    return scene_cameras(ref, network_of(ref, services.store), entries, workspace)
