"""Suitability for a rover: insolation and winter havens, hazards, and the viewshed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from solmap.photogrammetry.mars import planetographic
from solmap.photogrammetry.terrain.insolation.maps import (
    Haven,
    HavenParams,
    Insolation,
    InsolationParams,
    winter_havens,
)
from solmap.photogrammetry.terrain.insolation.maps import insolation as insolation_of
from solmap.photogrammetry.terrain.traversability.hazard import HazardParams, hazards
from solmap.photogrammetry.terrain.visibility.viewshed import ViewshedParams, viewshed_of_stop
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.raster import (
    HAZARD_CLASSES,
    VISIBILITY_CLASSES,
    write_classes,
    write_raster,
)
from solmap.products.formats.vector.geojson import Feature, write_features
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.maps.dtms import read_stop_dtm, terrain_of
from solmap.tasks.maps.tags import raster_tags
from solmap.tasks.network.orientations import OrientedPair
from solmap.tasks.stage import stage


@stage(task_run_name="insolation-{dtm.kind}-{dtm.scope}")
def map_insolation(
    dtm: ProductRef,
    params: InsolationParams,
    havens: HavenParams,
    landing: LandingPoint,
    store: ProductStore,
) -> tuple[ProductRef, ProductRef]:
    """Map the insolation of every season, and outline winter havens."""
    latitude = planetographic(math.radians(landing.latitude))

    @cache
    def insolation() -> Insolation:
        with terrain_of(dtm, store) as terrain:
            return insolation_of(terrain, latitude, params)

    map_recipe = Recipe(dtm.map_kind(ProductKind.INSOLATION), dtm.scope, (dtm,), (params, landing))
    haven_recipe = Recipe(
        dtm.map_kind(ProductKind.HAVENS), dtm.scope, (dtm,), (params, havens, landing)
    )

    def write_map(path: Path) -> None:
        tags = {**_season_tags(insolation(), params), **raster_tags(map_recipe, store)}
        bands = _bands(insolation())
        units = dict.fromkeys(bands, "Wh/m2/sol") | {"sky_view": ""}
        write_raster(path, insolation().grid, bands, local_crs(landing), unit=units, tags=tags)

    def write_havens(path: Path) -> None:
        found = winter_havens(insolation(), latitude, havens)
        features = [_feature(number, haven) for number, haven in enumerate(found, start=1)]
        write_features(path, features, landing, tags=_season_tags(insolation(), params))

    return store.make(map_recipe, write_map), store.make(haven_recipe, write_havens)


def _bands(light: Insolation) -> dict[str, np.ndarray]:
    """A band for every season, `insolation_ls090`, and the visible fraction of the sky."""
    seasons = zip(light.seasons, light.received, strict=True)
    by_season = {f"insolation_ls{season.ls_deg:03.0f}": cells for season, cells in seasons}
    return {**by_season, "sky_view": light.sky}


def _season_tags(light: Insolation, params: InsolationParams) -> dict[str, str]:
    """Tags with the seasons, their sky, and the insolation of level ground."""
    return {
        "LS_DEG": " ".join(f"{season.ls_deg:g}" for season in light.seasons),
        "LEVEL_WH_M2": " ".join(f"{level:.1f}" for level in light.level),
        "OPTICAL_DEPTH": f"{params.optical_depth:g}",
    }


def _feature(number: int, haven: Haven) -> Feature:
    return Feature(
        "Polygon",
        haven.outline,
        {
            "area_m2": round(haven.area_m2, 2),
            "insolation_wh_m2": round(haven.insolation, 1),
            "over_level_ground": round(haven.gain, 3),
            "tilt_to_sun_deg": round(haven.tilt_to_sun_deg, 2),
            "slope_deg": round(haven.slope_deg, 2),
        },
        id=f"haven-{number}",
        holes=haven.holes,
    )


@stage(task_run_name="hazard-{dtm.kind}-{dtm.scope}")
def map_hazards(
    dtm: ProductRef, params: HazardParams, landing: LandingPoint, store: ProductStore
) -> ProductRef:
    """Map steps, slopes and roughness beyond the limits of a rover."""
    recipe = Recipe(dtm.map_kind(ProductKind.HAZARD), dtm.scope, (dtm,), (params, landing))

    def write(path: Path) -> None:
        with terrain_of(dtm, store) as terrain:
            codes, grid = hazards(terrain, params)
        tags = raster_tags(recipe, store)
        write_classes(
            path, grid, codes, local_crs(landing), name="hazard", classes=HAZARD_CLASSES, tags=tags
        )

    return store.make(recipe, write)


@dataclass(frozen=True, slots=True)
class Eye:
    """Position of a viewpoint, metres of the local map."""

    east: float
    north: float
    up: float
    """Elevation."""


def highest_camera(pairs: tuple[OrientedPair, ...]) -> Eye:
    """The highest left camera of a stop: that of the mast, as it was pointed."""
    places = [pair.orientation.translation_m for pair in pairs]
    north, east, down = min(places, key=lambda place: place[2])
    return Eye(round(east, 4), round(north, 4), round(-down, 4))


@stage(task_run_name="viewshed-{dtm.scope}")
def map_viewshed(
    dtm: ProductRef, eye: Eye, params: ViewshedParams, landing: LandingPoint, store: ProductStore
) -> ProductRef:
    """Map the ground visible from a viewpoint."""
    recipe = Recipe(dtm.map_kind(ProductKind.VIEWSHED), dtm.scope, (dtm,), (eye, params, landing))

    def write(path: Path) -> None:
        place = np.array([eye.east, eye.north, eye.up])
        seen, grid = viewshed_of_stop(read_stop_dtm(dtm, store), place, params)
        tags = {"EYE_EAST_NORTH_UP_M": f"{eye.east} {eye.north} {eye.up}"}
        tags |= {"TARGET_HEIGHT_M": f"{params.target_height_m:g}", **raster_tags(recipe, store)}
        crs = local_crs(landing)
        write_classes(path, grid, seen, crs, name="sight", classes=VISIBILITY_CLASSES, tags=tags)

    return store.make(recipe, write)
