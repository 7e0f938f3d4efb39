"""Orbital images: registered to the rover's map, and drawn as base layer of the map."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from solmap.photogrammetry.orbital.elevations import register_elevations
from solmap.photogrammetry.orbital.ground_map import ground_map
from solmap.photogrammetry.orbital.records import (
    Correction,
    OrbitalDtm,
    OrbitalImage,
    Registration,
)
from solmap.photogrammetry.orbital.registration import RegistrationParams, draw_corrected, register
from solmap.photogrammetry.terrain.dtm.grid import FINEST_CELL_M, Bounds, MapGrid, union
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.errors import ProductError
from solmap.products.formats.documents.archives import finite
from solmap.products.formats.raster.orthophoto import write_orthophoto
from solmap.products.formats.raster.raster import bounds_on_map, read_onto_grid
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.products.store.user_files import open_user_file
from solmap.tasks.images.files import ContentDigest
from solmap.tasks.maps.tags import raster_tags
from solmap.tasks.scopes import file_scope, region_scope
from solmap.tasks.stage import stage

MARGIN_M = 500.0
"""Margin of an orbital image around the mapped ground: ground ahead, and a horizon."""


@dataclass(frozen=True, slots=True)
class StopMap:
    """Data of a mapped stop for registration."""

    dtm: ProductRef
    orthophoto: ProductRef


@dataclass(frozen=True, slots=True)
class RegisteredImage:
    """An orbital image, and the result of registering it to all mapped ground."""

    image: ProductRef
    registration: ProductRef


@dataclass(frozen=True, slots=True)
class RegistrationMethod:
    """How an orbital image is compared with the rover's map."""

    registration: RegistrationParams = field(default_factory=RegistrationParams)
    heights: bool = False
    """Whether it is a terrain model, whose heights are compared."""

    @property
    def settings(self) -> tuple[RegistrationParams | str, ...]:
        """The settings on which a recipe depends."""
        return (self.registration, *(("heights",) if self.heights else ()))


@dataclass(frozen=True, slots=True)
class AssumedOrigin:
    """Approximate position of the origin of a map that is not tied to the lander."""

    lander: LandingPoint
    place_m: tuple[float, float]
    """(east, north) on the lander's map."""


@dataclass(frozen=True, slots=True)
class FoundOrigin:
    """Position of the origin of a map by an orbital image, if determined."""

    registration: Registration
    place_m: tuple[float, float]
    """(east, north) on the lander's map, if the image is correct."""
    sigma_m: float
    """Standard deviation of each coordinate, within the image."""


def find_origin(
    image: ProductRef,
    stops: Sequence[StopMap],
    params: RegistrationMethod,
    landing: LandingPoint,
    origin: AssumedOrigin,
    store: ProductStore,
) -> FoundOrigin:
    """Locate a map that is not tied to the lander in an orbital image.

    It is searched within the reach of the search about `origin`. Only the position of the map's
    middle is used, because the rover's north is more accurate.
    """
    found, _ = find_registration(image, stops, params, landing, store, origin)
    if found.correction is None:
        return FoundOrigin(found, origin.place_m, math.nan)
    crs = local_crs(landing)
    west, south, east, north = union(
        [bounds_on_map(store.path(stop.dtm), crs)[0] for stop in stops]
    )
    middle = np.array([[(west + east) / 2, (south + north) / 2]])
    moved = (found.correction.apply_inverse(middle) - middle)[0] + origin.place_m
    return FoundOrigin(found, (float(moved[0]), float(moved[1])), max(found.correction.sigma_m))


def take_orbital(file: Path, store: ProductStore) -> ProductRef:
    """Store an orbital image unchanged."""
    scope = file_scope(file.name)
    with open_user_file(file) as opened:
        digest = hashlib.file_digest(opened, "sha256").hexdigest()
        recipe = Recipe(ProductKind.ORBITAL_IMAGE, scope, params=ContentDigest(digest))

        def write(path: Path) -> None:
            opened.seek(0)
            with path.open("wb") as draft:
                shutil.copyfileobj(opened, draft)

        return store.make(recipe, write)


