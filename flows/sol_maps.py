"""Map the stops of a sol from their adjusted pairs."""

from __future__ import annotations

from flows.outcomes import promised, settled
from flows.sol_inputs import SolInputs, SolReport
from photogrammetry.imagery import StopId
from products.model import ProductRef
from tasks.adjust import read_network
from tasks.contour import trace_contours
from tasks.dtm import build_dtm
from tasks.orthophoto import render_orthophoto
from tasks.pairs import PairProducts
from tasks.quicklook import picture_terrain
from tasks.slope import map_aspect, map_slope, shade_relief
from tasks.views import Orientation, OrientedPair


def map_stops(
    inputs: SolInputs,
    network: ProductRef,
    matched: dict[StopId, list[PairProducts]],
    report: SolReport,
) -> dict[StopId, list[ProductRef]]:
    """Map every stop of the window from its adjusted pairs; unchanged ones are looked up."""
    config, store, landing = inputs.config, inputs.workspace.store, inputs.landing
    adjusted = {p.pair_id: p for p in read_network(network, store).adjusted.pairs}
    futures = {}
    for stop, pairs in matched.items():
        oriented = tuple(
            OrientedPair(pair, Orientation.of(adjusted[pair.files.id]))
            for pair in pairs
            if pair.files.id in adjusted
        )
        if not oriented:
            continue
        dtm = build_dtm.submit(stop, oriented, config.dtm, landing, store)
        futures[stop, "dtm"] = dtm
        terrain = promised(dtm)
        futures[stop, "orthophoto"] = render_orthophoto.submit(
            terrain, oriented, config.orthophoto, landing, store
        )
        futures[stop, "contours"] = trace_contours.submit(terrain, config.contour, landing, store)
        futures[stop, "slope"] = map_slope.submit(terrain, config.slope, landing, store)
        futures[stop, "aspect"] = map_aspect.submit(terrain, config.slope, landing, store)
        futures[stop, "picture"] = picture_terrain.submit(terrain, store)
        futures[stop, "hillshade"] = shade_relief.submit(terrain, config.hillshade, landing, store)
    done, failed = settled(f"sol {report.sol}: map the stops", futures)
    report.blame("map", {f"{kind} of {stop}": cause for (stop, kind), cause in failed.items()})
    made: dict[StopId, list[ProductRef]] = {}
    for (stop, kind), ref in done.items():
        if kind != "picture":
            made.setdefault(stop, []).append(ref)
    return made
