"""DTM: the terrain that a stop's pairs see."""

from __future__ import annotations

from pathlib import Path

from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams
from solmap.photogrammetry.terrain.dtm.stop_dtm import build_dtm as model_terrain
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.raster import write_dtm
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.products.store.provenance import provenance_tags
from solmap.tasks.scopes import stop_scope
from solmap.tasks.stage import stage
from solmap.tasks.views import OrientedPair, inputs_of, read_views


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
        made = model_terrain(read_views(pairs, store), params)
        write_dtm(path, made, local_crs(landing), tags=provenance_tags(recipe))

    return store.make(recipe, write)
