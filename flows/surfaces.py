"""The surfaces of a terrain model: what its ground means, whichever ground it is."""

from __future__ import annotations

from typing import Any

from prefect.futures import PrefectFuture

from solmap.config.pipeline import PipelineConfig
from solmap.photogrammetry.terrain.contours import ContourParams
from solmap.products.crs import LandingPoint
from solmap.products.model import ProductRef
from solmap.products.store.product_store import ProductStore
from solmap.tasks.contour import trace_contours
from solmap.tasks.hazard import map_hazards
from solmap.tasks.insolation import map_insolation
from solmap.tasks.slope import map_relief, shade_relief

Futures = dict[str, PrefectFuture[Any]]
"""By what is made: one product, or several at once."""


def submit_shape(
    terrain: ProductRef,
    contour: ContourParams,
    config: PipelineConfig,
    landing: LandingPoint,
    store: ProductStore,
) -> Futures:
    """What shows the shape of the ground to the eye: for any terrain model."""
    return {
        "hillshade": shade_relief.submit(terrain, config.hillshade, landing, store),
        "contours": trace_contours.submit(terrain, contour, landing, store),
    }


def submit_meaning(
    terrain: ProductRef, config: PipelineConfig, landing: LandingPoint, store: ProductStore
) -> Futures:
    """What the ground means to a rover on it: for terrain models as fine as a rover feels."""
    return {
        "relief": map_relief.submit(terrain, config.slope, landing, store),
        "insolation": map_insolation.submit(
            terrain, config.insolation, config.havens, landing, store
        ),
        "hazard": map_hazards.submit(terrain, config.hazard, landing, store),
    }
