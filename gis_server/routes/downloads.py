"""Files of products: whole, by ranges or cropped; the STAC catalogue; URLs to copy.

Products in an object store are streamed through, so readers of the map need neither keys of the
object store nor access to it. The links of the STAC catalogue are relative; served from here they
lead from the catalogue to its items, and from an item to its file, as they do on disk.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Query, Request, Response
from fastapi import Path as PathParameter
from fastapi.responses import FileResponse, JSONResponse, StreamingResponse
from pydantic import BaseModel
from starlette.background import BackgroundTask

from solmap.gis_server.parameters import (
    FOREVER,
    REVALIDATE,
    BBox,
    Digest,
    ImageName,
    LayerPath,
    MissionName,
    base_of,
)
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.errors import (
    OutsideCoverageError,
    ProductError,
    ProductNotFoundError,
    StoreAwayError,
)
from solmap.products.formats.cropping import crop_features, crop_raster
from solmap.products.formats.vector.geojson import read_features, write_features
from solmap.products.formats.vector.geopackage import write_geopackage
from solmap.products.model import Layer, ProductRef
from solmap.products.reports.stac import FOLDER
from solmap.products.store.product_store import ProductStore

_RANGE = re.compile(r"bytes=(\d*)-(\d*)$", re.ASCII)
_UNSATISFIABLE = 416
router = APIRouter()
MEDIA_TYPES = {
    ".tif": "image/tiff; application=geotiff; profile=cloud-optimized",
    ".geojson": "application/geo+json",
    ".glb": "model/gltf-binary",
    ".3tz": "application/vnd.maxar.archive.3tz+zip",
}
Program = Literal["gdal", "qgis", "pystac", "browser"]
VectorForm = Annotated[
    Literal["geojson", "gpkg"], Query(alias="f", description="of features; rasters are GeoTIFF")
]
ItemName = Annotated[str, PathParameter(pattern=r"^[a-z0-9][a-z0-9_.-]{0,191}$")]
Suffix = Annotated[str, PathParameter(pattern=r"^[a-z0-9]{1,8}$")]


def product_response(
    ref: ProductRef,
    store: ProductStore,
    request: Request,
    media_type: str,
    filename: str | None = None,
) -> Response:
    """A product's file, or the requested range of it.

    Raises:
        ProductNotFoundError: it is not in the store.
        StoreAwayError: the object store does not answer.
    """
    if isinstance(store.address(ref), Path):
        path = store.path(ref)
        return FileResponse(path, media_type=media_type, filename=filename, headers=FOREVER)
    size = store.size(ref)
    headers = {**FOREVER, "accept-ranges": "bytes", "etag": f'"{ref.digest}"'}
    if filename is not None:
        headers["content-disposition"] = f'attachment; filename="{filename}"'
    requested = _requested_range(request, size, headers["etag"])
    start, end = requested or (0, size)
    status = 206 if requested else 200
    if requested:
        headers["content-range"] = f"bytes {start}-{end - 1}/{size}"
    headers["content-length"] = str(end - start)
    if request.method == "HEAD":
        return Response(status_code=status, headers=headers, media_type=media_type)
    body = store.chunks(ref, start, end)
    return StreamingResponse(body, status, headers=headers, media_type=media_type)


def _requested_range(request: Request, size: int, tag: str) -> tuple[int, int] | None:
    """First byte of a range, and the one after its last; None without a single range.

    Raises:
        HTTPException: the range lies beyond the file.
    """
    found = _RANGE.match(request.headers.get("range", "").replace(" ", ""))
    if found is None or request.headers.get("if-range", tag) != tag or found[0] == "bytes=-":
        return None
    first, last = found[1], found[2]
    start = int(first) if first else max(0, size - int(last))
    end = min(size, int(last) + 1) if first and last else size
    if start >= end:
        raise HTTPException(
            _UNSATISFIABLE,
            f"the file has {size} bytes",
            headers={"content-range": f"bytes */{size}"},
        )
    return start, end


class Address(BaseModel):
    """Something to copy into another program."""

    title: str
    service: str
    """Type of the service: `OGC API Features`, `WMTS`, `Cloud Optimised GeoTIFF` ..."""
    url: str
    """What to paste."""
    program: Program
    """A program that opens it so."""
    how: str
    """Place to paste it."""


@router.get(
    "/download/{scope}/{kind}/{digest}/clip", tags=["downloads"], response_class=FileResponse
)
def clip(
    layer: LayerPath, services: ServicesOf, bounds: BBox, form: VectorForm = "geojson"
) -> Response:
    """The part of a layer in a box: `bbox=west,south,east,north` in metres of the local map.

    Cells are unchanged, in the layer's own grid and CRS.
    """
    if bounds is None:
        raise HTTPException(400, "bbox=west,south,east,north in metres of the local map is missing")
    folder = TemporaryDirectory()
    try:
        path = _clip_layer(layer, services.store, bounds, (Path(folder.name), form))
    except (OutsideCoverageError, StoreAwayError):
        folder.cleanup()
        raise
    except ProductError as error:
        folder.cleanup()
        raise HTTPException(400, str(error)) from error
    except BaseException:
        folder.cleanup()
        raise
    return FileResponse(
        path,
        media_type=MEDIA_TYPES.get(path.suffix, "application/geopackage+sqlite3"),
        filename=path.name,
        headers=FOREVER,
        background=BackgroundTask(folder.cleanup),
    )


def _clip_layer(layer: Layer, store: ProductStore, bounds: BBox, where: tuple[Path, str]) -> Path:
    assert bounds is not None  # noqa: S101 - checked by the caller
    folder, form = where
    name = f"{layer.readable_name}_part"
    if layer.type == "raster":
        path = folder / f"{name}.tif"
        crop_raster(store.address(layer.ref), path, bounds)
        return path
    if layer.type != "vector":
        raise ProductError(
            f"{layer.id} is not a map but a {layer.type}: it can only be downloaded whole"
        )
    part = crop_features(read_features(store.path(layer.ref)), bounds)
    path = folder / f"{name}.{form}"
    if form == "gpkg":
        write_geopackage(path, part, str(layer.ref.kind))
    else:
        write_features(path, part.features, part.landing, tags=part.tags)
    return path


@router.get("/api/missions/{mission}/addresses", tags=["downloads"])
def addresses(
    mission: MissionName, services: ServicesOf, request: Request, response: Response
) -> list[Address]:
    """URLs of a mission's data that QGIS, GDAL and other programs open."""
    response.headers.update(REVALIDATE)
    entry = services.catalogue.mission(mission)
    root = str(request.base_url).rstrip("/")
    layers = [layer for layer in services.catalogue.layers(mission) if layer.type == "raster"]
    base = base_of(request, mission)
    return [*_services(root, base, entry.title), *_files(root, layers)]


