"""Process a downlink: ingest its files, process each sol in order, then the mission's traverse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from prefect import flow, get_run_logger

from solmap.config.landing import landing_site
from solmap.config.pipeline import load_pipeline
from solmap.config.radiometry import load_radiometry
from solmap.config.records import ConfigError
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.mission import draw_mission, map_regions
from solmap.flows.runtime.failures import clear_failure, isolate, keep_going
from solmap.flows.runtime.progress import report as report_progress
from solmap.flows.runtime.run_page import downlink_name, folder_name, rename_run, write_report
from solmap.flows.runtime.run_record import record_run
from solmap.flows.runtime.sol_report import DownlinkReport
from solmap.flows.sol_inputs import assign_maps
from solmap.flows.sols import MapSols, withdraw_leftovers
from solmap.photogrammetry.archive.images.radiometry import Radiometry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, cause_of
from solmap.tasks.images.folders import NO_FILES
from solmap.tasks.images.ingest import Delivery, ingest_downlink
from solmap.tasks.images.manual_ties import EDITS_FILE, take_edits
from solmap.tasks.images.poses import PoseSources, open_pose_sources, take_poses
from solmap.tasks.network.orientations import Standing


@flow(name="downlink", flow_run_name=folder_name)
def process_downlink(
    downlink: Path | None,
    store: Path,
    pipeline: str = "default",
    settle_s: float = 0.0,
    places: Sequence[Path] = (),
) -> DownlinkReport:
    """Process a folder of rover images to published layers; existing products are looked up.

    Args:
        downlink: Folder of images with their labels, and of vector files; None if only
            `places` are new.
        store: Folder of products and catalogue.
        pipeline: Name of a shipped pipeline, or path of a TOML file.
        settle_s: Files that changed more recently, in seconds, may still be arriving: they are
            left for the next run.
        places: Files with poses of sites and stops, as `solmap poses add` takes them.
    """
    report = DownlinkReport()
    load_pipeline(pipeline)  # refuse wrong settings before the work starts
    radiometry = load_radiometry(Settings().instruments)
    workspace = open_workspace(store)
    named = (downlink or places[0]).name
    with record_run("downlink", named, workspace) as record, open_pose_sources(places) as poses:
        delivery = Delivery((), (), 0, ())
        if downlink is not None:
            delivery = _ingest(downlink, workspace, radiometry, settle_s, poses)
        missions = _take_poses(poses, delivery, workspace, report)
        _note_delivery(delivery, downlink, report)
        if delivery.images:
            rename_run(downlink_name(delivery.images))
        with isolate(EDITS_FILE, workspace, report.failures, f"{EDITS_FILE}: {{}}"):
            take_edits(workspace)
            clear_failure(EDITS_FILE, workspace)
        for mission in missions:
            line = f"{mission}: {{}}"
            with (
                isolate(mission.lower(), workspace, report.failures, line),
                workspace.exclusive_mission(mission, partial(_log_waiting, mission)),
            ):
                _process_mission(mission, workspace, pipeline, report)
                clear_failure(mission.lower(), workspace)
        record.add_lines([*report.warnings, *report.lines])
        record.fail_if(report.failures)
    unwritten: dict[str, str] = {}
    with keep_going(unwritten, "the page of the run"):
        write_report(report, workspace)
    return report


def _ingest(
    downlink: Path,
    workspace: Workspace,
    radiometry: Mapping[str, Radiometry],
    settle_s: float,
    poses: PoseSources,
) -> Delivery:
    """Ingest the files.

    Raises:
        ProductError: that failed as a whole; the message is the reason.
    """
    try:
        return ingest_downlink(
            downlink,
            workspace,
            radiometry,
            lambda done, total: report_progress("ingest files", done, total),
            settle_s,
            poses,
        )
    except ProductError:
        raise
    except Exception as error:
        raise ProductError(
            f"the files of {downlink} could not be taken into the store: {cause_of(error)}"
        ) from error


def _take_poses(
    poses: PoseSources, delivery: Delivery, workspace: Workspace, report: DownlinkReport
) -> tuple[str, ...]:
    """Store poses from other sources; returns the missions of the run.

    Where the files do not name a mission it is that of the delivery, or the only one in the store.
    """
    if not poses.names:
        return delivery.missions
    held = {entry.stop_id.mission for entry in workspace.catalogue.images()}
    named = poses.missions or delivery.missions or tuple(sorted(held))
    if len(named) != 1:
        report.failures.append(
            f"{poses.names}: of which mission? {', '.join(named) or 'none'} is there; "
            "name it by `solmap poses add FILE --mission MISSION`"
        )
        return delivery.missions
    with isolate(poses.names, workspace, report.failures, "{}"):
        report.poses += take_poses(poses, named[0], workspace)
        clear_failure(poses.names, workspace)
    return tuple(dict.fromkeys((*delivery.missions, *named)))


def _log_waiting(mission: str) -> None:
    get_run_logger().info("another run works on %s; this one waits for it to end", mission)


def _note_delivery(delivery: Delivery, downlink: Path | None, report: DownlinkReport) -> None:
    report.images = len(delivery.images)
    report.warnings += [note for fault in delivery.faults for note in fault.notes]
    if downlink is not None and not delivery.missions:
        found = (
            f"none of its {delivery.files} files is a mapping image" if delivery.files else NO_FILES
        )
        report.failures.append(f"nothing to process in {downlink}: {found}")


def _process_mission(
    mission: str, workspace: Workspace, pipeline: str, report: DownlinkReport
) -> None:
    """All maps of a mission: that of the sites tied to the lander, and one for each other group."""
    try:
        landing_site(mission, Settings().landing_sites)
    except ConfigError as error:
        report.failures.append(str(error))
        return
    maps = assign_maps(mission, workspace)
    if not maps:
        report.warnings.append(f"{mission}: vector files are kept until images of it come")
    sols_of_maps = [MapSols(name, workspace, pipeline, report.failures) for name in maps]
    finished = [sols.process() for sols in sols_of_maps]
    report.sols += [done for sols in sols_of_maps for done in sols.reports]
    if all(finished):
        _withdraw_leftovers(mission, maps, workspace, report)
    for sols in sols_of_maps:
        if sols.standing is not None:
            _draw(sols.name, sols.standing, workspace, pipeline, report)
            _map_regions(sols.name, workspace, pipeline, report)


def _withdraw_leftovers(
    mission: str, maps: Sequence[str], workspace: Workspace, report: DownlinkReport
) -> None:
    subject = f"{mission.lower()}-leftovers"
    line = f"{mission}: layers that no sol makes any more could not be withdrawn: {{}}"
    of_mission = [sol for sol in report.sols if sol.mission in maps]
    with isolate(subject, workspace, report.failures, line):
        report.failures += withdraw_leftovers(mission, maps, of_mission, workspace)
        clear_failure(subject, workspace)


def _draw(
    mission: str, standing: Standing, workspace: Workspace, pipeline: str, report: DownlinkReport
) -> None:
    subject, line = f"{mission.lower()}-layers", f"{mission}: its layers could not be drawn: {{}}"
    with isolate(subject, workspace, report.failures, line) as failed:
        note = draw_mission(mission, standing.network, workspace, pipeline, failed)
        report.warnings += [f"{mission}: {note}"] if note else []
        if not failed:
            clear_failure(subject, workspace)


def _map_regions(mission: str, workspace: Workspace, pipeline: str, report: DownlinkReport) -> None:
    subject, line = (
        f"{mission.lower()}-regions",
        f"{mission}: its regions could not be mapped: {{}}",
    )
    with isolate(subject, workspace, report.failures, line) as failed:
        report.seams += map_regions(mission, workspace, pipeline, failed)
        if not failed:
            clear_failure(subject, workspace)
