"""Slope, aspect and hillshade of a terrain model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from prefect import task
from prefect.cache_policies import NO_CACHE

from photogrammetry.arrays import Raster
from photogrammetry.terrain.records import Dtm
from photogrammetry.terrain.surface import HillshadeParams, SlopeParams, aspect, hillshade, slope
from products.crs import LandingPoint, local_crs
from products.model import ProductKind, ProductRef, Recipe
from products.raster import read_dtm, write_raster
from products.store import ProductStore

Params = SlopeParams | HillshadeParams


@task(cache_policy=NO_CACHE, task_run_name="slope-{dtm.scope}")
def map_slope(
    dtm: ProductRef, params: SlopeParams, landing: LandingPoint, store: ProductStore
) -> ProductRef:
    """Map the steepness of the ground, degrees."""
    return _mapped(
        ProductKind.SLOPE, "degree", lambda d: slope(d, params), dtm, params, landing, store
    )


@task(cache_policy=NO_CACHE, task_run_name="aspect-{dtm.scope}")
def map_aspect(
    dtm: ProductRef, params: SlopeParams, landing: LandingPoint, store: ProductStore
) -> ProductRef:
    """Map the azimuth that the ground falls towards, degrees clockwise from north."""
    return _mapped(
        ProductKind.ASPECT, "degree", lambda d: aspect(d, params), dtm, params, landing, store
    )


@task(cache_policy=NO_CACHE, task_run_name="hillshade-{dtm.kind}-{dtm.scope}")
def shade_relief(
    dtm: ProductRef, params: HillshadeParams, landing: LandingPoint, store: ProductStore
) -> ProductRef:
    """Shade the relief, for the eye."""
    return _mapped(
        ProductKind.HILLSHADE, "", lambda d: hillshade(d, params), dtm, params, landing, store
    )


def _mapped(  # noqa: PLR0913, PLR0917 - what the three tasks differ in, and their arguments
    kind: ProductKind,
    unit: str,
    compute: Callable[[Dtm], Raster],
    dtm: ProductRef,
    params: Params,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    def write(path: Path) -> None:
        terrain = read_dtm(store.path(dtm))
        write_raster(
            path, terrain.grid, {str(kind): compute(terrain)}, local_crs(landing), unit=unit
        )

    return store.make(Recipe(dtm.mapped_as(kind), dtm.scope, (dtm,), (params, landing)), write)
