"""Commands that process: a downlink, a mission anew, an archive's images, manual ties; servers."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from solmap.config.settings import Settings
from solmap.flows.cli.console import StoreOption, fail, note, progress_shown, say, store_of
from solmap.flows.runtime.engine import password_file, start_engine
from solmap.flows.runtime.stopping import end_on_signals
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
    folder, root, recipe = downlink.resolve(), store_of(store).absolute(), _pipeline_of(pipeline)
    with _engine_of(root):
        from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - Prefect is ready now

        report = process_downlink(folder, root, recipe)
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
    root, recipe = store_of(store).absolute(), _pipeline_of(pipeline)
    with _engine_of(root):
        from solmap.flows.overall import readjust  # noqa: PLC0415 - Prefect is ready now

        report = readjust(mission.upper(), root, recipe)
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
    folder = out_dir.absolute()
    addresses = (archive or Settings().archive).absolute()
    with _engine_of(folder / ".fetch"):
        from solmap.flows.fetch import fetch_archive  # noqa: PLC0415 - Prefect is ready now

        report = fetch_archive(
            mission,
            sols,
            instrument or ["navcam"],
            folder,
            dry_run=dry_run,
            archive_file=addresses,
        )
    _print_fetch_report(report)


def ties(
    file: Annotated[Path, typer.Argument(help="Manual ties, CSV or GeoJSON")],
    store: StoreOption = None,
) -> None:
    """Take a file of manual ties into the store; the next run adds, vetoes and moves them."""
    from solmap.flows.external_data import take_ties_file  # noqa: PLC0415

    taken = take_ties_file(file, store_of(store))
    for name in taken.strangers:
        note("warning", f"{name} is not in the store (yet)")
    say(taken)


def serve(
    store: StoreOption = None,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port. [env: SOLMAP_PORT]")
    ] = None,
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
        proxy_headers=bool(settings.trusted_proxies),
        forwarded_allow_ips=settings.trusted_proxies,
    )


def up(
    store: StoreOption = None,
    inbox: Annotated[
        Path | None, typer.Option(help="Folder that downlinks arrive in. [env: SOLMAP_INBOX]")
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of the map. [env: SOLMAP_PORT]")
    ] = None,
) -> None:
    """Run everything: the map, the schedules, and whatever arrives in the inbox. Ctrl-C stops."""
    from solmap.flows.service.machine import LOOK_EVERY_S, Machine  # noqa: PLC0415 - `solmap --help` answers at once

    settings = Settings()
    root, folder = (store or settings.store).resolve(), inbox or settings.inbox
    files = {name: value.absolute() for name, value in settings if isinstance(value, Path)}
    given = {
        **files,
        "store": root,
        "inbox": folder.resolve() if folder else None,
        "port": port or settings.port,
        "pipeline": _pipeline_of(None),
    }
    settings = settings.model_copy(update=given)
    stopping = threading.Event()
    with end_on_signals(stopping.set), try_lock(root / "up.lock") as is_alone:
        if not is_alone:
            fail(f"another `solmap up` runs on {root}; stop it first")
        machine = Machine(settings, say)
        try:
            machine.start()
            say(f"map at http://{settings.host}:{settings.port}/")
            say(f"runs at {machine.engine_url}/, password in {password_file(root)}")
            say("Ctrl-C stops both")
            while not stopping.wait(LOOK_EVERY_S):
                machine.tend()
        finally:
            machine.stop()
    say("stopped; what was made is kept")


@contextmanager
def _engine_of(store: Path) -> Iterator[None]:
    """An engine for the block, and its progress shown."""
    with end_on_signals():
        start_engine(store)
        with progress_shown():
            yield


def _pipeline_of(given: str | None) -> str:
    """The name of a shipped pipeline, or the whole path of a file."""
    name = given or Settings().pipeline
    from solmap.config.pipeline import SHIPPED  # noqa: PLC0415 - `solmap --help` answers at once

    return name if (SHIPPED / f"{name}.toml").is_file() else str(Path(name).absolute())


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
