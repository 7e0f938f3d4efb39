"""The layers of a whole mission: its traverse, stops, footprints and ties, and its regions."""

from __future__ import annotations

from collections.abc import Collection, Sequence, Set
from pathlib import Path
from typing import Any

from prefect import Task

from solmap.config.landing import landing_site
from solmap.config.pipeline import PipelineConfig, load_pipeline
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.runtime.failures import clear_failure, isolate, keep_going
from solmap.flows.runtime.jobs import Job, run_jobs
from solmap.flows.runtime.run_record import record_run
from solmap.flows.sol_inputs import read_map
from solmap.photogrammetry.archive.missions import mission_id
from solmap.photogrammetry.terrain.dtm.region_dtm import regions_of
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint
from solmap.products.errors import ProductError
from solmap.products.model import REGION_KINDS, Layer, ProductKind, ProductRef, Scope, mission_of
from solmap.products.store.product_store import ProductStore
from solmap.tasks.maps.region import fuse_region, merge_orthophotos, seam_notes
from solmap.tasks.maps.suitability import map_hazards, map_insolation
from solmap.tasks.maps.terrain import map_relief, shade_relief, trace_contours
from solmap.tasks.mission.localisation import localise, traverse_products
from solmap.tasks.mission.publish import publish, withdraw
from solmap.tasks.mission.vectors import VECTORS, draw_vectors

LEAST_STOPS = 2
"""Minimum number of stops in a region."""


def draw_mission(
    mission: str,
    network: ProductRef,
    workspace: Workspace,
    pipeline: str,
    failed: dict[str, str],
) -> str | None:
    """Draw and publish a mission's vector layers and traverse.

    Returns the reason why its map is not tied to the lander, if any. Each failure is added to
    `failed` with its cause.
    """
    read = read_map(mission, workspace)
    layers: list[tuple[ProductRef, tuple[int, ...]]] = []
    traverse: list[ProductRef] = []
    with keep_going(failed, "vector layers"):
        layers = draw_network(mission, network, workspace, load_pipeline(pipeline), VECTORS)
    with keep_going(failed, "traverse"):
        traverse = localise(network, read.telemetry, read.entry.landing, workspace.store)
    published = publish(read.entry, layers, traverse, (), workspace)
    failed |= published.failures
    current = {(ref.kind, ref.scope) for ref in traverse}
    # products of sites that have moved to another map
    outdated = [
        ref
        for ref in traverse_products(mission, workspace.catalogue)
        if (ref.kind, ref.scope) not in current
    ]
    if traverse and outdated:
        workspace.catalogue.withdraw((), outdated)
    return read.entry.lsl_note


def draw_network(
    mission: str,
    network: ProductRef,
    workspace: Workspace,
    config: PipelineConfig,
    kinds: Collection[ProductKind],
) -> list[tuple[ProductRef, tuple[int, ...]]]:
    """Vector layers of a network, with the sols that they show."""
    read, entries = read_map(mission, workspace), workspace.catalogue.images(mission)
    telemetry, slip = read.telemetry, config.adjustment.slip
    sigmas_m = {s.stop: telemetry.sigma_from_origin_m(s.stop, slip) for s in telemetry.stops}
    drawn = draw_vectors(
        mission,
        network,
        entries,
        config.footprints,
        read.entry.landing,
        workspace,
        kinds=kinds,
        sigmas_m=sigmas_m,
    )
    sols = tuple(sorted({entry.sol for entry in entries}))
    return [(ref, sols) for ref in drawn]


def map_regions(
    mission: str, workspace: Workspace, pipeline: str, failed: dict[str, str]
) -> list[str]:
    """Fuse, map and publish the regions of a mission.

    Returns one line per pair of overlapping stops with their height disagreement. Products of
    unchanged regions are reused. Each failure is added to `failed` with its cause.
    """
    config = load_pipeline(pipeline)
    if not config.region.enabled:
        return []
    notes: list[str] = []
    scopes: set[Scope] = set()
    for models in _regions(mission, workspace, config):
        with keep_going(failed, f"region that starts at {models[0].ref.scope}"):
            scope, seams = _map_region(mission, models, workspace, config, failed)
            scopes.add(scope)
            notes += seams
    if not failed:
        _withdraw_others(mission, scopes, workspace)
    return notes


