"""DTM: the terrain that a stop's pairs see."""

from __future__ import annotations

from pathlib import Path

from photogrammetry.imagery import StopId
from photogrammetry.terrain.dtm import DtmParams
from photogrammetry.terrain.dtm import build_dtm as model_terrain
from products.crs import LandingPoint, local_crs
from products.model import ProductKind, ProductRef, Recipe
from products.provenance import provenance_tags
from products.raster import write_dtm
from products.store import ProductStore
from tasks.scopes import stop_scope
from tasks.stage import stage
from tasks.views import OrientedPair, inputs_of, read_views


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
