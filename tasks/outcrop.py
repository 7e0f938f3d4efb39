"""Rocks and outcrops as pairs see them: models with the pairs' own images, and strike and dip."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.terrain.measure.facets import Facet, FacetParams, find_facets
from solmap.photogrammetry.terrain.mesh.view_mesh import ViewModelParams, view_meshes
from solmap.products.crs import LandingPoint
from solmap.products.formats.mesh.gltf import Encoding, write_glb
from solmap.products.formats.mesh.models import notes_of
from solmap.products.formats.vector.geojson import Feature, write_features
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.scopes import stop_scope
from solmap.tasks.stage import stage
from solmap.tasks.views import OrientedPair, inputs_of, read_views


@stage(task_run_name="view-model-{stop}")
def model_views(
    stop: StopId,
    pairs: tuple[OrientedPair, ...],
    params: ViewModelParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Model what the pairs of a stop see, wearing their own images."""
    recipe = _recipe(ProductKind.VIEW_MODEL, stop, pairs, (params, landing))

    def write(path: Path) -> None:
        meshes = view_meshes(read_views(pairs, store), params)
        middle = np.median(np.concatenate([one.mesh.points for one in meshes]), axis=0)
        east, north, up = (float(round(along)) for along in middle)
        notes = {"tolerance_px": params.tolerance_px, **notes_of(recipe, landing)}
        glb = write_glb(
            meshes,
            (east, north, up),
            encoding=Encoding.DRACO if params.draco else Encoding.QUANTISED,
            jpeg_quality=params.jpeg_quality,
            notes=notes,
        )
        path.write_bytes(glb)

    return store.make(recipe, write)


@stage(task_run_name="dips-{stop}")
def map_dips(
    stop: StopId,
    pairs: tuple[OrientedPair, ...],
    params: FacetParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Map strike and dip of the planar facets that the pairs of a stop see."""

    def write(path: Path) -> None:
        facets = [facet for view in read_views(pairs, store) for facet in find_facets(view, params)]
        write_features(path, [feature_of(facet) for facet in facets], landing)

    return store.make(_recipe(ProductKind.DIPS, stop, pairs, (params, landing)), write)


def _recipe(
    kind: ProductKind, stop: StopId, pairs: tuple[OrientedPair, ...], params: tuple[object, ...]
) -> Recipe:
    orientations = tuple(pair.orientation for pair in pairs)
    return Recipe(kind, stop_scope(stop), inputs_of(pairs), (*params, orientations))


def feature_of(facet: Facet) -> Feature:
    """A facet as a point on the map, with what a geologist writes down."""
    found, plane = facet.attitude, facet.plane
    return Feature(
        "Point",
        plane.centre[None, :],
        {
            "strike_deg": _degrees(found.strike),
            "dip_deg": _degrees(found.dip),
            "dip_direction_deg": _degrees(found.dip_direction),
            "sigma_strike_deg": _degrees(found.sigma_strike),
            "sigma_dip_deg": _degrees(found.sigma_dip),
            "length_m": round(facet.length_m, 3),
            "width_m": round(facet.width_m, 3),
            "distance_m": round(facet.distance_m, 2),
            "rms_m": round(plane.rms_m, 4),
            "sigma0": round(plane.sigma0, 2),
            "points": plane.points,
            "pair": facet.pair_id,
        },
    )


def _degrees(radians: float) -> float:
    return round(float(np.degrees(radians)), 2)