def _map_region(
    mission: str,
    models: Sequence[Layer],
    workspace: Workspace,
    config: PipelineConfig,
    failed: dict[str, str],
) -> tuple[Scope, list[str]]:
    store, landing = workspace.store, landing_site(mission, Settings().landing_sites).landing
    refs = [layer.ref for layer in models]
    dtm, seams = fuse_region(mission, refs, config.region.fusion, landing, store)
    scopes = {ref.scope for ref in refs}
    orthophotos = [
        layer.ref
        for layer in workspace.catalogue.layers(mission)
        if layer.ref.kind is ProductKind.ORTHOPHOTO and layer.ref.scope in scopes
    ]
    jobs = _region_jobs(dtm, orthophotos, config, landing, store)
    done, causes = run_jobs(jobs, most=Settings().task_workers)
    failed |= {f"{what} of {dtm.scope}": cause for what, cause in causes.items()}
    made = [dtm, seams]
    for result in done.values():
        made += [result] if isinstance(result, ProductRef) else result
    sols = tuple(sorted({sol for layer in models for sol in layer.sols}))
    entry = workspace.catalogue.mission(mission)
    failed |= publish(entry, [(ref, sols) for ref in made], (), (), workspace).failures
    return dtm.scope, seam_notes(seams, store)


def _withdraw_others(mission: str, scopes: Set[Scope], workspace: Workspace) -> None:
    """Withdraw published regions that no longer exist.

    A region is named after its first stop, so a stop added later may rename it.
    """
    published = workspace.catalogue.layers(mission)
    kinds = {*REGION_KINDS.values(), ProductKind.REGION_SEAMS}
    gone = [one for one in published if one.ref.kind in kinds and one.ref.scope not in scopes]
    if gone:
        withdraw(workspace.catalogue.mission(mission), gone, (), workspace)


def _regions(mission: str, workspace: Workspace, config: PipelineConfig) -> list[list[Layer]]:
    """The terrain models to fuse, one list per region of at least two stops.

    Far models are included.
    """
    published = workspace.catalogue.layers(mission)
    near = sorted(
        (layer for layer in published if layer.ref.kind is ProductKind.DTM),
        key=lambda layer: layer.ref.scope.name,
    )
    far = {layer.ref.scope: layer for layer in published if layer.ref.kind is ProductKind.FAR_DTM}
    regions = regions_of([layer.bounds for layer in near], config.region.fusion.largest_m)
    models = [[near[k] for k in members] for members in regions if len(members) >= LEAST_STOPS]
    return [
        [
            *models_of_region,
            *(far[layer.ref.scope] for layer in models_of_region if layer.ref.scope in far),
        ]
        for models_of_region in models
    ]


def _region_jobs(
    dtm: ProductRef,
    orthophotos: Sequence[ProductRef],
    config: PipelineConfig,
    landing: LandingPoint,
    store: ProductStore,
) -> dict[str, Job]:
    """Jobs for the layers of a region: relief, suitability for a rover, merged orthophoto."""

    def job(task: Task[..., Any], *params: object) -> Job:
        stage = "map the region's layers"
        return Job(stage, lambda _: task.submit(dtm, *params, landing, store))

    jobs = {
        "relief": job(map_relief, config.slope),
        "hillshade": job(shade_relief, config.hillshade),
        "contours": job(trace_contours, config.region.contour),
        "hazard": job(map_hazards, config.hazard),
    }
    if landing.is_on_mars:  # insolation is modelled for Mars only
        jobs["insolation"] = job(map_insolation, config.insolation, config.havens)
    if orthophotos:
        jobs["orthophoto"] = job(merge_orthophotos, orthophotos, config.region.orthophoto)
    return jobs


def refresh_regions(store: Path, pipeline: str, mission: str | None = None) -> list[str]:
    """Rebuild the regions whose stops have changed, for all missions or one.

    Args:
        store: Folder of products and catalogue.
        pipeline: Name of a shipped pipeline, or path of a TOML file.
        mission: Identifier as in its labels, such as MER2; all missions by default.
    """
    workspace = open_workspace(store)
    notes: list[str] = []
    failures: list[str] = []
    for name in maps_of(store, mission):
        subject = f"{name.lower()}-regions"
        with (
            isolate(subject, workspace, failures, f"{name} failed: {{}}") as failed,
            workspace.exclusive_mission(name),
            record_run("region", name, workspace) as record,
        ):
            seams = map_regions(name, workspace, pipeline, failed)
            record.add_lines(seams)
            record.fail_if([f"{part}: {cause}" for part, cause in failed.items()])
            notes += [f"{name}: {line}" for line in seams]
            if not failed:
                clear_failure(subject, workspace)
    return all_notes(notes, failures)


def all_notes(notes: list[str], failures: list[str]) -> list[str]:
    """Notes of a run over missions, failures last.

    Raises:
        ProductError: everything failed.
    """
    if failures and not notes:
        raise ProductError("; ".join(failures))
    return notes + failures


def maps_of(store: Path, mission: str | None) -> list[str]:
    """Names of the maps of a mission, or of all maps in the store."""
    known = [entry.mission for entry in open_workspace(store).catalogue.missions()]
    if mission is None:
        return known
    mission_name = mission_id(mission)
    return [name for name in known if mission_name in {name, mission_of(name)}] or [mission_name]
