"""Orthophoto: a stop's images, seen from straight above."""

from __future__ import annotations

from pathlib import Path

from prefect import task
from prefect.cache_policies import NO_CACHE

from photogrammetry.terrain.orthophoto import OrthophotoParams
from photogrammetry.terrain.orthophoto import render_orthophoto as render
from products.crs import LandingPoint, local_crs
from products.model import ProductKind, ProductRef, Recipe
from products.raster import read_dtm, write_orthophoto
from products.store import ProductStore
from tasks.views import OrientedPair, inputs_of, read_views


@task(cache_policy=NO_CACHE, task_run_name="orthophoto-{dtm.scope}")
def render_orthophoto(
    dtm: ProductRef,
    pairs: tuple[OrientedPair, ...],
    params: OrthophotoParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Render the orthophoto of a terrain model from the images it was made from."""

    def write(path: Path) -> None:
        made = render(read_dtm(store.path(dtm)), read_views(pairs, store), params)
        write_orthophoto(path, made.grid, made.brightness, local_crs(landing), stretch=made.stretch)

    orientations = tuple(pair.orientation for pair in pairs)
    recipe = Recipe(
        ProductKind.ORTHOPHOTO, dtm.scope, (dtm, *inputs_of(pairs)), (params, landing, orientations)
    )
    return store.make(recipe, write)
