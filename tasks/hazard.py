"""Hazard: where a rover may stand, and what keeps it away."""

from __future__ import annotations

from pathlib import Path

from solmap.photogrammetry.terrain.traversability.hazard import HazardParams, hazards
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.raster import HAZARD_CLASSES, read_dtm, write_classes
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.products.store.provenance import provenance_tags
from solmap.tasks.stage import stage


@stage(task_run_name="hazard-{dtm.kind}-{dtm.scope}")
def map_hazards(
    dtm: ProductRef, params: HazardParams, landing: LandingPoint, store: ProductStore
) -> ProductRef:
    """Map steps, slopes and roughness that a rover of these limits does not take."""
    recipe = Recipe(dtm.mapped_as(ProductKind.HAZARD), dtm.scope, (dtm,), (params, landing))

    def write(path: Path) -> None:
        codes, grid = hazards(read_dtm(store.path(dtm)), params)
        tags = provenance_tags(recipe)
        write_classes(
            path, grid, codes, local_crs(landing), name="hazard", classes=HAZARD_CLASSES, tags=tags
        )

    return store.make(recipe, write)
