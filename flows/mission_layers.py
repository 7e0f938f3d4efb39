"""The layers of a whole mission: traverse, stops, footprints, pointing lines, ties; its table."""

from __future__ import annotations

from solmap.config.landing import landing_site
from solmap.config.pipeline import load_pipeline
from solmap.config.settings import Settings
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductRef
from solmap.tasks.images import image_records
from solmap.tasks.localisation import localise
from solmap.tasks.publish import publish
from solmap.tasks.telemetry import read_telemetry, vector_files
from solmap.tasks.vectors import draw_vectors


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
    told = localise(network, telemetry, site.landing, workspace.store)
    publish(entry, [(ref, sols) for ref in layers], told, (), workspace)
    return telemetry.note
