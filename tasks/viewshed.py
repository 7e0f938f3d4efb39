"""Viewshed: the ground that a stop's own cameras can see."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solmap.photogrammetry.terrain.visibility.viewshed import ViewshedParams, viewshed_of_stop
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.raster import VISIBILITY_CLASSES, read_dtm, write_classes
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.products.store.provenance import provenance_tags
from solmap.tasks.stage import stage
from solmap.tasks.views import OrientedPair


@dataclass(frozen=True, slots=True)
class Eye:
    """Where is looked from, metres of the local map."""

    east: float
    north: float
    up: float
    """Elevation."""


def highest_camera(pairs: tuple[OrientedPair, ...]) -> Eye:
    """The left camera of a stop that stands highest: that of the mast, pointed as it was."""
    places = [pair.orientation.translation_m for pair in pairs]
    north, east, down = min(places, key=lambda place: place[2])
    return Eye(round(east, 4), round(north, 4), round(-down, 4))


@stage(task_run_name="viewshed-{dtm.scope}")
def map_viewshed(
    dtm: ProductRef, eye: Eye, params: ViewshedParams, landing: LandingPoint, store: ProductStore
) -> ProductRef:
    """Map what can be seen from an eye."""
    recipe = Recipe(dtm.mapped_as(ProductKind.VIEWSHED), dtm.scope, (dtm,), (eye, params, landing))

    def write(path: Path) -> None:
        place = np.array([eye.east, eye.north, eye.up])
        seen, grid = viewshed_of_stop(read_dtm(store.path(dtm)), place, params)
        tags = {"EYE_EAST_NORTH_UP_M": f"{eye.east} {eye.north} {eye.up}"}
        tags |= {"TARGET_HEIGHT_M": f"{params.target_height_m:g}", **provenance_tags(recipe)}
        crs = local_crs(landing)
        write_classes(path, grid, seen, crs, name="sight", classes=VISIBILITY_CLASSES, tags=tags)

    return store.make(recipe, write)
