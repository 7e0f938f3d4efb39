"""Map the stops of a sol from their adjusted pairs."""

from __future__ import annotations

from typing import Any

from prefect.futures import PrefectFuture

from solmap.flows.outcomes import layers_by_first, promised, settled
from solmap.flows.sol_inputs import SolInputs, SolReport
from solmap.flows.surfaces import submit_meaning, submit_shape
from solmap.photogrammetry.imagery import StopId
from solmap.products.model import ProductRef
from solmap.tasks.colour import colour_frames, render_colour
from solmap.tasks.dtm import build_dtm
from solmap.tasks.orientations import MappedStop, read_orientations
from solmap.tasks.orthophoto import render_orthophoto
from solmap.tasks.pairs import PairProducts
from solmap.tasks.quicklook import picture_terrain
from solmap.tasks.views import OrientedPair
from solmap.tasks.viewshed import highest_camera, map_viewshed

NO_LAYER = "picture"
"""What is made of a stop only to be looked at beside the products."""


def map_stops(
    inputs: SolInputs,
    orientations: ProductRef,
    matched: dict[StopId, list[PairProducts]],
    report: SolReport,
) -> dict[StopId, list[ProductRef]]:
    """Map every stop of the window from its adjusted pairs; what did not move is looked up."""
    mapped = read_orientations(
        orientations, inputs.workspace.store, [str(stop) for stop in matched]
    )
    futures: dict[tuple[StopId, str], PrefectFuture[Any]] = {}
    for stop, pairs in matched.items():
        oriented = oriented_pairs(pairs, mapped.get(str(stop)))
        if oriented:
            made = _submit_stop(stop, oriented, inputs)
            futures |= {(stop, what): future for what, future in made.items()}
    done, failed = settled(f"sol {report.sol}: map the stops", futures)
    report.blame("map", {f"{kind} of {stop}": cause for (stop, kind), cause in failed.items()})
    return layers_by_first({key: made for key, made in done.items() if key[1] != NO_LAYER})


def _submit_stop(
    stop: StopId, oriented: tuple[OrientedPair, ...], inputs: SolInputs
) -> dict[str, PrefectFuture[Any]]:
    """All maps of one stop, by what is made: one product, or several at once."""
    config, store, landing = inputs.config, inputs.workspace.store, inputs.landing
    dtm = build_dtm.submit(stop, oriented, config.dtm, landing, store)
    terrain = promised(dtm)
    futures: dict[str, PrefectFuture[Any]] = {
        "dtm": dtm,
        "orthophoto": render_orthophoto.submit(
            terrain, oriented, config.orthophoto, landing, store
        ),
        **submit_shape(terrain, config.contour, config, landing, store),
        **submit_meaning(terrain, config, landing, store),
        "viewshed": map_viewshed.submit(
            terrain, highest_camera(oriented), config.viewshed, landing, store
        ),
        NO_LAYER: picture_terrain.submit(terrain, store),
    }
    images = inputs.workspace.catalogue.images(stop=str(stop))
    frames = colour_frames(oriented, images, inputs.workspace)
    if frames:
        futures["colour"] = render_colour.submit(terrain, frames, config.orthophoto, landing, store)
    return futures


def oriented_pairs(
    pairs: list[PairProducts], mapped: MappedStop | None
) -> tuple[OrientedPair, ...]:
    """The pairs of a stop that the network has, looking from where the stop is mapped with them."""
    known = {o.pair_id: o for o in mapped.orientations} if mapped else {}
    return tuple(OrientedPair(p, known[p.files.id]) for p in pairs if p.files.id in known)
