"""Flows over everything that is in a store: for schedules, which know no mission by name."""

from __future__ import annotations

from pathlib import Path

from prefect import flow

from solmap.config.workspace import open_workspace
from solmap.flows.overall import readjust
from solmap.flows.region import map_regions
from solmap.flows.run_names import mission_name
from solmap.flows.run_record import recorded
from solmap.products.store.locks import turn


@flow(name="overall-adjustment", flow_run_name=mission_name)
def adjust_all(store: Path, pipeline: str = "default", mission: str | None = None) -> list[str]:
    """Adjust all stops of every mission, or of one, together; map again what moved.

    Args:
        store: Folder of products and catalogue.
        pipeline: Name of a shipped pipeline, or path of a TOML file.
        mission: As its labels have it: MER2; every mission where none is given.

    Returns:
        Notes, a line each; failures begin with the mission and `failed`.
    """
    notes: list[str] = []
    for name in _missions(store, mission):
        report = readjust(name, store, pipeline)
        notes += [f"{name}: {note}" for note in report.notes]
        notes += [f"{name} failed: {line}" for line in report.failures]
    return notes


@flow(name="refresh-region", flow_run_name=mission_name)
def refresh_regions(
    store: Path, pipeline: str = "default", mission: str | None = None
) -> list[str]:
    """Join the stops of every mission, or of one, to regions anew where any of them changed.

    Args:
        store: Folder of products and catalogue.
        pipeline: Name of a shipped pipeline, or path of a TOML file.
        mission: As its labels have it: MER2; every mission where none is given.
    """
    workspace = open_workspace(store)
    notes: list[str] = []
    for name in _missions(store, mission):
        with turn(workspace.store.root, name), recorded("region", name, workspace) as record:
            seams = map_regions(name, workspace, pipeline)
            record.say(seams)
            notes += [f"{name}: {line}" for line in seams]
    return notes


def _missions(store: Path, mission: str | None) -> list[str]:
    if mission is not None:
        return [mission.upper()]
    return [entry.mission for entry in open_workspace(store).catalogue.missions()]
