"""The layers of a sol's stops: maps, models in three dimensions, panoramas and far ground.

Each function submits one task per stop and product, waits, and adds to the report what could not be
made; what did not change is looked up.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from prefect.futures import PrefectFuture

from solmap.config.pipeline import PipelineConfig
from solmap.flows.runtime.failures import (
    as_argument,
    group_by_first,
    group_layers,
    keep_going,
    wait_for,
)
from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol_inputs import SolInputs
from solmap.photogrammetry.errors import MatchingError, TerrainError
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.terrain.relief.contours import ContourParams
from solmap.products.crs import LandingPoint
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductKind, ProductRef
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import PairProducts
from solmap.tasks.maps.far_ground import (
    WidePair,
    build_far_dtm,
    choose_wide_pairs,
    match_wide_pair,
    wide_id,
)
from solmap.tasks.maps.models import make_points, map_dips, model_terrain, model_views, tile_terrain
from solmap.tasks.maps.orthophoto import colour_frames, render_colour, render_orthophoto
from solmap.tasks.maps.panorama import draw_panorama, oriented_frames
from solmap.tasks.maps.suitability import highest_camera, map_hazards, map_insolation, map_viewshed
from solmap.tasks.maps.terrain import build_dtm, map_relief, shade_relief, trace_contours
from solmap.tasks.network.orientations import (
    OrientedPair,
    Standing,
    orient_pairs,
    read_orientations,
)
from solmap.tasks.network.previews import preview_terrain

NO_LAYER = "preview"
"""What is made of a stop only to be looked at beside the products."""
Futures = dict[str, PrefectFuture[Any]]
"""By what is made: one product, or several at once."""
LACKING, FINDINGS = "no far ground,", (MatchingError, TerrainError)
"""Message and errors of a stop whose images do not allow far ground."""


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
    unasked: dict[tuple[StopId, str], str] = {}
    for stop, pairs in matched.items():
        oriented = orient_pairs(pairs, mapped.get(str(stop)))
        if oriented:
            made = _submit_stop(stop, oriented, inputs, unasked)
            futures |= {(stop, what): future for what, future in made.items()}
    done, failed = wait_for(f"sol {report.sol}: map the stops", futures)
    failed |= unasked
    report.add_failures(
        "map", {f"{kind} of {stop}": cause for (stop, kind), cause in failed.items()}
    )
    return group_layers({key: made for key, made in done.items() if key[1] != NO_LAYER})


def _submit_stop(
    stop: StopId,
    oriented: tuple[OrientedPair, ...],
    inputs: SolInputs,
    unasked: dict[tuple[StopId, str], str],
) -> Futures:
    """All maps of one stop; `unasked` gains what cannot even be asked for, and why."""
    config, store, landing = inputs.config, inputs.workspace.store, inputs.landing
    dtm = build_dtm.submit(stop, oriented, config.dtm, landing, store)
    terrain = as_argument(dtm)
    futures: Futures = {
        "dtm": dtm,
        "orthophoto": render_orthophoto.submit(
            terrain, oriented, config.orthophoto, landing, store
        ),
        **submit_relief(terrain, config.contour, config, landing, store),
        **submit_suitability(terrain, config, landing, store),
        "viewshed": map_viewshed.submit(
            terrain, highest_camera(oriented), config.viewshed, landing, store
        ),
        NO_LAYER: preview_terrain.submit(terrain, store),
    }
    with keep_going(unasked, (stop, "colour")):
        images = inputs.workspace.catalogue.images(stop=str(stop))
        frames = colour_frames(oriented, images, inputs.workspace)
        if frames:
            colour = render_colour.submit(terrain, frames, config.orthophoto, landing, store)
            futures["colour"] = colour
    return futures


def submit_relief(
    terrain: ProductRef,
    contour: ContourParams,
    config: PipelineConfig,
    landing: LandingPoint,
    store: ProductStore,
) -> Futures:
    """What shows the shape of the ground to the eye: for any terrain model."""
    return {
        "hillshade": shade_relief.submit(terrain, config.hillshade, landing, store),
        "contours": trace_contours.submit(terrain, contour, landing, store),
    }


def submit_suitability(
    terrain: ProductRef, config: PipelineConfig, landing: LandingPoint, store: ProductStore
) -> Futures:
    """What the ground means to a rover on it: for terrain models as fine as a rover feels."""
    return {
        "relief": map_relief.submit(terrain, config.slope, landing, store),
        "hazard": map_hazards.submit(terrain, config.hazard, landing, store),
        **(
            {
                "insolation": map_insolation.submit(
                    terrain, config.insolation, config.havens, landing, store
                )
            }
            if landing.is_on_mars  # the sun of Mars shines nowhere else
            else {}
        ),
    }


def model_stops(
    inputs: SolInputs,
    orientations: ProductRef,
    matched: Mapping[StopId, list[PairProducts]],
    mapped: Mapping[StopId, list[ProductRef]],
    report: SolReport,
) -> dict[StopId, list[ProductRef]]:
    """Models of every stop that has been mapped, and of what the pairs of every stop see."""
    wanted, store, landing = inputs.config.models, inputs.workspace.store, inputs.landing
    poses = read_orientations(orientations, store, [str(stop) for stop in matched])
    futures: dict[tuple[StopId, str], PrefectFuture[Any]] = {}
    for stop in matched:
        of = {ref.kind: ref for ref in mapped.get(stop, ())}
        ground = of.get(ProductKind.DTM), of.get(ProductKind.ORTHOPHOTO)
        if ground[0] and ground[1] and wanted.of_terrain:
            terrain = (ground[0], ground[1])
            futures[stop, "model"] = model_terrain.submit(*terrain, wanted.terrain, landing, store)
            futures[stop, "3D tiles"] = tile_terrain.submit(*terrain, wanted.tiles, landing, store)
        pairs = orient_pairs(matched[stop], poses.get(str(stop)))
        if not pairs:
            continue
        if wanted.of_views:
            futures[stop, "model of what pairs see"] = model_views.submit(
                stop, pairs, wanted.views, landing, store
            )
        if wanted.of_points:
            futures[stop, "points"] = make_points.submit(stop, pairs, wanted.points, landing, store)
        if wanted.dips_of_facets:
            futures[stop, "dips"] = map_dips.submit(stop, pairs, wanted.facets, landing, store)
    done, failed = wait_for(f"sol {report.sol}: model the stops", futures)
    causes = {f"{kind} of {stop}": cause for (stop, kind), cause in failed.items()}
    report.add_findings("model", causes, "no", TerrainError)
    return group_layers(done)


def draw_panoramas(
    inputs: SolInputs,
    orientations: ProductRef,
    matched: Mapping[StopId, list[PairProducts]],
    mapped: Mapping[StopId, list[ProductRef]],
    report: SolReport,
) -> dict[StopId, tuple[ProductRef, ProductRef]]:
    """The panorama of every stop of the window, and what it knows of the ground."""
    wanted, workspace = inputs.config.panoramas, inputs.workspace
    if not wanted.enabled:
        return {}
    poses = read_orientations(
        orientations, workspace.store, [str(one.stop) for one in inputs.window]
    )
    futures: dict[StopId, PrefectFuture[Any]] = {}
    unasked: dict[StopId, str] = {}
    for stop in (one.stop for one in inputs.window if str(one.stop) in poses):
        with keep_going(unasked, stop):
            entries = workspace.catalogue.images(inputs.mission.mission, stop=str(stop))
            frames = oriented_frames(
                [entry for entry in entries if entry.sol <= inputs.sol],
                {pair.files.id: pair.matches for pair in matched.get(stop, ())},
                poses[str(stop)].orientations,
                wanted.drawing.eye,
                workspace,
            )
            dtm = {ref.kind: ref for ref in mapped.get(stop, ())}.get(ProductKind.DTM)
            if frames:
                futures[stop] = draw_panorama.submit(
                    stop, frames, dtm, wanted.drawing, inputs.landing, workspace.store
                )
    done, failed = wait_for(f"sol {report.sol}: draw the panoramas", futures)
    causes = {f"panorama of {stop}": cause for stop, cause in (failed | unasked).items()}
    report.add_findings("draw", causes, "no", TerrainError)
    return done


def map_far_ground(
    inputs: SolInputs,
    standing: Standing,
    matched: Mapping[StopId, list[PairProducts]],
    report: SolReport,
) -> dict[StopId, list[ProductRef]]:
    """A map of far ground for every stop that is linked with earlier ones, if that is wanted."""
    if not inputs.config.wide.enabled:
        return {}
    pairs = _match_wide_pairs(inputs, standing, matched, report)
    config, store, landing = inputs.config, inputs.workspace.store, inputs.landing
    futures = {}
    for stop, views in pairs.items():
        dtm = build_far_dtm.submit(stop, tuple(views), config.wide.dtm, landing, store)
        terrain = as_argument(dtm)
        futures[stop, "elevation"] = dtm
        shape = submit_relief(terrain, config.wide.contour, config, landing, store)
        futures |= {(stop, what): surface for what, surface in shape.items()}
    done, failed = wait_for(f"sol {report.sol}: map far ground", futures)
    causes = {f"{kind} of {stop}": cause for (stop, kind), cause in failed.items()}
    report.add_findings("map far ground", causes, LACKING, *FINDINGS)
    return group_by_first(done)


def _match_wide_pairs(
    inputs: SolInputs,
    standing: Standing,
    matched: Mapping[StopId, list[PairProducts]],
    report: SolReport,
) -> dict[StopId, list[WidePair]]:
    """What was matched between the pairs of linked stops, by the later stop."""
    store, params = inputs.workspace.store, inputs.config.wide.matching
    mapped = read_orientations(standing.orientations, store, [str(stop) for stop in matched])
    oriented = {stop: orient_pairs(pairs, mapped.get(str(stop))) for stop, pairs in matched.items()}
    futures: dict[tuple[StopId, str], PrefectFuture[WidePair]] = {}
    unasked: dict[tuple[StopId, str], str] = {}
    for earlier, later in _linked_stops(standing, matched, inputs):
        with keep_going(unasked, (later, f"{earlier} - {later}")):
            chosen = choose_wide_pairs(oriented[later], oriented[earlier], params.limits, store)
            for eyes in chosen:
                futures[later, wide_id(eyes)] = match_wide_pair.submit(*eyes, params, store)
    done, failed = wait_for(f"sol {report.sol}: match pairs across stops", futures)
    causes = _one_finding_a_stop(failed | unasked, futures)
    report.add_findings("map far ground", causes, LACKING, *FINDINGS)
    return group_by_first(done)


def _one_finding_a_stop(
    failed: Mapping[tuple[StopId, str], str], asked: Iterable[tuple[StopId, str]]
) -> dict[str, str]:
    """Causes by what they are of; of the findings of a stop the first stands for all."""
    named = tuple(f"{error.__name__}: " for error in FINDINGS)
    causes = {name: why for (_, name), why in failed.items() if not why.startswith(named)}
    found: dict[StopId, list[str]] = {}
    for (stop, _), why in failed.items():
        if why.startswith(named):
            found.setdefault(stop, []).append(why)
    tried = Counter(stop for stop, _ in asked)
    return causes | {
        f"in {len(whys)} of {tried[stop]} wide-baseline pairs of {stop}, the first": whys[0]
        for stop, whys in found.items()
    }


def _linked_stops(
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
