"""Contours of a terrain model."""

from __future__ import annotations

from pathlib import Path

from photogrammetry.terrain.contours import ContourParams
from photogrammetry.terrain.contours import trace_contours as trace
from products.contour_features import contour_feature
from products.crs import LandingPoint
from products.model import ProductKind, ProductRef, Recipe
from products.raster import read_dtm
from products.store import ProductStore
from products.vector import write_features
from tasks.stage import stage


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
