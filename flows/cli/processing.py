"""Commands about files of the archive: bring them here, and look into them.

`solmap up`: everything on one machine.
"""

from __future__ import annotations

import json
import signal
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from solmap.config.settings import Settings
from solmap.flows.cli.console import JsonOption, StoreOption, errors, fail, out, progress_shown
from solmap.flows.runtime.engine import start_engine
from solmap.products.store.locks import alone

if TYPE_CHECKING:
    from solmap.flows.fetch import FetchReport


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
    from solmap.config.errors import ConfigError  # noqa: PLC0415
    from solmap.tasks.fetch.errors import FetchError  # noqa: PLC0415

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
    _end(report)


def inspect(
    files: Annotated[
        list[Path], typer.Argument(help="Images (.img, .png, .jpg) or labels (.lbl, .xml)")
    ],
    png: Annotated[Path | None, typer.Option(help="Write a stretched picture of the image")] = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """What an image is: when and where it was taken, where it looks, its camera and partner."""
    from solmap.flows.cli.inspection import InspectionError, inspect_files, write_png  # noqa: PLC0415
    from solmap.flows.cli.inspection_text import report_of  # noqa: PLC0415

    if png is not None and len(files) != 1:
        fail(f"--png writes the picture of one image, but {len(files)} are named")
    findings, faults = inspect_files(files)
    if as_json:
        typer.echo(json.dumps(findings, indent=2))
    else:
        for number, finding in enumerate(findings):
            typer.echo(("\n" if number else "") + report_of(finding))
    try:
        if png is not None and not faults:
            write_png(files[0], png)
    except InspectionError as error:
        faults.append(str(error))
    for fault in faults:
        errors.print("[red]error[/red] " + escape(fault), highlight=False)
    if faults:
        raise typer.Exit(1)


def _end(report: FetchReport) -> None:
    """Print how a fetch ended, and exit with 1 where something failed."""
    for line in report.warnings:
        errors.print("[yellow]warning[/yellow] " + escape(line), highlight=False)
    for line in report.failures:
        errors.print("[red]failed[/red] " + escape(line), highlight=False)
    out.print(escape(str(report)), highlight=False)
    if not report.succeeded:
        raise typer.Exit(1)


COMMANDS = (fetch, inspect)
"""As the command line has them."""


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
    with alone(root / "up.lock") as is_alone:
        if not is_alone:
            fail(f"another `solmap up` runs on {root}; stop it first")
        machine = Machine(settings, lambda line: out.print(line, highlight=False))
        try:
            machine.start()
            out.print(f"map at http://{settings.host}:{settings.port}/", highlight=False)
            out.print(f"runs at {machine.engine_url}/  (Ctrl-C stops both)", highlight=False)
            while not stopping.wait(LOOK_EVERY_S):
                machine.tend()
        except TimeoutError as error:
            fail(str(error))
        finally:
            machine.stop()
