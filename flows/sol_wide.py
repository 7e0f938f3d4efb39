"""Map the far ground that two linked stops see as one stereo instrument."""

from __future__ import annotations

from collections.abc import Mapping

from prefect.futures import PrefectFuture

from solmap.flows.outcomes import by_first, promised, settled
from solmap.flows.sol_inputs import SolInputs, SolReport, Standing
from solmap.flows.sol_maps import oriented_pairs
from solmap.flows.surfaces import submit_shape
from solmap.photogrammetry.errors import MatchingError, TerrainError
from solmap.photogrammetry.imagery import StopId
from solmap.products.model import ProductRef
from solmap.tasks.adjust import read_network
from solmap.tasks.orientations import read_orientations
from solmap.tasks.pairs import PairProducts
from solmap.tasks.wide import WidePair, build_far_dtm, choose_wide_pairs, match_wide_pair, wide_id

LACKING, FINDINGS = "no far ground,", (MatchingError, TerrainError)
"""How it is told that the images do not give it, and by which errors that is known."""


def map_far_ground(
    inputs: SolInputs,
    standing: Standing,
    matched: Mapping[StopId, list[PairProducts]],
    report: SolReport,
) -> dict[StopId, list[ProductRef]]:
    """A map of far ground for every stop that is linked with earlier ones, if that is wanted."""
    if not inputs.config.wide.enabled:
        return {}
    pairs = _match(inputs, standing, matched, report)
    config, store, landing = inputs.config, inputs.workspace.store, inputs.landing
    futures = {}
    for stop, views in pairs.items():
        dtm = build_far_dtm.submit(stop, tuple(views), config.wide.dtm, landing, store)
        terrain = promised(dtm)
        futures[stop, "elevation"] = dtm
        shape = submit_shape(terrain, config.wide.contour, config, landing, store)
        futures |= {(stop, what): surface for what, surface in shape.items()}
    done, failed = settled(f"sol {report.sol}: map far ground", futures)
    causes = {f"{kind} of {stop}": cause for (stop, kind), cause in failed.items()}
    report.tell("map far ground", causes, LACKING, *FINDINGS)
    return by_first(done)


def _match(
    inputs: SolInputs,
    standing: Standing,
    matched: Mapping[StopId, list[PairProducts]],
    report: SolReport,
) -> dict[StopId, list[WidePair]]:
    """What was matched between the pairs of linked stops, by the later stop."""
    store, params = inputs.workspace.store, inputs.config.wide.matching
    mapped = read_orientations(standing.orientations, store, [str(stop) for stop in matched])
    oriented = {
        stop: oriented_pairs(pairs, mapped.get(str(stop))) for stop, pairs in matched.items()
    }
    futures: dict[tuple[StopId, str], PrefectFuture[WidePair]] = {}
    for earlier, later in _linked(standing, matched, inputs):
        chosen = choose_wide_pairs(oriented[later], oriented[earlier], params.limits, store)
        for eyes in chosen:
            futures[later, wide_id(eyes)] = match_wide_pair.submit(*eyes, params, store)
    done, failed = settled(f"sol {report.sol}: match pairs across stops", futures)
    causes = {name: cause for (_, name), cause in failed.items()}
    report.tell("map far ground", causes, LACKING, *FINDINGS)
    return by_first(done)


def _linked(
    standing: Standing, matched: Mapping[StopId, list[PairProducts]], inputs: SolInputs
) -> list[tuple[StopId, StopId]]:
    """Stops of the window that ties join, the earlier one first."""
    names = {str(stop): stop for stop in matched}
    links = read_network(standing.network, inputs.workspace.store).links
    return [
        (names[link["earlier"]], names[link["later"]])
        for link in links
        if link["linked"] and {link["earlier"], link["later"]} <= names.keys()
    ]
