"""The layers of a sol's stops: maps, models in three dimensions, panoramas and far ground.

Each layer of a stop is made by one job; the jobs of layers that users need first come first.
Unchanged layers are looked up in the store. Far ground is mapped when these jobs are done.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from prefect import Task
from prefect.futures import PrefectFuture

from solmap.config.pipeline import Models
from solmap.flows.runtime.failures import group_by_first, keep_going, wait_for
from solmap.flows.runtime.jobs import Job, run_jobs
from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol_inputs import SolInputs
from solmap.photogrammetry.errors import MatchingError, TerrainError
from solmap.photogrammetry.imagery import StopId
from solmap.products.crs import LandingPoint
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductRef
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import PairProducts
from solmap.tasks.maps.far_ground import (
    WidePair,
    build_far_dtm,
    choose_wide_pairs,
    match_wide_pair,
    wide_id,
)
from solmap.tasks.maps.models import make_points, map_dips, model_terrain, model_views
from solmap.tasks.maps.orthophoto import colour_frames, render_colour, render_orthophoto
from solmap.tasks.maps.panorama import draw_panorama, oriented_frames
from solmap.tasks.maps.suitability import highest_camera, map_hazards, map_insolation, map_viewshed
from solmap.tasks.maps.terrain import (
    build_dtm,
    map_relief,
    preview_terrain,
    shade_relief,
    trace_contours,
)
from solmap.tasks.network.orientations import (
    OrientedPair,
    Standing,
    orient_pairs,
    read_orientations,
)

Matched = Mapping[StopId, list[PairProducts]]
Key = tuple[Any, str]
"""Key of a job: its subject, mostly a stop, and the name of its result."""
Made = Mapping[Key, Any]
FIRST = ("dtm", "orthophoto", "contours", "hillshade")
"""Layers that are made and published first."""
LACKING, FINDINGS = "no far ground,", (MatchingError, TerrainError)
"""Message and errors where images do not suffice for a map of far ground."""


def map_jobs(
    inputs: SolInputs, orientations: ProductRef, matched: Matched, first: Collection[StopId]
) -> tuple[dict[Key, Job], dict[Key, Job]]:
    """Jobs for the maps of every stop with matched pairs: those of `FIRST`, and all others.

    Jobs of the stops in `first` precede those of other stops.
    """
    mapped = read_orientations(
        orientations, inputs.workspace.store, [str(stop) for stop in matched]
    )
    at_first: dict[Key, Job] = {}
    later: dict[Key, Job] = {}
    for stop in sorted(matched, key=lambda stop: stop not in first):
        oriented = orient_pairs(matched[stop], mapped.get(str(stop)))
        for what, job in _maps_of_stop(stop, oriented, inputs).items() if oriented else ():
            (at_first if what in FIRST else later)[stop, what] = job
    return at_first, later


def _maps_of_stop(
    stop: StopId, oriented: tuple[OrientedPair, ...], inputs: SolInputs
) -> dict[str, Job]:
    config, store, landing = inputs.config, inputs.workspace.store, inputs.landing
    stage, dtm = f"sol {inputs.sol}: map the stops", (stop, "dtm")

    def on_terrain(submit: Callable[[ProductRef], PrefectFuture[Any] | None]) -> Job:
        return Job(stage, lambda made: submit(made[dtm]), needs=[dtm])

    def surface(task: Task[..., Any], *params: object) -> Job:
        return on_terrain(lambda terrain: task.submit(terrain, *params, landing, store))

    def submit_colour(terrain: ProductRef) -> PrefectFuture[Any] | None:
        images = inputs.workspace.catalogue.images(stop=str(stop))
        frames = colour_frames(oriented, images, inputs.workspace)
        if not frames:
            return None
        return render_colour.submit(terrain, frames, config.orthophoto, landing, store)

    jobs = {
        "dtm": Job(stage, lambda _: build_dtm.submit(stop, oriented, config.dtm, landing, store)),
        "orthophoto": surface(render_orthophoto, oriented, config.orthophoto),
        "contours": surface(trace_contours, config.contour),
        "hillshade": surface(shade_relief, config.hillshade),
        "relief": surface(map_relief, config.slope),
        "hazard": surface(map_hazards, config.hazard),
        "viewshed": surface(map_viewshed, highest_camera(oriented), config.viewshed),
        "colour": on_terrain(submit_colour),
    }
    if landing.is_on_mars:  # insolation is modelled for Mars only
        jobs["insolation"] = surface(map_insolation, config.insolation, config.havens)
    return jobs


def model_jobs(inputs: SolInputs, orientations: ProductRef, matched: Matched) -> dict[Key, Job]:
    """Jobs for terrain models in 3D, tiles, view models, points and dips of every stop."""
    params, store, landing = inputs.config.models, inputs.workspace.store, inputs.landing
    poses = read_orientations(orientations, store, [str(stop) for stop in matched])
    jobs: dict[Key, Job] = {}
    for stop in matched:
        pairs = orient_pairs(matched[stop], poses.get(str(stop)))
        if pairs:
            jobs |= {
                (stop, what): Job(f"sol {inputs.sol}: model the stops", submit, needs)
                for what, submit, needs, is_enabled in _models_of_stop(
                    stop, pairs, params, landing, store
                )
                if is_enabled
            }
    return jobs


def _models_of_stop(
    stop: StopId,
    pairs: tuple[OrientedPair, ...],
    models: Models,
    landing: LandingPoint,
    store: ProductStore,
) -> Iterator[tuple[str, Callable[[Made], PrefectFuture[Any]], Sequence[Key], bool]]:
    """Models of a stop: name, function that submits the task, inputs, whether it is enabled."""
    ground = (stop, "dtm"), (stop, "orthophoto")

    def of_terrain(made: Made) -> PrefectFuture[Any]:
        dtm, (orthophoto, *_) = (made[key] for key in ground)
        return model_terrain.submit(dtm, orthophoto, models.terrain, models.tiles, landing, store)

    def of_pairs(task: Task[..., Any], params: object) -> Callable[[Made], PrefectFuture[Any]]:
        return lambda _: task.submit(stop, pairs, params, landing, store)

    yield "model", of_terrain, ground, models.of_terrain
    yield "model of what pairs see", of_pairs(model_views, models.views), (), models.of_views
    yield "points", of_pairs(make_points, models.points), (), models.of_points
    yield "dips", of_pairs(map_dips, models.facets), (), models.dips_of_facets


def panorama_jobs(inputs: SolInputs, orientations: ProductRef, matched: Matched) -> dict[Key, Job]:
    """Jobs for the panorama of every stop of the window, and for its ground points."""
    options, workspace = inputs.config.panoramas, inputs.workspace
    if not options.enabled:
        return {}
    poses = read_orientations(
        orientations, workspace.store, [str(one.stop) for one in inputs.window]
    )

    def job(stop: StopId) -> Job:
        def submit(made: Made) -> PrefectFuture[Any] | None:
            entries = workspace.catalogue.images(inputs.mission.mission, stop=str(stop))
            frames = oriented_frames(
                [entry for entry in entries if entry.sol <= inputs.sol],
                {pair.files.id: pair.matches for pair in matched.get(stop, ())},
                poses[str(stop)].orientations,
                options.drawing.eye,
                workspace,
            )
            if not frames:
                return None
            dtm, params = made.get((stop, "dtm")), options.drawing
            return draw_panorama.submit(stop, frames, dtm, params, inputs.landing, workspace.store)

        return Job(f"sol {inputs.sol}: draw the panoramas", submit, after=[(stop, "dtm")])

    stops = [one.stop for one in inputs.window if str(one.stop) in poses]
    return {(stop, "panorama"): job(stop) for stop in stops}


def preview_jobs(inputs: SolInputs, mapped: Collection[StopId]) -> dict[Key, Job]:
    """Jobs for previews of the terrain of mapped stops, if enabled."""
    if not inputs.config.previews:
        return {}
    stage, store = f"sol {inputs.sol}: preview terrain", inputs.workspace.store

    def of_terrain(dtm: Key) -> Job:
        return Job(stage, lambda made: preview_terrain.submit(made[dtm], store), needs=[dtm])

    return {(stop, "picture"): of_terrain((stop, "dtm")) for stop in mapped}


def map_far_ground(
    inputs: SolInputs,
    standing: Standing,
    matched: Matched,
    report: SolReport,
) -> dict[StopId, list[ProductRef]]:
    """Map the far ground of every stop that is linked with earlier ones, if enabled."""
    if not inputs.config.wide.enabled:
        return {}
    pairs = _match_wide_pairs(inputs, standing, matched, report)
    jobs: dict[Key, Job] = {}
    for stop, views in pairs.items():
        jobs |= _far_maps(stop, tuple(views), inputs)
    done, failed = run_jobs(jobs)
    causes = {f"{kind} of {stop}": cause for (stop, kind), cause in failed.items()}
    report.add_findings("map far ground", causes, LACKING, *FINDINGS)
    return group_by_first(done)


def _far_maps(stop: StopId, views: tuple[WidePair, ...], inputs: SolInputs) -> dict[Key, Job]:
    config, store, landing = inputs.config, inputs.workspace.store, inputs.landing
    stage, far = f"sol {inputs.sol}: map far ground", (stop, "elevation")

    def on_terrain(task: Task[..., Any], params: object) -> Job:
        return Job(stage, lambda made: task.submit(made[far], params, landing, store), needs=[far])

    return {
        far: Job(
            stage, lambda _: build_far_dtm.submit(stop, views, config.wide.dtm, landing, store)
        ),
        (stop, "hillshade"): on_terrain(shade_relief, config.hillshade),
        (stop, "contours"): on_terrain(trace_contours, config.wide.contour),
    }


def _match_wide_pairs(
    inputs: SolInputs,
    standing: Standing,
    matched: Matched,
    report: SolReport,
) -> dict[StopId, list[WidePair]]:
    """Wide-baseline matches between pairs of linked stops, grouped by the later stop."""
    store, params = inputs.workspace.store, inputs.config.wide.matching
    mapped = read_orientations(standing.orientations, store, [str(stop) for stop in matched])
    oriented = {stop: orient_pairs(pairs, mapped.get(str(stop))) for stop, pairs in matched.items()}
    futures: dict[tuple[StopId, str], PrefectFuture[WidePair]] = {}
    unsubmitted: dict[tuple[StopId, str], str] = {}
    for earlier, later in _linked_stops(standing, matched, inputs):
        if later in report.postponed:
            continue
        with keep_going(unsubmitted, (later, f"{earlier} - {later}")):
            chosen = choose_wide_pairs(oriented[later], oriented[earlier], params, store)
            for eyes in chosen:
                futures[later, wide_id(eyes)] = match_wide_pair.submit(*eyes, params, store)
    done, failed = wait_for(f"sol {report.sol}: match pairs across stops", futures)
    causes = _one_finding_a_stop(failed | unsubmitted, futures)
    report.add_findings("map far ground", causes, LACKING, *FINDINGS)
    return group_by_first(done)


def _one_finding_a_stop(
    failed: Mapping[tuple[StopId, str], str], requested: Iterable[tuple[StopId, str]]
) -> dict[str, str]:
    """Causes by subject; findings of one stop are summarised in one line that quotes the first."""
    named = tuple(f"{error.__name__}: " for error in FINDINGS)
    causes = {name: why for (_, name), why in failed.items() if not why.startswith(named)}
    found: dict[StopId, list[str]] = {}
    for (stop, _), why in failed.items():
        if why.startswith(named):
            found.setdefault(stop, []).append(why)
    tried = Counter(stop for stop, _ in requested)
    return causes | {
        f"in {len(reasons)} of {tried[stop]} wide-baseline pairs of {stop}, the first": reasons[0]
        for stop, reasons in found.items()
    }


def _linked_stops(
    standing: Standing, matched: Matched, inputs: SolInputs
) -> list[tuple[StopId, StopId]]:
    """Linked stops with matched pairs, the earlier one first."""
    names = {str(stop): stop for stop in matched}
    links = read_network(standing.network, inputs.workspace.store).links
    return [
        (names[link["earlier"]], names[link["later"]])
        for link in links
        if link["linked"] and {link["earlier"], link["later"]} <= names.keys()
    ]
