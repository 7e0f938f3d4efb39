"""STAC: the latest products as a catalogue of plain files, for search by position and time.

    stac/catalog.json                                      all missions
    stac/<mission>/collection.json                         one mission
    stac/<mission>/<scope>-<kind>.json                     one layer: an item, at its latest version

Links are relative, so the folder of the store may be moved or served as it is. The catalogue is
beside the products; files are replaced atomically.

Items follow STAC 1.1 with the extensions projection 2.0, raster 1.1, processing 1.1, classification
2.0 and ssys 1.1 (the body of the coordinates). GeoJSON assumes the Earth; `ssys:targets` is Mars,
and `proj:wkt2` and `proj:transform` give the position of the cells on its map.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pystac
import rasterio
from pystac.extensions.classification import Classification, ClassificationExtension
from pystac.extensions.projection import ProjectionExtension
from pystac.extensions.raster import DataType, NoDataStrings, RasterBand, RasterExtension

from solmap.photogrammetry.archive.times import utc_of
from solmap.photogrammetry.arrays import PerPoint
from solmap.photogrammetry.terrain.dtm.grid import Bounds, union
from solmap.products.catalogue.catalogue import ImageEntry, MissionEntry
from solmap.products.crs import MARS, LandingPoint, local_crs, lon_lat
from solmap.products.formats.raster.raster import band_names, class_names, open_raster
from solmap.products.model import Layer, ScopeLevel
from solmap.products.store.product_store import ProductStore
from solmap.products.store.provenance import adjustment_id

PROCESSING = "https://stac-extensions.github.io/processing/v1.1.0/schema.json"
SOLAR_SYSTEM = "https://stac-extensions.github.io/ssys/v1.1.0/schema.json"
ON_MARS = {"ssys:targets": ["Mars"], "ssys:target_class": "planet"}
_MEDIA = {
    ".tif": pystac.MediaType.COG,
    ".geojson": pystac.MediaType.GEOJSON,
    ".glb": "model/gltf-binary",
}
_DECIMALS = 9
"""Decimals of degrees: 0.06 mm."""


@dataclass(frozen=True, slots=True)
class AcquisitionTimes:
    """When the images of a layer were taken."""

    first: datetime
    last: datetime

    @classmethod
    def of(cls, layer: Layer, times: Iterable[str | None]) -> AcquisitionTimes:
        """From the images' own times, UTC; the time of production if none has any."""
        known = sorted(moment for moment in map(utc_of, times) if moment is not None)
        made = datetime.fromisoformat(layer.made_at).replace(tzinfo=UTC)
        return cls(known[0], known[-1]) if known else cls(made, made)

    @classmethod
    def of_images(cls, layer: Layer, images: Iterable[ImageEntry]) -> AcquisitionTimes:
        """Times of the images of a layer: those of its sols and, where it has one, its stop."""
        of_stop = layer.ref.scope.level is ScopeLevel.STOP
        return cls.of(
            layer,
            (
                image.start_time
                for image in images
                if image.sol in layer.sols and (not of_stop or image.stop == layer.ref.scope.name)
            ),
        )


def item_of(
    layer: Layer, mission: MissionEntry, taken: AcquisitionTimes, store: ProductStore
) -> pystac.Item:
    """A layer as a STAC item; links and paths of files are relative to the item."""
    provenance = store.provenance(layer.ref)
    is_on_mars = any(layer.bounds) and not mission.landing.origin
    item = pystac.Item(
        id=item_id(layer),
        geometry=outline(layer.bounds, mission.landing) if is_on_mars else None,
        bbox=list(degrees(layer.bounds, mission.landing)) if is_on_mars else None,
        datetime=taken.first,
        start_datetime=taken.first,
        end_datetime=taken.last,
        properties={
            "title": layer.full_title,
            "created": layer.made_at.replace("+00:00", "Z"),
            "mission": layer.mission,
            **({"gsd": layer.cell_m} if layer.cell_m else {}),
            **({"description": mission.landing.name} if mission.landing.origin else {}),
            **(ON_MARS if mission.landing.is_on_mars else {}),
            **_processing(provenance, store, layer),
        },
        stac_extensions=[PROCESSING, *([SOLAR_SYSTEM] if mission.landing.is_on_mars else [])],
        collection=mission.mission,
    )
    _add_assets(item, layer)
    if layer.type == "raster":
        _describe_raster(item, store.path(layer.ref), mission.landing)
    elif layer.type == "vector":
        projection = ProjectionExtension.ext(item, add_if_missing=True)
        if mission.landing.origin:
            projection.apply(wkt2=local_crs(mission.landing).to_wkt(), bbox=list(layer.bounds))
        else:
            projection.apply(code=MARS)
    for rel, href in (
        ("root", "../catalog.json"),
        ("parent", "collection.json"),
        ("collection", "collection.json"),
    ):
        item.add_link(pystac.Link(rel, href, pystac.MediaType.JSON))
    return item


