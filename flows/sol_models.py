"""Model the stops of a sol in three dimensions, and measure the planes of their rocks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from prefect.futures import PrefectFuture

from solmap.flows.outcomes import layers_by_first, settled
from solmap.flows.sol_inputs import SolInputs, SolReport
from solmap.flows.sol_maps import oriented_pairs
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.imagery import StopId
from solmap.products.model import ProductKind, ProductRef
from solmap.tasks.model3d import model_terrain, tile_terrain
from solmap.tasks.orientations import read_orientations
from solmap.tasks.outcrop import map_dips, model_views
from solmap.tasks.pairs import PairProducts
from solmap.tasks.points import make_points


def model_stops(
    inputs: SolInputs,
    orientations: ProductRef,
    matched: Mapping[StopId, list[PairProducts]],
    mapped: Mapping[StopId, list[ProductRef]],
    report: SolReport,
) -> dict[StopId, list[ProductRef]]:
    """Models of every stop that has been mapped, and of what its pairs see."""
    wanted, store, landing = inputs.config.models, inputs.workspace.store, inputs.landing
    poses = read_orientations(orientations, store, [str(stop) for stop in mapped])
    futures: dict[tuple[StopId, str], PrefectFuture[Any]] = {}
    for stop, layers in mapped.items():
        of = {ref.kind: ref for ref in layers}
        ground = of.get(ProductKind.DTM), of.get(ProductKind.ORTHOPHOTO)
        if ground[0] and ground[1] and wanted.of_terrain:
            terrain = (ground[0], ground[1])
            futures[stop, "model"] = model_terrain.submit(*terrain, wanted.terrain, landing, store)
            futures[stop, "3D tiles"] = tile_terrain.submit(*terrain, wanted.tiles, landing, store)
        pairs = oriented_pairs(matched[stop], poses.get(str(stop)))
        if wanted.of_views:
            futures[stop, "model of what pairs see"] = model_views.submit(
                stop, pairs, wanted.views, landing, store
            )
        if wanted.of_points:
            futures[stop, "points"] = make_points.submit(stop, pairs, wanted.points, landing, store)
        if wanted.dips_of_facets:
            futures[stop, "dips"] = map_dips.submit(stop, pairs, wanted.facets, landing, store)
    done, failed = settled(f"sol {report.sol}: model the stops", futures)
    causes = {f"{kind} of {stop}": cause for (stop, kind), cause in failed.items()}
    report.tell("model", causes, "no", TerrainError)
    return layers_by_first(done)
