"""Publish: turn products into layers and move the catalogue's pointers, all at once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from prefect import task
from prefect.cache_policies import NO_CACHE

from products.catalogue import MissionEntry, Outcome
from products.model import Layer, ProductKind, ProductRef
from products.raster import summarise
from products.vector import read_features
from products.workspace import Workspace

TITLES = {
    ProductKind.DTM: "Elevation",
    ProductKind.ORTHOPHOTO: "Orthophoto",
    ProductKind.SLOPE: "Slope",
    ProductKind.ASPECT: "Aspect",
    ProductKind.HILLSHADE: "Hillshade",
    ProductKind.CONTOURS: "Contours",
    ProductKind.FAR_DTM: "Far elevation",
    ProductKind.FAR_HILLSHADE: "Far hillshade",
    ProductKind.FAR_CONTOURS: "Far contours",
    ProductKind.TRAVERSE: "Traverse",
    ProductKind.STOPS: "Stops",
    ProductKind.FOOTPRINTS: "Image footprints",
    ProductKind.POINTING: "Pointing lines",
    ProductKind.TIE_POINTS: "Tie points",
}
RASTERS = {
    ProductKind.DTM,
    ProductKind.ORTHOPHOTO,
    ProductKind.SLOPE,
    ProductKind.ASPECT,
    ProductKind.HILLSHADE,
    ProductKind.FAR_DTM,
    ProductKind.FAR_HILLSHADE,
}


@task(cache_policy=NO_CACHE, task_run_name="publish")
def publish(
    mission: MissionEntry,
    layers: Sequence[tuple[ProductRef, tuple[int, ...]]],
    pointers: Iterable[ProductRef],
    outcomes: Iterable[Outcome],
    workspace: Workspace,
) -> list[Layer]:
    """Publish products with the sols that they show; readers see all of it or nothing."""
    described = [layer_of(mission.mission, ref, sols, workspace) for ref, sols in layers]
    workspace.catalogue.publish(
        missions=[mission], layers=described, pointers=pointers, outcomes=outcomes
    )
    return described


def layer_of(mission: str, ref: ProductRef, sols: tuple[int, ...], workspace: Workspace) -> Layer:
    """What the map needs to know of a product."""
    path = workspace.store.path(ref)
    if ref.kind in RASTERS:
        grid, bands = summarise(path)
        bounds, cell_m = grid.bounds, grid.cell_m
        unit, value_range = bands[0].unit or None, bands[0].range
    else:
        bounds = read_features(path).bounds or (0.0, 0.0, 0.0, 0.0)
        cell_m, unit, value_range = None, None, None
    return Layer(
        ref=ref,
        mission=mission,
        title=TITLES[ref.kind],
        type="raster" if ref.kind in RASTERS else "vector",
        bounds=bounds,
        cell_m=cell_m,
        unit=unit,
        range=value_range,
        sols=sols,
        made_at=workspace.store.made_at(ref),
    )
