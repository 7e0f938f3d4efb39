"""The layers of a whole mission: its traverse, stops, footprints and ties, and its regions."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path

from solmap.config.landing import landing_site
from solmap.config.pipeline import PipelineConfig, load_pipeline
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.runtime.run_record import record_run
from solmap.photogrammetry.terrain.dtm.region_dtm import regions_of
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.catalogue.images import image_records
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint
from solmap.products.model import REGION_KINDS, Layer, ProductKind, ProductRef, Scope
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.telemetry import read_telemetry, vector_files
from solmap.tasks.maps.region import fuse_region, seam_notes
from solmap.tasks.maps.suitability import map_hazards, map_insolation
from solmap.tasks.maps.terrain import map_relief, shade_relief, trace_contours
from solmap.tasks.mission.localisation import localise
from solmap.tasks.mission.publish import publish, withdraw
from solmap.tasks.mission.vectors import draw_vectors

LEAST_STOPS = 2
"""A region is more than the map of one stop."""


def draw_mission(
    mission: str, network: ProductRef, workspace: Workspace, pipeline: str
) -> str | None:
    """Draw and publish them; what is to be said of the mission's frame, if anything."""
    site = landing_site(mission, Settings().landing_sites)
    entries = workspace.catalogue.images(mission)
    telemetry = read_telemetry(image_records(entries, workspace), vector_files(mission, workspace))
    params = load_pipeline(pipeline).footprints
    layers = draw_vectors(mission, network, entries, params, site.landing, workspace)
    sols = tuple(sorted({entry.sol for entry in entries}))
    entry = MissionEntry(mission, site.title, site.landing, telemetry.note)
    traverse = localise(network, telemetry, site.landing, workspace.store)
    publish(entry, [(ref, sols) for ref in layers], traverse, (), workspace)
    return telemetry.note


def map_regions(mission: str, workspace: Workspace, pipeline: str) -> list[str]:
    """Fuse, map and publish the regions of a mission; how far their stops disagree.

    What did not change is looked up.
    """
    config = load_pipeline(pipeline)
    landing = landing_site(mission, Settings().landing_sites).landing
    notes: list[str] = []
    scopes: set[Scope] = set()
    for stops in _regions(mission, workspace, config) if config.region.enabled else ():
        refs = [layer.ref for layer in stops]
        dtm, seams = fuse_region(mission, refs, config.region.fusion, landing, workspace.store)
        made = [dtm, seams, *_surfaces(dtm, config, landing, workspace.store)]
        sols = tuple(sorted({sol for layer in stops for sol in layer.sols}))
        entry = workspace.catalogue.mission(mission)
        publish(entry, [(ref, sols) for ref in made], (), (), workspace)
        notes += seam_notes(seams, workspace.store)
        scopes.add(dtm.scope)
    if config.region.enabled:
        _withdraw_others(mission, scopes, workspace)
    return notes


def _withdraw_others(mission: str, scopes: Set[Scope], workspace: Workspace) -> None:
    """Show no longer what was a region before stops came late: a region bears its first's name."""
    published = workspace.catalogue.layers(mission)
    kinds = {*REGION_KINDS.values(), ProductKind.REGION_SEAMS}
    gone = [one for one in published if one.ref.kind in kinds and one.ref.scope not in scopes]
    if gone:
        withdraw(workspace.catalogue.mission(mission), gone, (), workspace)


def _regions(mission: str, workspace: Workspace, config: PipelineConfig) -> list[list[Layer]]:
    """The terrain models that are fused together: those of two stops or more."""
    published = workspace.catalogue.layers(mission)
    near = sorted(
        (layer for layer in published if layer.ref.kind is ProductKind.DTM),
        key=lambda layer: layer.ref.scope.name,
    )
    far = {layer.ref.scope: layer for layer in published if layer.ref.kind is ProductKind.FAR_DTM}
    numbers = regions_of([layer.bounds for layer in near], config.region.fusion.largest_m)
    stops = [[near[k] for k in members] for members in numbers if len(members) >= LEAST_STOPS]
    return [
        [*of_one, *(far[layer.ref.scope] for layer in of_one if layer.ref.scope in far)]
        for of_one in stops
    ]


def _surfaces(
    dtm: ProductRef, config: PipelineConfig, landing: LandingPoint, store: ProductStore
) -> list[ProductRef]:
    """What shows the shape of the region, and what it means to a rover."""
    return [
        shade_relief(dtm, config.hillshade, landing, store),
        trace_contours(dtm, config.region.contour, landing, store),
        *map_relief(dtm, config.slope, landing, store),
        *map_insolation(dtm, config.insolation, config.havens, landing, store),
        map_hazards(dtm, config.hazard, landing, store),
    ]


def refresh_regions(store: Path, pipeline: str, mission: str | None = None) -> list[str]:
    """Join the stops of every mission, or of one, to regions anew where any of them changed.

    Args:
        store: Folder of products and catalogue.
        pipeline: Name of a shipped pipeline, or path of a TOML file.
        mission: As its labels have it: MER2; every mission where none is given.
    """
    workspace = open_workspace(store)
    notes: list[str] = []
    for name in missions_of(store, mission):
        with (
            workspace.mission_turn(name),
            record_run("region", name, workspace) as record,
        ):
            seams = map_regions(name, workspace, pipeline)
            record.say(seams)
            notes += [f"{name}: {line}" for line in seams]
    return notes


def missions_of(store: Path, mission: str | None) -> list[str]:
    """The named mission, or all that a store has images of."""
    if mission is not None:
        return [mission.upper()]
    return [entry.mission for entry in open_workspace(store).catalogue.missions()]
