"""Commands that process: a downlink, a mission anew, an archive's images, manual ties; servers."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from solmap.config.settings import Settings
from solmap.flows.cli.console import StoreOption, fail, note, progress_shown, say, store_of
from solmap.flows.runtime.engine import start_engine
from solmap.products.store.locks import try_lock

if TYPE_CHECKING:
    from solmap.flows.fetch import FetchReport

PipelineOption = Annotated[
    str | None,
    typer.Option("--pipeline", help="Shipped pipeline or a TOML file. [env: SOLMAP_PIPELINE]"),
]


def run(
    downlink: Annotated[Path, typer.Argument(help="Folder searched for images and vector files")],
    store: StoreOption = None,
    pipeline: PipelineOption = None,
) -> None:
    """Take a downlink from raw images to published layers; a second run does nothing twice."""
    if not downlink.is_dir():
        fail(f"{downlink} is no folder; name the folder that the downlink's files lie in")
    root = store_of(store)
    from solmap.config.records import ConfigError  # noqa: PLC0415
    from solmap.products.errors import ProductError  # noqa: PLC0415

    try:
        start_engine(root)
        with progress_shown():
            from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - Prefect is ready now

            report = process_downlink(downlink.resolve(), root, pipeline or Settings().pipeline)
    except (ConfigError, ProductError, TimeoutError) as error:
        fail(str(error))
    for line in report.warnings:
        note("warning", line)
    for line in report.failures:
        note("failed", line)
    for line in report.lines:
        say(line)
    if not report.succeeded:
        raise typer.Exit(1)


def adjust(
    mission: Annotated[str, typer.Option(help="MER2 (Spirit), MER1 (Opportunity), ...")],
    store: StoreOption = None,
    pipeline: PipelineOption = None,
    *,
    overall: Annotated[
        bool, typer.Option("--overall", help="All stops and all ties in one adjustment.")
    ] = False,
) -> None:
    """Adjust a mission again, and map again the stops that move; later sols go on from there."""
    if not overall:
        fail("say --overall: sol by sol a mission is adjusted by `solmap run`")
    root = store_of(store)
    from solmap.config.records import ConfigError  # noqa: PLC0415
    from solmap.products.errors import ProductError  # noqa: PLC0415

    try:
        start_engine(root)
        with progress_shown():
            from solmap.flows.overall import readjust  # noqa: PLC0415 - Prefect is ready now

            report = readjust(mission.upper(), root, pipeline or Settings().pipeline)
    except (ConfigError, ProductError, TimeoutError) as error:
        fail(str(error))
    for line in report.failures:
        note("failed", line)
    for line in report.notes:
        say(line)
    if report.failures:
        raise typer.Exit(1)


def fetch(
    mission: Annotated[str, typer.Option(help="MER2 (Spirit) or MER1 (Opportunity)")],
    sols: Annotated[str, typer.Option(help="155, 155-157, or several with commas between")],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder to bring the images to")],
    instrument: Annotated[
        list[str] | None, typer.Option(help="navcam, pancam, hazcam; may be given again")
    ] = None,
    archive: Annotated[
        Path | None, typer.Option(help="TOML file of addresses. [env: SOLMAP_ARCHIVE]")
    ] = None,
    *,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what there is.")] = False,
) -> None:
    """Bring the stereo pairs of some sols here from the archive; a second call goes on."""
    from solmap.config.records import ConfigError  # noqa: PLC0415
    from solmap.tasks.fetch.answers import FetchError  # noqa: PLC0415

    try:
        start_engine(out_dir / ".fetch")
        with progress_shown():
            from solmap.flows.fetch import fetch_archive  # noqa: PLC0415 - Prefect is ready now

            report = fetch_archive(
                mission,
                sols,
                instrument or ["navcam"],
                out_dir,
                dry_run=dry_run,
                archive_file=archive,
            )
    except (ConfigError, FetchError, TimeoutError) as error:
        fail(str(error))
    _print_fetch_report(report)


def ties(
    file: Annotated[Path, typer.Argument(help="Manual ties, CSV or GeoJSON")],
    store: StoreOption = None,
) -> None:
    """Take a file of manual ties into the store; the next run adds, vetoes and moves them."""
    from solmap.flows.external_data import take_ties_file  # noqa: PLC0415
    from solmap.photogrammetry.errors import PhotogrammetryError  # noqa: PLC0415

    try:
        taken = take_ties_file(file, store_of(store))
    except (PhotogrammetryError, OSError) as error:
        fail(str(error))
    for name in taken.strangers:
        note("warning", f"{name} is not in the store (yet)")
    say(taken)


def serve(
    store: StoreOption = None,
    port: Annotated[int | None, typer.Option(help="Port. [env: SOLMAP_PORT]")] = None,
    host: Annotated[str | None, typer.Option(help="Address. [env: SOLMAP_HOST]")] = None,
) -> None:
    """Serve the map, its tiles and features; the API is described at /docs."""
    import uvicorn  # noqa: PLC0415

    settings = Settings()
    address, listening_port = host or settings.host, port or settings.port
    os.environ["SOLMAP_STORE"] = str(store_of(store).resolve())
    say(f"map at http://{address}:{listening_port}/  (Ctrl-C stops)")
    uvicorn.run(
        "solmap.gis_server.app:create_app_from_settings",
        factory=True,
        host=address,
        port=listening_port,
        log_level="warning",
        timeout_graceful_shutdown=2,  # browsers that listen for events never hang up
    )


def up(
    store: StoreOption = None,
    inbox: Annotated[
        Path | None, typer.Option(help="Folder that downlinks arrive in. [env: SOLMAP_INBOX]")
    ] = None,
    port: Annotated[int | None, typer.Option(help="Port of the map. [env: SOLMAP_PORT]")] = None,
) -> None:
    """Run everything: the map, the schedules, and whatever arrives in the inbox. Ctrl-C stops."""
    from solmap.flows.service.machine import LOOK_EVERY_S, Machine  # noqa: PLC0415 - `solmap --help` answers at once

    settings = Settings()
    root = (store or settings.store).resolve()
    given = {"store": root, "inbox": inbox or settings.inbox, "port": port or settings.port}
    settings = settings.model_copy(update=given)
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    with try_lock(root / "up.lock") as is_alone:
        if not is_alone:
            fail(f"another `solmap up` runs on {root}; stop it first")
        machine = Machine(settings, say)
        try:
            machine.start()
            say(f"map at http://{settings.host}:{settings.port}/")
            say(f"runs at {machine.engine_url}/  (Ctrl-C stops both)")
            while not stopping.wait(LOOK_EVERY_S):
                machine.tend()
        except TimeoutError as error:
            fail(str(error))
        finally:
            machine.stop()


def _print_fetch_report(report: FetchReport) -> None:
    """Print how a fetch ended, and exit with 1 where something failed."""
    for line in report.warnings:
        note("warning", line)
    for line in report.failures:
        note("failed", line)
    for line in report.lines:
        say(line)
    if not report.succeeded:
        raise typer.Exit(1)


COMMANDS = (run, adjust, fetch, ties, serve, up)
"""As the command line has them."""
