"""Models in three dimensions and their tiles; stops and cameras that are drawn with them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel

from solmap.gis_server.addresses import ServerPath
from solmap.gis_server.analysis.bodies import UnanswerableError
from solmap.gis_server.analysis.scene import (
    SceneCameras,
    SceneStops,
    scene_cameras,
    scene_stops,
    site_frames,
)
from solmap.gis_server.parameters import FOREVER, REVALIDATE, Digest, MissionName, ScopeName
from solmap.gis_server.services import Services, ServicesOf
from solmap.photogrammetry.archive.tables.vector_files import VectorFile, parse_vector_file
from solmap.photogrammetry.terrain.mesh.solid import SolidParams, build_solid
from solmap.products.catalogue.catalogue import published_networks
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import local_crs
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.documents.network import cached_whole_network
from solmap.products.formats.mesh.stl import stl_bytes
from solmap.products.formats.mesh.tiles3d import (
    TILESET,
    external_tileset,
    read_member,
    read_tileset,
    tileset_document,
)
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.model import Layer, ProductKind, ProductRef, Scope, ScopeLevel

router = APIRouter(tags=["models"])
TILESETS = (ProductKind.TILESET, ProductKind.POINT_TILES)
_MEMBER_TYPES = {"json": "application/json", "glb": "model/gltf-binary"}


class Model(BaseModel):
    """A model and its addresses; bounds and range (least and largest elevation) in metres."""

    id: str
    scope: str
    kind: str
    digest: str
    title: str
    bounds: tuple[float, float, float, float]
    range: tuple[float, float] | None
    sols: tuple[int, ...]
    made_at: str
    open: ServerPath
    """URL of a glTF binary or a `tileset.json`."""
    download: ServerPath
    provenance: ServerPath


@router.get("/api/missions/{mission}/models")
def models(mission: MissionName, services: ServicesOf, response: Response) -> list[Model]:
    """The latest models of every stop."""
    response.headers.update(REVALIDATE)
    services.catalogue.mission(mission)
    return [_body(layer) for layer in services.catalogue.layers(mission) if layer.type == "model"]


@router.get("/api/missions/{mission}/tileset.json")
def region(mission: MissionName, services: ServicesOf, response: Response) -> dict[str, Any]:
    """The tilesets of all stops as one, in (east, north, up) metres of the mission's local map."""
    response.headers.update(REVALIDATE)
    landing = services.catalogue.mission(mission).landing
    tilesets = [
        layer
        for layer in services.catalogue.layers(mission)
        if layer.ref.kind is ProductKind.TILESET
    ]
    if not tilesets:
        raise ProductNotFoundError(f"no stop of {mission} has 3D tiles")
    parts = [
        external_tileset(_tileset_of(layer), read_tileset(services.store.path(layer.ref)))
        for layer in tilesets
    ]
    return tileset_document(parts, {"crs": local_crs(landing).to_wkt()})


@router.get("/models/{scope}/dtm/{digest}/terrain.stl", response_class=Response)
def stl(
    scope: ScopeName,
    digest: Digest,
    services: ServicesOf,
    base_m: Annotated[float, Query(ge=0, le=100, allow_inf_nan=False)] = SolidParams().base_m,
    tolerance_m: Annotated[
        float, Query(ge=0.01, le=10, allow_inf_nan=False)
    ] = SolidParams().tolerance_m,
) -> Response:
    """The terrain model of a stop as a solid on a flat base `base_m` below it, binary STL.

    Metres from an origin that the file's header names. With `base_m=0` it is the surface alone.
    """
    layer = services.layer(scope, ProductKind.DTM, digest)
    if layer.ref.scope.level is not ScopeLevel.STOP:
        raise UnanswerableError(f"{layer.id} is larger than a stop's: cut a part of it out instead")
    model = read_dtm(services.store.path(layer.ref))
    body = stl_bytes(build_solid(model, SolidParams(tolerance_m, base_m)))
    name = f'attachment; filename="{layer.readable_name}.stl"'
    return Response(body, media_type="model/stl", headers={**FOREVER, "content-disposition": name})


@router.get("/models/{scope}/{kind}/{digest}/{member:path}", response_class=Response)
def member(
    scope: ScopeName,
    kind: Literal["tileset", "point-tiles"],
    digest: Digest,
    member: Annotated[str, Path(pattern=r"^(tileset\.json|\d{1,2}/\d{1,6}-\d{1,6}\.glb)$")],
    services: ServicesOf,
) -> Response:
    """One file of a tileset."""
    layer = services.layer(scope, ProductKind(kind), digest)
    body = read_member(services.store.path(layer.ref), member)
    media_type = _MEMBER_TYPES[member.rpartition(".")[2]]
    return Response(body, media_type=media_type, headers=FOREVER)


def _tileset_of(layer: Layer) -> str:
    return f"/models/{layer.ref.scope.name}/{layer.ref.kind}/{layer.ref.digest}/{TILESET}"


def _body(layer: Layer) -> Model:
    ref = layer.ref
    place = f"{ref.scope.name}/{ref.kind}/{ref.digest}"
    is_tileset = ref.kind in TILESETS
    return Model(
        id=layer.id,
        scope=ref.scope.name,
        kind=str(ref.kind),
        digest=ref.digest,
        title=layer.title,
        bounds=layer.bounds,
        range=layer.range,
        sols=layer.sols,
        made_at=layer.made_at,
        open=_tileset_of(layer) if is_tileset else f"/download/{place}",
        download=f"/download/{place}",
        provenance=f"/api/layers/{place}/provenance",
    )


@router.get("/api/missions/{mission}/scene/stops")
def stops(mission: MissionName, services: ServicesOf, response: Response) -> SceneStops:
    """Places, attitudes and error ellipsoids of all stops, as last adjusted; frames of sites."""
    response.headers.update(REVALIDATE)
    landing = services.catalogue.mission(mission).landing
    published = published_networks(mission, services.catalogue)
    if not published:
        return SceneStops(network=None, body=None, stops=[])
    network = cached_whole_network(published[-1], services.store)
    sites = {} if landing.origin else site_frames(network, _site_vectors(mission, services))
    return scene_stops(published[-1], network, sites)


def _site_vectors(mission: str, services: Services) -> VectorFile | None:
    kind, scope = ProductKind.SITE_VECTORS, Scope(ScopeLevel.REGION, mission.lower())
    digest = services.catalogue.latest(scope.name, kind)
    if digest is None:
        return None
    path = services.store.path(ProductRef(kind, scope, digest))
    return parse_vector_file(path.read_text(), path.name)


@router.get("/api/missions/{mission}/scene/cameras")
def cameras(
    mission: MissionName,
    stop: Annotated[str, Query(max_length=128)],
    services: ServicesOf,
    response: Response,
) -> SceneCameras:
    """Projection centres and viewing rays of the images of a stop, their pointing corrected."""
    response.headers.update(REVALIDATE)
    services.catalogue.mission(mission)
    published = published_networks(mission, services.catalogue)
    if not published:
        return SceneCameras(network=None, cameras=[])
    workspace = Workspace(services.store, services.catalogue)
    entries = services.catalogue.images(mission, stop)
    network = cached_whole_network(published[-1], services.store)
    return scene_cameras(published[-1], network, entries, workspace)