def _services(root: str, base: str, title: str) -> Iterator[Address]:
    yield Address(
        title=f"{title}: all features",
        service="OGC API Features",
        url=base,
        program="qgis",
        how="Layer > Add Layer > Add WFS Layer > New, version OGC API - Features",
    )
    yield Address(
        title=f"{title}: all features",
        service="OGC API Features",
        url=f"OAPIF:{base}",
        program="gdal",
        how="ogrinfo OAPIF:...",
    )
    yield Address(
        title=f"{title}: all maps",
        service="WMTS",
        url=f"{base}/wmts/1.0.0/WMTSCapabilities.xml",
        program="qgis",
        how="Layer > Add Layer > Add WMS/WMTS Layer > New",
    )
    yield Address(
        title="All missions",
        service="STAC",
        url=f"{root}/stac/catalog.json",
        program="pystac",
        how="pystac.Catalog.from_file(...)",
    )


def _files(root: str, layers: list[Layer]) -> Iterator[Address]:
    for layer in layers:
        ref = layer.ref
        file = f"{layer.readable_name}{ref.kind.suffix}"
        address = f"{root}/download/{ref.scope.name}/{ref.kind}/{ref.digest}/{file}"
        yield Address(
            title=layer.full_title,
            service="Cloud Optimised GeoTIFF",
            url=f"/vsicurl/{address}",
            program="gdal",
            how="anywhere that takes the name of a raster file; QGIS: Data Source Manager > Raster",
        )


