"""Map the stops of a sol from their adjusted pairs."""

from __future__ import annotations

from typing import Any

from prefect.futures import PrefectFuture

from flows.outcomes import by_first, promised, settled
from flows.sol_inputs import SolInputs, SolReport
from photogrammetry.imagery import StopId
from products.model import ProductRef
from tasks.colour import colour_frames, render_colour
from tasks.contour import trace_contours
from tasks.dtm import build_dtm
from tasks.orientations import MappedStop, read_orientations
from tasks.orthophoto import render_orthophoto
from tasks.pairs import PairProducts
from tasks.quicklook import picture_terrain
from tasks.slope import map_aspect, map_slope, shade_relief
from tasks.views import OrientedPair

BOTH = "orthophoto and its sources"
"""Two layers of one task."""


def map_stops(
    inputs: SolInputs,
    orientations: ProductRef,
    matched: dict[StopId, list[PairProducts]],
    report: SolReport,
) -> dict[StopId, list[ProductRef]]:
    """Map every stop of the window from its adjusted pairs; what did not move is looked up."""
    config, store, landing = inputs.config, inputs.workspace.store, inputs.landing
    catalogue = inputs.workspace.catalogue
    mapped = read_orientations(orientations, store)
    futures: dict[tuple[StopId, str], PrefectFuture[Any]] = {}
    for stop, pairs in matched.items():
        oriented = oriented_pairs(pairs, mapped.get(str(stop)))
        if not oriented:
            continue
        dtm = build_dtm.submit(stop, oriented, config.dtm, landing, store)
        futures[stop, "dtm"] = dtm
        terrain = promised(dtm)
        futures[stop, BOTH] = render_orthophoto.submit(
            terrain, oriented, config.orthophoto, landing, store
        )
        frames = colour_frames(oriented, catalogue.images(stop=str(stop)), inputs.workspace)
        if frames:
            futures[stop, "colour"] = render_colour.submit(
                terrain, frames, config.orthophoto, landing, store
            )
        futures[stop, "contours"] = trace_contours.submit(terrain, config.contour, landing, store)
        futures[stop, "slope"] = map_slope.submit(terrain, config.slope, landing, store)
        futures[stop, "aspect"] = map_aspect.submit(terrain, config.slope, landing, store)
        futures[stop, "picture"] = picture_terrain.submit(terrain, store)
        futures[stop, "hillshade"] = shade_relief.submit(terrain, config.hillshade, landing, store)
    done, failed = settled(f"sol {report.sol}: map the stops", futures)
    report.blame("map", {f"{kind} of {stop}": cause for (stop, kind), cause in failed.items()})
    layers = by_first({key: ref for key, ref in done.items() if key[1] not in {"picture", BOTH}})
    for (stop, what), refs in done.items():
        if what == BOTH:
            layers.setdefault(stop, []).extend(refs)
    return layers


def oriented_pairs(
    pairs: list[PairProducts], mapped: MappedStop | None
) -> tuple[OrientedPair, ...]:
    """The pairs of a stop that the network has, looking from where the stop is mapped with them."""
    known = {o.pair_id: o for o in mapped.orientations} if mapped else {}
    return tuple(OrientedPair(p, known[p.files.id]) for p in pairs if p.files.id in known)
