"""Contours of a terrain model."""

from __future__ import annotations

from pathlib import Path

from solmap.photogrammetry.terrain.relief.contours import ContourParams
from solmap.photogrammetry.terrain.relief.contours import trace_contours as trace
from solmap.products.crs import LandingPoint
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.formats.vector.geojson import contour_feature, write_features
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.stage import stage


@stage(task_run_name="contours-{dtm.kind}-{dtm.scope}")
def trace_contours(
    dtm: ProductRef, params: ContourParams, landing: LandingPoint, store: ProductStore
) -> ProductRef:
    """Trace the contours of a terrain model."""

    def write(path: Path) -> None:
        terrain = read_dtm(store.path(dtm))
        contours = trace(terrain.elevation, terrain.grid, params)
        write_features(path, map(contour_feature, contours), landing)

    kind = dtm.mapped_as(ProductKind.CONTOURS)
    recipe = Recipe(kind, dtm.scope, (dtm,), (params, landing))
    return store.make(recipe, write)