def item_id(layer: Layer) -> str:
    """The name of a layer's item, the same for all versions."""
    return f"{layer.ref.scope}-{layer.ref.kind}"


def _processing(provenance: dict[str, Any], store: ProductStore, layer: Layer) -> dict[str, object]:
    """Software, lineage and adjustment of a product."""
    recipe = provenance["recipe"]
    software, version = provenance["software"].split(" ", 1)
    return {
        "processing:software": {software: version},
        "processing:lineage": f"{layer.ref.kind} from {', '.join(recipe['inputs']) or 'nothing'}; "
        f"science version {recipe['science']}",
        "solmap:digest": layer.ref.digest,
        "solmap:adjustment": adjustment_id(layer.ref, store),
        "solmap:sols": list(layer.sols),
    }


def _add_assets(item: pystac.Item, layer: Layer) -> None:
    file = Path("../../products") / layer.ref.file_name
    media = _MEDIA.get(file.suffix, "application/octet-stream")
    item.add_asset("data", pystac.Asset(str(file), layer.title, media_type=media, roles=["data"]))
    notes = file.with_name(f"{layer.ref.digest}.provenance.json")
    item.add_asset(
        "provenance",
        pystac.Asset(
            str(notes), "How it was made", media_type=pystac.MediaType.JSON, roles=["metadata"]
        ),
    )


def _describe_raster(item: pystac.Item, path: Path, landing: LandingPoint) -> None:
    """Projection, bands and classes of a raster's file."""
    asset = item.assets["data"]
    with open_raster(path) as dataset:
        ProjectionExtension.ext(item, add_if_missing=True).apply(
            wkt2=local_crs(landing).to_wkt(),
            shape=[dataset.height, dataset.width],
            transform=list(dataset.transform)[:6],
            bbox=list(dataset.bounds),
        )
        RasterExtension.ext(asset, add_if_missing=True).bands = _bands(dataset)
        asset.extra_fields["bands"] = [{"name": name} for name in band_names(dataset)]
        classes = class_names(dataset)
        if classes:
            colours = dataset.colormap(1)
            ClassificationExtension.ext(asset, add_if_missing=True).classes = [
                Classification.create(
                    value, name=name, color_hint=bytes(colours[value][:3]).hex().upper()
                )
                for value, name in classes.items()
            ]


def _bands(dataset: rasterio.DatasetReader) -> list[RasterBand]:
    nodata = NoDataStrings.NAN if np.isnan(dataset.nodata) else dataset.nodata
    return [
        RasterBand.create(
            nodata=nodata,
            data_type=DataType(kind),
            unit=unit or None,
            scale=scale,
            offset=offset,
            spatial_resolution=dataset.transform.a,
        )
        for kind, unit, scale, offset in zip(
            dataset.dtypes, dataset.units, dataset.scales, dataset.offsets, strict=True
        )
    ]


def degrees(bounds: Bounds, landing: LandingPoint) -> Bounds:
    """(west, south, east, north) in planetocentric degrees of a box on the local map, metres."""
    corners = np.round(np.column_stack(lon_lat(landing, *_corners(bounds))), _DECIMALS)
    (west, south), (east, north) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return west, south, east, north


def outline(bounds: Bounds, landing: LandingPoint) -> dict[str, Any]:
    """The box as a GeoJSON polygon in planetocentric degrees."""
    ring = np.round(np.column_stack(lon_lat(landing, *_corners(bounds))), _DECIMALS).tolist()
    return {"type": "Polygon", "coordinates": [[*ring, ring[0]]]}


