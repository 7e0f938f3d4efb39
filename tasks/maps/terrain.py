"""The terrain model of a stop and its derivatives: contours, slope, aspect, hillshade, preview."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.parts import Window
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams
from solmap.photogrammetry.terrain.dtm.stop_dtm import build_dtm as model_terrain
from solmap.photogrammetry.terrain.relief.contours import ContourParams, trace_terrain
from solmap.photogrammetry.terrain.relief.slope import (
    HillshadeParams,
    Relief,
    SlopeParams,
    aspect_of,
    hillshade_parts,
    northerly_tilt_of,
    relief_parts,
    slope_of,
)
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.raster import write_dtm, write_parts
from solmap.products.formats.vector.geojson import contour_feature, write_features
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.reports.terrain_figures import class_figure, relief_figure
from solmap.products.store.product_store import ProductStore
from solmap.tasks.maps.dtms import read_stop_dtm, terrain_of
from solmap.tasks.maps.tags import raster_tags
from solmap.tasks.network.orientations import OrientedPair, inputs_of, read_views
from solmap.tasks.network.previews import write_preview
from solmap.tasks.scopes import stop_scope
from solmap.tasks.stage import stage

Bands = Mapping[str, Raster]
RELIEF: Mapping[ProductKind, tuple[Mapping[str, str], Callable[[Relief], Bands]]] = {
    ProductKind.SLOPE: (
        {"slope": "degree", "standard_deviation": "degree"},
        lambda r: {"slope": slope_of(r.normal), "standard_deviation": r.slope_sigma_deg},
    ),
    ProductKind.ASPECT: ({"aspect": "degree"}, lambda r: {"aspect": aspect_of(r.normal)}),
    ProductKind.NORTHERLY_TILT: (
        {"northerly_tilt": "degree"},
        lambda r: {"northerly_tilt": northerly_tilt_of(r.normal)},
    ),
    ProductKind.ROUGHNESS: ({"roughness": "m"}, lambda r: {"roughness": r.roughness_m}),
}
"""Maps derived from the planes over one baseline: kind, units of bands, and bands."""


@stage(task_run_name="dtm-{stop}")
def build_dtm(
    stop: StopId,
    pairs: tuple[OrientedPair, ...],
    params: DtmParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Build the terrain model of a stop."""
    orientations = tuple(pair.orientation for pair in pairs)
    recipe = Recipe(
        ProductKind.DTM, stop_scope(stop), inputs_of(pairs), (params, landing, orientations)
    )

    def write(path: Path) -> None:
        made = model_terrain(read_views(pairs, store, sigmas=True), params)
        write_dtm(path, made, local_crs(landing), tags=raster_tags(recipe, store))

    return store.make(recipe, write)


@stage(task_run_name="contours-{dtm.kind}-{dtm.scope}")
def trace_contours(
    dtm: ProductRef, params: ContourParams, landing: LandingPoint, store: ProductStore
) -> ProductRef:
    """Trace the contours of a terrain model."""

    def write(path: Path) -> None:
        with terrain_of(dtm, store) as terrain:
            contours = trace_terrain(terrain, params)
        write_features(path, map(contour_feature, contours), landing)

    kind = dtm.map_kind(ProductKind.CONTOURS)
    recipe = Recipe(kind, dtm.scope, (dtm,), (params, landing))
    return store.make(recipe, write)


@stage(task_run_name="relief-{dtm.kind}-{dtm.scope}")
def map_relief(
    dtm: ProductRef, params: SlopeParams, landing: LandingPoint, store: ProductStore
) -> tuple[ProductRef, ...]:
    """Map slope, aspect, northerly tilt and roughness."""

    @cache
    def fit_relief() -> tuple[list[tuple[Window, Relief]], MapGrid]:
        with terrain_of(dtm, store) as terrain:
            return relief_parts(terrain, params)

    def make_map(
        kind: ProductKind, units: Mapping[str, str], bands_of: Callable[[Relief], Bands]
    ) -> ProductRef:
        recipe = Recipe(dtm.map_kind(kind), dtm.scope, (dtm,), (params, landing))

        def write(path: Path) -> None:
            planes, grid = fit_relief()
            tags = {"BASELINE_M": f"{params.baseline_m:g}", **raster_tags(recipe, store)}
            parts = ((own, bands_of(part)) for own, part in planes)
            write_parts(path, grid, units, parts, local_crs(landing), tags)

        return store.make(recipe, write)

    return tuple(make_map(kind, *what) for kind, what in RELIEF.items())


@stage(task_run_name="hillshade-{dtm.kind}-{dtm.scope}")
def shade_relief(
    dtm: ProductRef, params: HillshadeParams, landing: LandingPoint, store: ProductStore
) -> ProductRef:
    """Map shaded relief."""
    recipe = Recipe(dtm.map_kind(ProductKind.HILLSHADE), dtm.scope, (dtm,), (params, landing))

    def write(path: Path) -> None:
        crs, tags = local_crs(landing), raster_tags(recipe, store)
        with terrain_of(dtm, store) as terrain:
            parts = ((own, {"hillshade": light}) for own, light in hillshade_parts(terrain, params))
            write_parts(path, terrain.grid, {"hillshade": ""}, parts, crs, tags)

    return store.make(recipe, write)


@stage(task_run_name="preview-{dtm.scope}")
def preview_terrain(dtm: ProductRef, store: ProductStore) -> ProductRef:
    """The relief of a terrain model, and the classes of its cells."""

    def write(path: Path) -> None:
        terrain = read_stop_dtm(dtm, store)
        figures = (relief_figure(terrain, HillshadeParams()), class_figure(terrain))
        write_preview(path, cv2.cvtColor(np.hstack(figures), cv2.COLOR_RGBA2BGRA))

    return store.make(Recipe(ProductKind.QUICKLOOK, dtm.scope, (dtm,)), write)
