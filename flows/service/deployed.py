"""The flows of deployments, whose parameters are plain values.

Folders, the store, the pipeline and addresses come from the settings of the service, not from the
parameters of a run: users who may start runs cannot name files or programs.
"""

import multiprocessing
from pathlib import Path

from prefect import flow

from solmap.config.records import ConfigError
from solmap.config.run_parameters import Instrument, MissionName, Settling, Sols
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.downlink import process_downlink
from solmap.flows.fetch import FetchReport, fetch_archive
from solmap.flows.mission import refresh_regions
from solmap.flows.overall import adjust_all
from solmap.flows.runtime.children import die_with_parent
from solmap.flows.runtime.run_page import mission_name
from solmap.flows.runtime.run_record import record_run
from solmap.flows.runtime.sol_report import DownlinkReport


@flow(name="downlink", flow_run_name="downlink of the inbox")
def process_inbox(settle_s: Settling = 20.0) -> DownlinkReport:
    """Process the inbox to published layers; existing products are looked up.

    Args:
        settle_s: Files that changed more recently, in seconds, may still be arriving: they are
            left for the next run.
    """
    settings = _settings()
    return process_downlink.fn(_inbox(settings), settings.store, settings.pipeline, settle_s)


@flow(name="overall-adjustment", flow_run_name=mission_name)
def adjust_missions(mission: MissionName | None = None) -> list[str]:
    """Adjust all stops of every mission, or of one, together; map again what moved.

    Args:
        mission: Identifier as in its labels, such as MER2; all missions by default.

    Returns:
        Notes, one line each; failures begin with the mission and `failed`.
    """
    settings = _settings()
    return adjust_all(settings.store, settings.pipeline, mission)


@flow(name="refresh-region", flow_run_name=mission_name)
def refresh_missions(mission: MissionName | None = None) -> list[str]:
    """Join the stops of every mission, or of one, into regions again where any changed.

    Args:
        mission: Identifier as in its labels, such as MER2; all missions by default.
    """
    settings = _settings()
    return refresh_regions(settings.store, settings.pipeline, mission)


@flow(name="fetch-archive", flow_run_name="fetch {mission} sol {sols}")
def fetch_to_inbox(
    mission: MissionName,
    sols: Sols,
    instruments: tuple[Instrument, ...] = ("navcam",),
    *,
    dry_run: bool = False,
) -> FetchReport:
    """Download the stereo pairs of some sols from the archive to the inbox.

    Args:
        mission: MER1 or MER2.
        sols: 155, 155-157, or several of these separated by commas.
        instruments: Any of navcam, pancam, hazcam, front_hazcam, rear_hazcam.
        dry_run: Only list the images.
    """
    settings = _settings()
    inbox, workspace = _inbox(settings), open_workspace(settings.store)
    with record_run("fetch", f"{mission} sol {sols}", workspace) as record:
        report = fetch_archive.fn(mission, sols, list(instruments), inbox, dry_run=dry_run)
        record.add_lines([*report.warnings, *report.files])
        record.fail_if(report.failures)
    return report


def _settings() -> Settings:
    """The settings of the service; also makes the process of a run end with the scheduler."""
    if multiprocessing.parent_process() is not None:
        die_with_parent()
    settings = Settings()
    if not settings.store.is_absolute():  # a worker runs every flow in a folder of its own
        raise ConfigError(f"SOLMAP_STORE is {settings.store}; name the store by its whole path")
    return settings


def _inbox(settings: Settings) -> Path:
    if settings.inbox is None:
        raise ConfigError("no inbox is watched; set SOLMAP_INBOX or start `solmap up --inbox`")
    return settings.inbox