def _corners(bounds: Bounds) -> tuple[PerPoint, PerPoint]:
    west, south, east, north = bounds
    return np.array([west, east, east, west]), np.array([south, south, north, north])


FOLDER = "stac"
_WHOLE_BODY: Bounds = (-180.0, -90.0, 180.0, 90.0)
"""Extent of a map that is not tied to the lander: the format requires one."""


def write_items(
    layers: Iterable[tuple[Layer, AcquisitionTimes]], mission: MissionEntry, store: ProductStore
) -> None:
    """Write or replace the items of layers."""
    for layer, taken in layers:
        item = item_of(layer, mission, taken, store)
        document = item.to_dict(include_self_link=False, transform_hrefs=False)
        _write(f"{mission.mission}/{item.id}.json", document, store)


def write_catalogue(
    missions: Sequence[MissionEntry],
    layers: Sequence[Layer],
    taken: AcquisitionTimes,
    store: ProductStore,
) -> None:
    """Write the catalogue of all missions and the collection of the mission of these layers."""
    _write("catalog.json", catalogue_document(missions), store)
    name = layers[0].mission
    entry = next(mission for mission in missions if mission.mission == name)
    _write(f"{name}/collection.json", collection_document(entry, layers, taken), store)


def catalogue_document(missions: Sequence[MissionEntry]) -> dict[str, Any]:
    """The catalogue of all missions, `catalog.json`, as plain JSON."""
    catalogue = pystac.Catalog("solmap", "Maps made from the stereo images of rovers")
    catalogue.clear_links()
    catalogue.add_link(_link("root", "catalog.json"))
    for mission in missions:
        catalogue.add_link(_link("child", f"{mission.mission}/collection.json", mission.title))
    return catalogue.to_dict(include_self_link=False, transform_hrefs=False)


def collection_document(
    mission: MissionEntry, layers: Sequence[Layer], taken: AcquisitionTimes
) -> dict[str, Any]:
    """The collection of a mission, `collection.json`, as plain JSON.

    Args:
        mission: The mission.
        layers: The layers whose items are beside it; none: it is empty.
        taken: Times of the first and the last of all images.
    """
    collection = _collection(mission, layers, taken)
    return collection.to_dict(include_self_link=False, transform_hrefs=False)


def _collection(
    mission: MissionEntry, layers: Sequence[Layer], taken: AcquisitionTimes
) -> pystac.Collection:
    filled = [layer.bounds for layer in layers if any(layer.bounds)] or [(0.0, 0.0, 0.0, 0.0)]
    extent = union(degrees(bounds, mission.landing) for bounds in filled)
    if mission.landing.origin:
        extent = _WHOLE_BODY
    is_on_mars = mission.landing.is_on_mars
    collection = pystac.Collection(
        id=mission.mission,
        title=mission.title,
        description=(
            f"Latest maps of {mission.title}; positions are relative to {mission.landing.name} "
            f"({mission.landing.source})"
        ),
        extent=pystac.Extent(
            pystac.SpatialExtent([[*extent]]),
            pystac.TemporalExtent([[taken.first, taken.last]]),
        ),
        license="other",
        keywords=[*(["Mars"] if is_on_mars else []), "rover", "stereo", "terrain"],
        stac_extensions=[SOLAR_SYSTEM] if is_on_mars else [],
        extra_fields=dict(ON_MARS) if is_on_mars else {},
    )
    collection.clear_links()
    collection.add_link(_link("root", "../catalog.json"))
    collection.add_link(_link("parent", "../catalog.json"))
    for layer in layers:
        href = f"{item_id(layer)}.json"
        collection.add_link(pystac.Link("item", href, pystac.MediaType.GEOJSON, layer.full_title))
    return collection


def _link(rel: str, href: str, title: str | None = None) -> pystac.Link:
    return pystac.Link(rel, href, pystac.MediaType.JSON, title)


def _write(name: str, document: dict[str, Any], store: ProductStore) -> None:
    text = json.dumps(document, indent=1, ensure_ascii=False)
    store.write_document(f"{FOLDER}/{name}", text)
