"""Publish: turn products into layers and move the catalogue's pointers, in one transaction.

The STAC catalogue is then updated.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, Literal

from solmap.products.catalogue.catalogue import MissionEntry, Outcome
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, StoreFullError, cause_of
from solmap.products.features.mission_features import MissionFeatures
from solmap.products.formats.mesh.models import extent_of_model
from solmap.products.formats.raster.panorama import panorama_bounds
from solmap.products.formats.raster.raster import summarise
from solmap.products.formats.vector.geojson import read_placed
from solmap.products.model import Layer, ProductKind, ProductRef
from solmap.products.reports.stac import AcquisitionTimes, write_catalogue, write_items
from solmap.products.store.faults import is_disk_full, retry_transient
from solmap.products.store.product_store import ProductStore
from solmap.tasks.stage import stage

log = logging.getLogger(__name__)

TITLES = {
    ProductKind.DTM: "Elevation",
    ProductKind.ORTHOPHOTO: "Orthophoto",
    ProductKind.SOURCES: "Source images",
    ProductKind.COLOUR: "Colour orthophoto",
    ProductKind.SLOPE: "Slope",
    ProductKind.ASPECT: "Aspect",
    ProductKind.HILLSHADE: "Hillshade",
    ProductKind.NORTHERLY_TILT: "North-facing slope component",
    ProductKind.ROUGHNESS: "Roughness",
    ProductKind.INSOLATION: "Insolation",
    ProductKind.HAVENS: "Winter havens",
    ProductKind.VIEWSHED: "Viewshed",
    ProductKind.HAZARD: "Hazards to a rover",
    ProductKind.CONTOURS: "Contours",
    ProductKind.MODEL: "Model of the terrain",
    ProductKind.VIEW_MODEL: "Model of what pairs see",
    ProductKind.TILESET: "Terrain as 3D tiles",
    ProductKind.DIPS: "Strike and dip",
    ProductKind.POINTS: "Point cloud",
    ProductKind.POINT_TILES: "Point cloud as 3D tiles",
    ProductKind.PANORAMA: "Panorama",
    ProductKind.FAR_DTM: "Far elevation",
    ProductKind.FAR_HILLSHADE: "Far hillshade",
    ProductKind.FAR_CONTOURS: "Far contours",
    ProductKind.REGION_DTM: "Elevation of the region",
    ProductKind.REGION_ORTHOPHOTO: "Orthophoto of the region",
    ProductKind.REGION_SEAMS: "Inter-stop difference",
    ProductKind.REGION_HILLSHADE: "Hillshade of the region",
    ProductKind.REGION_SLOPE: "Slope of the region",
    ProductKind.REGION_ASPECT: "Aspect of the region",
    ProductKind.REGION_NORTHERLY_TILT: "North-facing slope component of the region",
    ProductKind.REGION_ROUGHNESS: "Roughness of the region",
    ProductKind.REGION_INSOLATION: "Insolation of the region",
    ProductKind.REGION_HAVENS: "Winter havens of the region",
    ProductKind.REGION_HAZARD: "Hazards of the region",
    ProductKind.REGION_CONTOURS: "Contours of the region",
    ProductKind.TRAVERSE: "Traverse",
    ProductKind.MISSION_TRAVERSE: "Mission traverse",
    ProductKind.MISSION_STOPS: "Mission stops",
    ProductKind.ORBITAL: "Orbital image",
    ProductKind.STOPS: "Stops",
    ProductKind.FOOTPRINTS: "Image footprints",
    ProductKind.POINTING: "Pointing lines",
    ProductKind.TIE_POINTS: "Tie points",
}
RASTERS = {
    ProductKind.DTM,
    ProductKind.ORTHOPHOTO,
    ProductKind.SOURCES,
    ProductKind.COLOUR,
    ProductKind.SLOPE,
    ProductKind.ASPECT,
    ProductKind.NORTHERLY_TILT,
    ProductKind.ROUGHNESS,
    ProductKind.INSOLATION,
    ProductKind.VIEWSHED,
    ProductKind.HAZARD,
    ProductKind.HILLSHADE,
    ProductKind.FAR_DTM,
    ProductKind.FAR_HILLSHADE,
    ProductKind.REGION_DTM,
    ProductKind.REGION_ORTHOPHOTO,
    ProductKind.REGION_SEAMS,
    ProductKind.REGION_HILLSHADE,
    ProductKind.REGION_SLOPE,
    ProductKind.REGION_ASPECT,
    ProductKind.REGION_NORTHERLY_TILT,
    ProductKind.REGION_ROUGHNESS,
    ProductKind.REGION_INSOLATION,
    ProductKind.REGION_HAZARD,
    ProductKind.ORBITAL,
}


MODELS = {
    ProductKind.MODEL,
    ProductKind.VIEW_MODEL,
    ProductKind.TILESET,
    ProductKind.POINTS,
    ProductKind.POINT_TILES,
}


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """Result of publishing."""

    layers: tuple[Layer, ...]
    failures: dict[str, str]
    """Products that could not be published, with the reasons."""

    def check(self) -> None:
        """Raise an error if anything is missing.

        Raises:
            ProductError: something is missing.
        """
        if self.failures:
            lines = [f"{what}: {cause}" for what, cause in self.failures.items()]
            raise ProductError("; ".join(lines))


@stage(task_run_name="publish", makes_products=False)
def publish(
    mission: MissionEntry,
    layers: Sequence[tuple[ProductRef, tuple[int, ...]]],
    pointers: Iterable[ProductRef],
    outcomes: Iterable[Outcome],
    workspace: Workspace,
    *,
    is_last: bool = True,
) -> Published:
    """Publish products with their sols; readers see all of it or nothing.

    A product that cannot be read is left out: what was published of its kind stays. Of several
    publications that belong together the STAC catalogue follows the last, which is all of them.
    """
    described: list[Layer] = []
    failures: dict[str, str] = {}
    for ref, sols in layers:
        describe = partial(layer_of, mission.mission, ref, sols, workspace)
        with _note_failure(failures, f"{ref.kind} of {ref.scope}", workspace):
            described.append(retry_transient(describe))
    workspace.catalogue.publish(
        missions=[mission], layers=described, pointers=pointers, outcomes=outcomes
    )
    if is_last:
        with _note_failure(failures, "STAC catalogue", workspace):
            retry_transient(lambda: update_stac(mission, described, workspace))
    _index(mission.mission, {layer.ref.kind for layer in described}, workspace)
    return Published(tuple(described), failures)


@contextmanager
def _note_failure(failures: dict[str, str], what: str, workspace: Workspace) -> Iterator[None]:
    """Continue after the block with the cause of its failure, except for a full disk."""
    try:
        yield
    except Exception as error:
        if isinstance(error, StoreFullError) or is_disk_full(workspace.store.root, error):
            raise
        failures[what] = cause_of(error, is_named=True)
        log.warning("%s could not be published: %s", what, failures[what], exc_info=error)


def withdraw(
    mission: MissionEntry,
    layers: Sequence[Layer],
    pointers: Sequence[ProductRef],
    workspace: Workspace,
) -> None:
    """Remove layers from the map and pointers from the catalogue, in one transaction."""
    if layers or pointers:
        workspace.catalogue.withdraw(layers, pointers)
    if layers:
        left = workspace.catalogue.layers(mission.mission)
        update_stac(mission, left[:1], workspace)


def _index(mission: str, kinds: Collection[ProductKind], workspace: Workspace) -> None:
    """Index the new features now, so that no request has to wait for it."""
    try:
        MissionFeatures.open(workspace.store, workspace.catalogue).fill(mission, kinds)
    except Exception as error:  # noqa: BLE001 - the server fills it on request
        log.warning("the index of features of %s is not up to date: %s", mission, cause_of(error))


def layer_of(mission: str, ref: ProductRef, sols: tuple[int, ...], workspace: Workspace) -> Layer:
    """The layer of a product, for the map."""
    return Layer(
        ref=ref,
        mission=mission,
        title=TITLES[ref.kind],
        type=_type_of(ref.kind),
        sols=sols,
        **_facts_of(ref, workspace.store),
    )


@lru_cache(maxsize=1024)  # a layer is published in its wave, and again with all of its sol
def _facts_of(ref: ProductRef, store: ProductStore) -> Mapping[str, Any]:
    """What a layer takes from its file."""
    path = store.path(ref)
    cell_m: float | None = None
    unit: str | None = None
    value_range: tuple[float, float] | None = None
    if ref.kind in RASTERS:
        grid, bands = summarise(path)
        bounds, cell_m = grid.bounds, grid.cell_m
        unit, value_range = bands[0].unit or None, bands[0].range
    elif ref.kind is ProductKind.PANORAMA:
        bounds, unit = panorama_bounds(path), "degree"
    elif ref.kind in MODELS:
        bounds, value_range = extent_of_model(path)
        unit = "m"
    else:
        bounds = read_placed(path).bounds or (0.0, 0.0, 0.0, 0.0)
    return {
        "bounds": bounds,
        "cell_m": cell_m,
        "unit": unit,
        "range": value_range,
        "made_at": store.made_at(ref),
    }


def _type_of(kind: ProductKind) -> Literal["raster", "vector", "model", "panorama"]:
    if kind in RASTERS:
        return "raster"
    if kind is ProductKind.PANORAMA:
        return "panorama"
    return "model" if kind in MODELS else "vector"


def update_stac(mission: MissionEntry, fresh: Sequence[Layer], workspace: Workspace) -> None:
    """Write the items of new layers, and the collection and catalogue with all latest ones."""
    if not fresh:
        return
    images, catalogue = workspace.catalogue.images(mission.mission), workspace.catalogue
    write_items(
        ((layer, AcquisitionTimes.of_images(layer, images)) for layer in fresh),
        mission,
        workspace.store,
    )
    times = [image.start_time for image in images]
    layers = catalogue.layers(mission.mission)
    write_catalogue(
        catalogue.missions(), layers, AcquisitionTimes.of(fresh[0], times), workspace.store
    )
