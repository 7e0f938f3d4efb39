"""One layer: its features, its provenance, its file."""

from __future__ import annotations

from http import HTTPStatus
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Query, Request, Response
from fastapi.responses import FileResponse, JSONResponse

from solmap.gis_server.routes.files import product_response
from solmap.gis_server.routes.parameters import FOREVER, Bounds, LayerPath
from solmap.gis_server.services import ServicesOf
from solmap.products.errors import ProductNotFoundError
from solmap.products.features.texts import FeatureTexts, texts_of
from solmap.products.formats.vector.geojson import read_features
from solmap.products.formats.vector.geopackage import write_geopackage
from solmap.products.model import SUFFIX, Layer

router = APIRouter(tags=["layers"])
_MOST_AT_ONCE = 20_000
"""Features: some 30 MB."""
AskedNames = Annotated[tuple[str, ...], Query(max_length=200)]
MEDIA_TYPES = {
    ".tif": "image/tiff; application=geotiff; profile=cloud-optimized",
    ".geojson": "application/geo+json",
    ".glb": "model/gltf-binary",
    ".3tz": "application/vnd.maxar.archive.3tz+zip",
}


@router.get("/api/layers/{scope}/{kind}/{digest}/features.geojson", response_class=JSONResponse)
def features(
    layer: LayerPath, services: ServicesOf, bounds: Bounds, ids: AskedNames = ()
) -> Response:
    """The features of a layer as GeoJSON in metres of the local map: east, north and up if known.

    All of them, those that meet a box, or those of some identifiers. Of layers with more than
    20,000 a box or identifiers must be given; pages of all has `/ogc/{mission}/collections`. The
    download has them in degrees of Mars.
    """
    if layer.type != "vector":
        raise ProductNotFoundError(f"{layer.id} is a raster: it has tiles and no features")
    texts = texts_of(services.store.path(layer.ref))
    if ids:
        numbers = texts.named(ids)
    elif bounds is not None:
        numbers = texts.within(bounds)
    else:
        numbers = range(_all_of(layer, texts))
    body = texts.collection(numbers)
    return Response(body, headers=FOREVER, media_type="application/geo+json")


def _all_of(layer: Layer, texts: FeatureTexts) -> int:
    """How many features there are.

    Raises:
        HTTPException: more than are sent at once.
    """
    count = len(texts.texts)
    if count > _MOST_AT_ONCE:
        raise HTTPException(
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
            f"{layer.id} has {count} features, more than the {_MOST_AT_ONCE} that are sent at "
            f"once: give a bbox or ids, or ask /ogc/{layer.mission}/collections for pages of them",
        )
    return count


@router.get("/api/layers/{scope}/{kind}/{digest}/provenance")
def provenance(layer: LayerPath, services: ServicesOf, response: Response) -> dict[str, Any]:
    """How the layer was made: recipe, inputs, parameters, time and checksum."""
    response.headers.update(FOREVER)
    return services.store.provenance(layer.ref)


@router.get("/download/{scope}/{kind}/{digest}.gpkg", response_class=Response)
def geopackage(layer: LayerPath, services: ServicesOf) -> Response:
    """The features of a layer as a GeoPackage in metres of the local map."""
    if layer.type != "vector":
        raise ProductNotFoundError(f"{layer.id} is a raster: it is a GeoTIFF and no GeoPackage")
    collection = read_features(services.store.path(layer.ref))
    if not collection.features:
        raise ProductNotFoundError(f"{layer.id} has no feature that a GeoPackage could hold")
    name = f"{layer.ref.scope.name}_{layer.ref.kind}"
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.gpkg"
        write_geopackage(path, collection, str(layer.ref.kind))
        body = path.read_bytes()
    disposition = {"content-disposition": f'attachment; filename="{name}_{layer.ref.digest}.gpkg"'}
    return Response(
        body, headers={**FOREVER, **disposition}, media_type="application/geopackage+sqlite3"
    )


@router.head("/download/{scope}/{kind}/{digest}", include_in_schema=False)
@router.get("/download/{scope}/{kind}/{digest}", response_class=FileResponse)
def download(layer: LayerPath, services: ServicesOf, request: Request) -> Response:
    """The layer's file, whole or by ranges: GeoTIFF in the local CRS, GeoJSON in Mars degrees."""
    suffix = SUFFIX[layer.ref.kind]
    media_type = MEDIA_TYPES.get(suffix, "application/octet-stream")
    name = f"{layer.ref.scope.name}_{layer.ref.kind}_{layer.ref.digest}{suffix}"
    return product_response(layer.ref, services.store, request, media_type, name)