@stage(task_run_name="register-{image.scope}")
def register_orbital(
    image: ProductRef,
    stops: Sequence[StopMap],
    params: RegistrationMethod,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Locate an orbital image, or terrain model, on the maps of the stops."""
    inputs = (image, *(ref for stop in stops for ref in (stop.dtm, stop.orthophoto)))
    settings = (*params.settings, landing)
    recipe = Recipe(ProductKind.ORBITAL_REGISTRATION, image.scope, inputs, settings)

    def write(path: Path) -> None:
        found, cell_m = find_registration(image, stops, params, landing, store)
        document = {
            "explained": found.explained,
            "runner_up": found.runner_up,
            "halves_apart_m": finite(found.halves_apart_m),
            "reason": found.reason,
            "cell_m": cell_m,
            "correction": _document(found.correction),
        }
        path.write_text(json.dumps(document))

    return store.make(recipe, write)


def find_registration(
    image: ProductRef,
    stops: Sequence[StopMap],
    params: RegistrationMethod,
    landing: LandingPoint,
    store: ProductStore,
    start: Correction | AssumedOrigin | None = None,
) -> tuple[Registration, float]:
    """The registration of an image to the map of some stops, and the side of its cells.

    With the correction of a larger map as `start` the search is limited to its neighbourhood; for a
    map that is not tied to the lander, it starts at the assumed position.
    """
    origin = start if isinstance(start, AssumedOrigin) else None
    crs = local_crs(landing)
    image_crs = local_crs(origin.lander) if origin else crs
    off = origin.place_m if origin else (0.0, 0.0)
    dtms = [store.path(stop.dtm) for stop in stops]
    bounds = union([bounds_on_map(dtm, crs)[0] for dtm in dtms])
    on_mars, cell_m = bounds_on_map(store.path(image), image_crs)
    claimed = on_mars[0] - off[0], on_mars[1] - off[1], on_mars[2] - off[0], on_mars[3] - off[1]
    grid = grid_around(bounds, cell_m)
    ground = ground_map(
        grid,
        (read_onto_grid(dtm, grid, crs) for dtm in dtms),
        (read_onto_grid(store.path(stop.orthophoto), grid, crs) for stop in stops),
    )
    search, around = params.registration.search, bounds
    if isinstance(start, Correction):
        middle = np.array([[(bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2]])
        east, north = (start.apply_inverse(middle) - middle)[0].tolist()
        search, around = search.near((east, north)), _carried(bounds, start.apply_inverse)
    shown = grid_around(_widen(around, 2 * search.reach_m, claimed), cell_m)
    read = replace(shown, west=shown.west + off[0], north=shown.north + off[1])
    values = read_onto_grid(store.path(image), read, image_crs)
    registration = RegistrationParams(search)
    if params.heights:
        return register_elevations(ground, OrbitalDtm(shown, values), registration), cell_m
    return register(ground, OrbitalImage(shown, values), registration), cell_m


def _carried(bounds: Bounds, carry: Callable[[np.ndarray], np.ndarray]) -> Bounds:
    """Bounds around the transformed corners of others."""
    west, south, east, north = bounds
    corners = carry(np.array([[west, south], [west, north], [east, south], [east, north]]))
    (left, low), (right, top) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return left, low, right, top


@stage(task_run_name="base-{image.scope}")
def draw_base(
    mission: str,
    image: ProductRef,
    registration: ProductRef | None,
    mapped: Bounds,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Draw an orbital image around the mapped ground, at its corrected or stated position."""
    inputs = (image,) if registration is None else (image, registration)
    params = landing, [*mapped], MARGIN_M
    recipe = Recipe(ProductKind.ORBITAL, region_scope(mission), inputs, params)

    def write(path: Path) -> None:
        crs = local_crs(landing)
        correction = None if registration is None else read_correction(registration, store)
        claimed, cell_m = bounds_on_map(store.path(image), crs)
        bounds = _widen(
            mapped, MARGIN_M, _carried(claimed, correction.apply) if correction else claimed
        )
        read = _carried(bounds, correction.apply_inverse) if correction else bounds
        shown = grid_around(_widen(read, 0.0, claimed), cell_m)
        level = max(0, math.floor(math.log2(cell_m / FINEST_CELL_M)))
        grid = MapGrid.covering(bounds, FINEST_CELL_M * 2**level)
        source = OrbitalImage(shown, read_onto_grid(store.path(image), shown, crs))
        drawn = draw_corrected(source, grid, correction)
        write_orthophoto(path, grid, drawn, crs, tags=raster_tags(recipe, store))

    return store.make(recipe, write)


def read_registration(ref: ProductRef, store: ProductStore) -> dict[str, Any]:
    """Content of a registration, as plain JSON."""
    document: dict[str, Any] = json.loads(store.path(ref).read_text())
    return document


def read_correction(ref: ProductRef, store: ProductStore) -> Correction | None:
    """The correction of a registration, if it found one."""
    found = read_registration(ref, store)["correction"]
    if found is None:
        return None
    return Correction(
        found["east_m"],
        found["north_m"],
        found["rotation_deg"],
        (found["centre_m"][0], found["centre_m"][1]),
        np.array(found["covariance"]),
        found["scale"],
        found["up_m"],
        found["sigma_up_m"],
    )


def grid_around(bounds: Bounds, cell_m: float) -> MapGrid:
    """A grid of cells of any size around bounds."""
    west, south, east, north = bounds
    rows, cols = math.ceil((north - south) / cell_m), math.ceil((east - west) / cell_m)
    return MapGrid(west, north, cell_m, max(1, rows), max(1, cols))


def _document(correction: Correction | None) -> dict[str, Any] | None:
    if correction is None:
        return None
    fields = dataclasses.asdict(correction)
    return {**fields, "covariance": correction.covariance.tolist()}


def _widen(bounds: Bounds, margin_m: float, within: Bounds) -> Bounds:
    """Bounds with a margin, limited to the image."""
    west, south = (max(bounds[k] - margin_m, within[k]) for k in (0, 1))
    east, north = (min(bounds[k] + margin_m, within[k]) for k in (2, 3))
    if not (east > west and north > south):
        raise ProductError("the orbital image does not show the mapped ground")
    return west, south, east, north
