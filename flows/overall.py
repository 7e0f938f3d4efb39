"""Adjust all stops of a mission together, and map again those that moved."""

from __future__ import annotations

from pathlib import Path

from prefect import flow

from solmap.config.workspace import open_workspace
from solmap.flows.mission import all_notes, draw_mission, map_regions, maps_of
from solmap.flows.runtime.failures import clear_failure, isolate, keep_going
from solmap.flows.runtime.run_page import write_adjustments
from solmap.flows.runtime.run_record import record_run
from solmap.flows.runtime.runners import on_workers
from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol import map_what_moved
from solmap.flows.sol_inputs import gather_all
from solmap.products.catalogue.catalogue import published_networks
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError
from solmap.tasks.images.manual_ties import take_edits
from solmap.tasks.network.orientations import Standing, standing_of
from solmap.tasks.scopes import is_overall, sol_of


@flow(name="overall", flow_run_name="{mission} overall to sol {sol}")
def process_overall(
    mission: str, sol: int, store: Path, pipeline: str, previous: Standing | None = None
) -> SolReport:
    """Adjust all stops up to a sol in one adjustment, starting from `previous`."""
    report = SolReport(mission, sol)
    inputs = gather_all(mission, sol, store, pipeline, previous)
    if inputs.touched:
        map_what_moved(inputs, previous, report)
    return report


@flow(name="adjust", flow_run_name="overall adjustment {mission}")
def readjust(mission: str, store: Path, pipeline: str = "default") -> SolReport:
    """The overall adjustment of everything that is published of a mission.

    Args:
        mission: As its labels have it: MER2.
        store: Folder of products and catalogue.
        pipeline: Name of a shipped pipeline, or path of a TOML file.

    Raises:
        ProductNotFoundError: no sol of the mission has been processed.
    """
    workspace = open_workspace(store)
    with (
        workspace.exclusive_mission(mission),
        record_run("overall adjustment", mission, workspace) as record,
    ):
        take_edits(workspace)
        report = _readjust(mission, workspace, pipeline)
        record.add_lines(report.notes)
        record.fail_if(report.failures)
    write_adjustments([report], workspace)
    return report


def _readjust(mission: str, workspace: Workspace, pipeline: str) -> SolReport:
    networks = [
        ref for ref in published_networks(mission, workspace.catalogue) if not is_overall(ref.scope)
    ]
    if not networks:
        raise ProductNotFoundError(
            f"no network of {mission} is in the store; `solmap run` its downlink first"
        )
    last = networks[-1]
    sol, standing = sol_of(last.scope), standing_of(last, workspace)
    report = on_workers(process_overall)(mission, sol, workspace.store.root, pipeline, standing)
    if report.standing is not None:
        failed: dict[str, str] = {}
        with keep_going(failed, "layers of the mission"):
            draw_mission(mission, report.standing.network, workspace, pipeline, failed)
        with keep_going(failed, "regions"):
            report.notes += map_regions(mission, workspace, pipeline, failed)
        report.add_failures("draw", failed)
    return report


def overall_sols(mission: str, workspace: Workspace) -> set[int]:
    """Sols up to which the mission was adjusted overall; later sols continued from there."""
    return {
        sol_of(ref.scope)
        for ref in published_networks(mission, workspace.catalogue)
        if is_overall(ref.scope)
    }


def adjust_all(store: Path, pipeline: str, mission: str | None = None) -> list[str]:
    """Adjust all stops of every mission, or of one, together; map again what moved.

    Args:
        store: Folder of products and catalogue.
        pipeline: Name of a shipped pipeline, or path of a TOML file.
        mission: Identifier as in its labels, such as MER2; all missions by default.

    Returns:
        Notes, one line each; failures begin with the mission and `failed`.
    """
    workspace = open_workspace(store)
    notes: list[str] = []
    failures: list[str] = []
    for name in maps_of(store, mission):
        subject, line = f"{name.lower()}-overall", f"{name} failed: {{}}"
        with isolate(subject, workspace, failures, line):
            report = readjust(name, store, pipeline)
            notes += [f"{name}: {note}" for note in report.notes]
            notes += [line.format(cause) for cause in report.failures]
            clear_failure(subject, workspace)
    return all_notes(notes, failures)
