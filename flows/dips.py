"""Strike and dip on demand: of ground inside an outline, and of the rocks that pairs see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solmap.flows.runtime.run_record import beside_runs
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.planes import PlaneFit
from solmap.photogrammetry.terrain.measure.facets import FacetParams
from solmap.photogrammetry.terrain.measure.strike_dip import (
    Attitude,
    CellPlaneParams,
    attitude,
    plane_of_cells,
)
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.formats.vector.geojson import read_features
from solmap.products.model import ProductKind, ProductRef
from solmap.tasks.images.pairs import PairFiles, PairProducts, pairs_of
from solmap.tasks.maps.models import map_dips
from solmap.tasks.mission.publish import publish
from solmap.tasks.network.orientations import OrientedPair, orient_pairs, read_orientations
from solmap.tasks.scopes import pair_scope


@dataclass(frozen=True, slots=True)
class GroundDip:
    """The plane of a piece of ground."""

    plane: PlaneFit
    attitude: Attitude

    def row(self) -> dict[str, float]:
        """Strike, dip and position in degrees and metres."""
        found, plane = self.attitude, self.plane
        degrees = {
            "strike_deg": found.strike,
            "sigma_strike_deg": found.sigma_strike,
            "dip_deg": found.dip,
            "sigma_dip_deg": found.sigma_dip,
            "dip_direction_deg": found.dip_direction,
        }
        east, north, up = (round(float(along), 3) for along in plane.centre)
        return {
            **{name: round(float(np.degrees(angle)), 2) for name, angle in degrees.items()},
            "east": east,
            "north": north,
            "up": up,
            "rms_m": round(plane.rms_m, 4),
            "cells": plane.points,
        }


def dip_of_ground(
    stop: str,
    corners: Sequence[tuple[float, float]],
    params: CellPlaneParams,
    workspace: Workspace,
) -> GroundDip:
    """Strike and dip of a stop's ground inside an outline on the local map.

    Raises:
        ProductNotFoundError: the stop has no terrain model.
        TerrainError: no plane, or none with a strike, can be fitted there.
    """
    dtm = workspace.catalogue.layer(stop, ProductKind.DTM)
    terrain = read_dtm(workspace.store.path(dtm.ref))
    plane = plane_of_cells(terrain, np.array(corners, dtype=np.float64), params)
    return GroundDip(plane, attitude(plane))


@beside_runs
def dips_of_rocks(stop: str, params: FacetParams, workspace: Workspace) -> list[dict[str, object]]:
    """Publish strike and dip of the facets that a stop's pairs see as a layer.

    Raises:
        ProductNotFoundError: the stop has no adjusted pairs.
    """
    stop_id, pairs = _adjusted_pairs(stop, workspace)
    entry = workspace.catalogue.mission(workspace.catalogue.images(stop=stop)[0].mission)
    ref = map_dips.fn(stop_id, pairs, params, entry.landing, workspace.store)
    sols = tuple(sorted({pair.products.files.sol for pair in pairs}))
    publish.fn(entry, [(ref, sols)], (), (), workspace).check()
    collection = read_features(workspace.store.path(ref))
    return [
        {"east": float(f.points[0, 0]), "north": float(f.points[0, 1]), **f.properties}
        for f in collection.features
    ]


def _adjusted_pairs(stop: str, workspace: Workspace) -> tuple[StopId, tuple[OrientedPair, ...]]:
    """The pairs of a stop with their latest orientations."""
    catalogue, store = workspace.catalogue, workspace.store
    files = pairs_of(catalogue.images(stop=stop))
    if not files:
        known = sorted({image.stop for image in catalogue.images()})
        raise ProductNotFoundError(
            f"no stereo pairs of a stop {stop!r} are in the store; its stops are "
            f"{', '.join(known) or 'none'}"
        )
    matched = [made for pair in files if (made := _pair_products(pair, workspace))]
    for orientations in reversed(catalogue.pointers(ProductKind.ORIENTATIONS)):
        mapped = read_orientations(orientations, store, [stop]).get(stop)
        if mapped:
            return files[0].stop, orient_pairs(matched, mapped)
    raise ProductNotFoundError(f"{stop} has not been adjusted: run its sol first")


def _pair_products(pair: PairFiles, workspace: Workspace) -> PairProducts | None:
    """Matches of a pair; None if matching failed."""
    scope = pair_scope(pair.id)
    digests = [
        workspace.catalogue.latest(scope.name, kind)
        for kind in (ProductKind.MATCHES, ProductKind.PARALLAX)
    ]
    if digests[0] is None or digests[1] is None:
        return None
    return PairProducts(
        pair,
        ProductRef(ProductKind.MATCHES, scope, digests[0]),
        ProductRef(ProductKind.PARALLAX, scope, digests[1]),
    )
