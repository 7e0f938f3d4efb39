"""Region: the terrain models and orthophotos of stops merged, with the stops' disagreement."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.dtm.region_dtm import CELLS_ALONG_FAR, RegionParams
from solmap.photogrammetry.terrain.orthophoto.merging import MergingParams
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.raster import grid_of, open_raster
from solmap.products.formats.raster.region import (
    RegionFiles,
    RegionSource,
    read_seams,
    write_region,
)
from solmap.products.formats.raster.region_orthophoto import write_region_orthophoto
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.maps.tags import raster_tags
from solmap.tasks.scopes import part_scope
from solmap.tasks.stage import stage


@stage(task_run_name="region-{mission}")
def fuse_region(
    mission: str,
    stops: Sequence[ProductRef],
    params: RegionParams,
    landing: LandingPoint,
    store: ProductStore,
) -> tuple[ProductRef, ProductRef]:
    """Fuse the terrain models of stops; returns the region's model and the layer of its seams.

    Both are made in one pass over the stops and stored one after the other.
    """
    inputs = tuple(sorted(stops))
    scope = part_scope(mission, min(ref.scope for ref in inputs))
    model, seams = (
        Recipe(kind, scope, inputs, (params, CELLS_ALONG_FAR, landing))
        for kind in (ProductKind.REGION_DTM, ProductKind.REGION_SEAMS)
    )
    with TemporaryDirectory(prefix="solmap-region-") as scratch:

        @cache
        def fuse() -> RegionFiles:
            files = RegionFiles(Path(scratch) / "dtm.tif", Path(scratch) / "seams.tif")
            tags = (raster_tags(model, store), raster_tags(seams, store))
            write_region(files, _sources(inputs, store), params, local_crs(landing), tags)
            return files

        return (
            store.make(model, lambda path: _move(fuse().dtm, path)),
            store.make(seams, lambda path: _move(fuse().seams, path)),
        )


@stage(task_run_name="region-orthophoto-{dtm.scope}")
def merge_orthophotos(
    dtm: ProductRef,
    orthophotos: Sequence[ProductRef],
    params: MergingParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Merge the orthophotos of the stops of a region, whose terrain model is given."""
    inputs = tuple(sorted(orthophotos))
    recipe = Recipe(ProductKind.REGION_ORTHOPHOTO, dtm.scope, inputs, (params, landing))

    def write(path: Path) -> None:
        sources, tags = _sources(inputs, store), raster_tags(recipe, store)
        write_region_orthophoto(path, sources, params, local_crs(landing), tags)

    return store.make(recipe, write)


def _move(made: Path, path: Path) -> None:
    shutil.move(made, path)


def _sources(stops: Iterable[ProductRef], store: ProductStore) -> list[RegionSource]:
    return [RegionSource(str(ref.scope), _place(ref, store), store.path(ref)) for ref in stops]


def _place(ref: ProductRef, store: ProductStore) -> tuple[float, float]:
    """East and north of the cameras of a model; of its middle if unknown."""
    found = list(_translations(store.provenance(ref)["recipe"]["params"]))
    if not found:
        with open_raster(store.path(ref)) as dataset:
            west, south, east, north = grid_of(dataset).bounds
        return (west + east) / 2, (south + north) / 2
    east, north, _ = MAP_FROM_LSL @ np.mean(found, axis=0)
    return float(east), float(north)


def _translations(params: object) -> Iterable[list[float]]:
    """The positions of all orientations in the parameters of a recipe."""
    if isinstance(params, dict):
        if "translation_m" in params:
            yield params["translation_m"]
        params = list(params.values())
    if isinstance(params, list):
        for one in params:
            yield from _translations(one)


def seam_notes(seams: ProductRef, store: ProductStore) -> list[str]:
    """One line for every two stops with common ground: their disagreement."""
    stops, pairs = read_seams(store.path(seams))
    return [
        f"{stops[pair.stops[0]]} and {stops[pair.stops[1]]} disagree by {pair.median_m:.3f} m "
        f"(median; 90 %: {pair.p90_m:.3f} m), {pair.median_sigmas:.1f} of their sigmas "
        f"({pair.p90_sigmas:.1f}), over {pair.cells} cells"
        for pair in pairs
    ]