@router.get("/download/{scope}/{kind}/{digest}.gpkg", tags=["layers"], response_class=Response)
def geopackage(layer: LayerPath, services: ServicesOf) -> Response:
    """The features of a layer as a GeoPackage in metres of the local map."""
    if layer.type != "vector":
        raise ProductNotFoundError(f"{layer.id} is a raster: download it as GeoTIFF")
    collection = read_features(services.store.path(layer.ref))
    if not collection.features:
        raise ProductNotFoundError(f"{layer.id} has no feature that a GeoPackage could hold")
    name = f"{layer.readable_name}.gpkg"
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        write_geopackage(path, collection, str(layer.ref.kind))
        body = path.read_bytes()
    disposition = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(
        body, headers={**FOREVER, **disposition}, media_type="application/geopackage+sqlite3"
    )


@router.get("/download/{scope}/{kind}/{digest}", tags=["layers"], response_class=FileResponse)
def download(layer: LayerPath, services: ServicesOf, request: Request) -> Response:
    """The layer's file, whole or by ranges: GeoTIFF in the local CRS, GeoJSON in Mars degrees."""
    suffix = layer.ref.kind.suffix
    media_type = MEDIA_TYPES.get(suffix, "application/octet-stream")
    name = f"{layer.readable_name}{suffix}"
    return product_response(layer.ref, services.store, request, media_type, name)


@router.get(
    "/download/{scope}/{kind}/{digest}/{file}", tags=["layers"], response_class=FileResponse
)
def named_download(
    layer: LayerPath, file: ImageName, services: ServicesOf, request: Request
) -> Response:
    """The layer's file under its readable name, which QGIS and GDAL show as the layer's.

    The name is that of the download, `MER2_sol0156_site010_drive0100_dtm_4cm.tif`.
    """
    name = f"{layer.readable_name}{layer.ref.kind.suffix}"
    if file != name:
        raise ProductNotFoundError(f"{layer.id} has no file {file}; it has {name}")
    return download(layer, services, request)


@router.get("/stac/catalog.json", tags=["stac"])
def catalogue(services: ServicesOf) -> JSONResponse:
    """The missions of the store as a STAC catalogue."""
    return _document("catalog.json", services, "application/json")


@router.get("/stac/{mission}/collection.json", tags=["stac"])
def collection(mission: MissionName, services: ServicesOf) -> JSONResponse:
    """The layers of a mission as a STAC collection."""
    return _document(f"{mission}/collection.json", services, "application/json")


@router.get("/stac/{mission}/{item}.json", tags=["stac"])
def item(mission: MissionName, item: ItemName, services: ServicesOf) -> JSONResponse:
    """A layer as a STAC item, with its files."""
    return _document(f"{mission}/{item}.json", services, "application/geo+json")


@router.get("/products/{kind}/{scope}/{digest}.provenance.json", tags=["stac"])
def provenance(layer: LayerPath, services: ServicesOf) -> dict[str, Any]:
    """Provenance of the file of a STAC item."""
    return services.store.provenance(layer.ref)


@router.get(
    "/products/{kind}/{scope}/{digest}.{suffix}", tags=["stac"], response_class=FileResponse
)
def file(
    layer: LayerPath, digest: Digest, suffix: Suffix, services: ServicesOf, request: Request
) -> Response:
    """The file of a STAC item, whole or by ranges."""
    suffix_of_kind = layer.ref.kind.suffix
    if suffix != suffix_of_kind.removeprefix("."):
        raise ProductNotFoundError(f"{layer.id} is a {suffix_of_kind}: {digest}{suffix_of_kind}")
    media_type = MEDIA_TYPES.get(suffix_of_kind, "application/octet-stream")
    return product_response(layer.ref, services.store, request, media_type)


def _document(name: str, services: Services, media_type: str) -> JSONResponse:
    body = services.store.document(f"{FOLDER}/{name}")
    if body is None:
        raise ProductNotFoundError(f"the STAC catalogue has no {name}; publishing writes it")
    return JSONResponse(json.loads(body), headers=REVALIDATE, media_type=media_type)
