"""Downloads of parts, and the addresses of everything for other programs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

from fastapi import APIRouter, HTTPException, Query, Request, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel
from starlette.background import BackgroundTask

from solmap.gis_server.ogc.links import base_of
from solmap.gis_server.routes.layers import MEDIA_TYPES
from solmap.gis_server.routes.parameters import AGAIN, FOREVER, Bounds, LayerPath, MissionName
from solmap.gis_server.services import ServicesOf
from solmap.products.errors import OutsideCoverageError, ProductError, StoreAwayError
from solmap.products.formats.cutouts import clip_features, clip_raster
from solmap.products.formats.vector.geojson import read_features, write_features
from solmap.products.formats.vector.geopackage import write_geopackage
from solmap.products.model import Layer
from solmap.products.store.product_store import ProductStore

router = APIRouter(tags=["downloads"])
Program = Literal["gdal", "qgis", "pystac", "browser"]
VectorForm = Annotated[
    Literal["geojson", "gpkg"], Query(alias="f", description="of features; rasters are GeoTIFF")
]


class Address(BaseModel):
    """Something to copy into another program."""

    title: str
    service: str
    """What it is: `OGC API Features`, `WMTS`, `Cloud Optimised GeoTIFF` ..."""
    url: str
    """What to paste."""
    program: Program
    """A program that opens it so."""
    how: str
    """Where to paste it."""


@router.get("/download/{scope}/{kind}/{digest}/clip", response_class=FileResponse)
def clip(
    layer: LayerPath, services: ServicesOf, bounds: Bounds, form: VectorForm = "geojson"
) -> Response:
    """The part of a layer in a box: `bbox=west,south,east,north` in metres of the local map.

    Cells are handed out as they are stored, in the layer's own grid and CRS.
    """
    if bounds is None:
        raise HTTPException(400, "bbox=west,south,east,north in metres of the local map is missing")
    folder = TemporaryDirectory()
    try:
        path = _cut(layer, services.store, bounds, (Path(folder.name), form))
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


def _cut(layer: Layer, store: ProductStore, bounds: Bounds, where: tuple[Path, str]) -> Path:
    assert bounds is not None  # noqa: S101 - the caller has looked
    folder, form = where
    name = f"{layer.ref.scope.name}_{layer.ref.kind}_{layer.ref.digest}_part"
    if layer.type == "raster":
        path = folder / f"{name}.tif"
        clip_raster(store.address(layer.ref), path, bounds)
        return path
    if layer.type != "vector":
        raise ProductError(f"{layer.id} is no map but a {layer.type}: it is handed out whole")
    part = clip_features(read_features(store.path(layer.ref)), bounds)
    path = folder / f"{name}.{form}"
    if form == "gpkg":
        write_geopackage(path, part, str(layer.ref.kind))
    else:
        write_features(path, part.features, part.landing, tags=part.tags)
    return path


@router.get("/api/missions/{mission}/addresses")
def addresses(
    mission: MissionName, services: ServicesOf, request: Request, response: Response
) -> list[Address]:
    """Everything of a mission by addresses that QGIS, GDAL and others open."""
    response.headers.update(AGAIN)
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
        address = f"{root}/download/{ref.scope.name}/{ref.kind}/{ref.digest}"
        yield Address(
            title=f"{layer.title}, {ref.scope.name}",
            service="Cloud Optimised GeoTIFF",
            url=f"/vsicurl/{address}",
            program="gdal",
            how="anywhere that takes the name of a raster file; QGIS: Data Source Manager > Raster",
        )
