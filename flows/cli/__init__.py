"""The command line: `solmap run`, `serve`, `fetch`, `inspect`, `positions`, `products` and more.

Modules are imported where they are used, because Prefect reads its settings at import and because
`solmap --help` should answer at once.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from solmap.config.settings import Settings
from solmap.flows.cli import processing as archive_commands
from solmap.flows.cli import simulation as simulation_commands
from solmap.flows.cli.console import (
    JsonOption,
    StoreOption,
    errors,
    fail,
    out,
    progress_shown,
    show_rows,
    store_of,
    workspace_of,
)
from solmap.flows.cli.maintenance import prune
from solmap.flows.cli.maintenance import token_app as token
from solmap.flows.cli.orbital import control, orbital
from solmap.flows.cli.processing import up
from solmap.flows.cli.terrain import dip, stl
from solmap.flows.cli.traverse import app as traverse
from solmap.flows.runtime.engine import start_engine

app = typer.Typer(
    help="From a Mars rover's stereo images to maps in the browser.",
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
)

app.add_typer(traverse, name="traverse")
app.add_typer(orbital, name="orbital")
app.add_typer(control, name="control")
app.add_typer(dip, name="dip")
app.add_typer(token, name="token")
app.command()(up)
app.command()(stl)
app.command()(prune)


@app.command()
def run(
    downlink: Annotated[Path, typer.Argument(help="Folder searched for images and vector files")],
    store: StoreOption = None,
    pipeline: Annotated[
        str | None, typer.Option(help="Shipped pipeline or a TOML file. [env: SOLMAP_PIPELINE]")
    ] = None,
) -> None:
    """Take a downlink from raw images to published layers; a second run does nothing twice."""
    if not downlink.is_dir():
        fail(f"{downlink} is no folder; name the folder that the downlink's files lie in")
    root = store_of(store)
    from solmap.config.errors import ConfigError  # noqa: PLC0415
    from solmap.products.errors import ProductError  # noqa: PLC0415

    try:
        start_engine(root)
        with progress_shown():
            from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - Prefect is ready now

            report = process_downlink(downlink.resolve(), root, pipeline or Settings().pipeline)
    except (ConfigError, ProductError, TimeoutError) as error:
        fail(str(error))
    for line in report.warnings:
        errors.print(f"[yellow]warning[/yellow] {line}", highlight=False)
    for line in report.failures:
        errors.print(f"[red]failed[/red] {line}", highlight=False)
    out.print(str(report), highlight=False)
    if not report.succeeded:
        raise typer.Exit(1)


@app.command()
def adjust(
    mission: Annotated[str, typer.Option(help="MER2 (Spirit), MER1 (Opportunity), ...")],
    store: StoreOption = None,
    pipeline: Annotated[
        str | None, typer.Option(help="Shipped pipeline or a TOML file. [env: SOLMAP_PIPELINE]")
    ] = None,
    *,
    overall: Annotated[
        bool, typer.Option("--overall", help="All stops and all ties in one adjustment.")
    ] = False,
) -> None:
    """Adjust a mission again, and map again the stops that move; later sols go on from there."""
    if not overall:
        fail("say --overall: sol by sol a mission is adjusted by `solmap run`")
    root = store_of(store)
    from solmap.config.errors import ConfigError  # noqa: PLC0415
    from solmap.products.errors import ProductError  # noqa: PLC0415

    try:
        start_engine(root)
        with progress_shown():
            from solmap.flows.overall import readjust  # noqa: PLC0415 - Prefect is ready now

            report = readjust(mission.upper(), root, pipeline or Settings().pipeline)
    except (ConfigError, ProductError, TimeoutError) as error:
        fail(str(error))
    for line in report.failures:
        errors.print("[red]failed[/red] " + escape(line), highlight=False)
    out.print(escape("\n".join(report.notes)), highlight=False)
    if report.failures:
        raise typer.Exit(1)


@app.command()
def ties(
    file: Annotated[Path, typer.Argument(help="Hand ties, CSV or GeoJSON")],
    store: StoreOption = None,
) -> None:
    """Take a file of hand ties into the store; the next run adds, vetoes and moves them."""
    from solmap.flows.external_data import take_ties_file  # noqa: PLC0415
    from solmap.photogrammetry.errors import PhotogrammetryError  # noqa: PLC0415

    try:
        taken = take_ties_file(file, store_of(store))
    except (PhotogrammetryError, OSError) as error:
        fail(escape(str(error)))
    for name in taken.strangers:
        errors.print(f"[yellow]warning[/yellow] {escape(name)} is not in the store (yet)")
    out.print(escape(str(taken)), highlight=False)


@app.command()
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
    out.print(f"map at http://{address}:{listening_port}/  (Ctrl-C stops)", highlight=False)
    uvicorn.run(
        "solmap.gis_server.app:create_app_from_settings",
        factory=True,
        host=address,
        port=listening_port,
        log_level="warning",
        timeout_graceful_shutdown=2,  # browsers that listen for events never hang up
    )


@app.command()
def positions(store: StoreOption = None, *, as_json: JsonOption = False) -> None:
    """Where the rover stood: telemetry and adjusted position of every stop, in the LSL."""
    from solmap.flows.cli.tables import position_rows  # noqa: PLC0415

    rows = position_rows(workspace_of(store_of(store)))
    show_rows(
        rows, ["stop", "telemetry_ned_m", "adjusted_ned_m", "sigma_ned_m", "held_by"], as_json
    )


@app.command()
def products(store: StoreOption = None, *, as_json: JsonOption = False) -> None:
    """Every published product and the file it lies in."""
    from solmap.flows.cli.tables import product_rows  # noqa: PLC0415

    rows = product_rows(workspace_of(store_of(store)))
    show_rows(rows, ["kind", "scope", "cell_m", "path"], as_json)


@app.command()
def status(
    store: StoreOption = None,
    *,
    timings: Annotated[
        bool, typer.Option("--timings", help="What the latest products took, by kind.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """How the last processing of every file and sol ended."""
    from solmap.flows.cli.tables import outcome_rows  # noqa: PLC0415

    if timings:
        from solmap.flows.cli.tables import timing_rows  # noqa: PLC0415

        columns = ["kind", "count", "seconds", "cpu_s", "peak_rss_mb"]
        show_rows(timing_rows(workspace_of(store_of(store))), columns, as_json)
        return
    rows = outcome_rows(workspace_of(store_of(store)))
    show_rows(rows, ["subject", "ended", "notes"], as_json)


@app.command()
def report(  # noqa: PLR0913 - the words of the command
    mission_of_sol: Annotated[
        str | None, typer.Argument(metavar="MISSION", help="with a sol: the report of that sol")
    ] = None,
    sol: Annotated[int | None, typer.Argument(min=0)] = None,
    store: StoreOption = None,
    out: Annotated[Path | None, typer.Option(help="File of the sol's report.")] = None,
    mission: Annotated[str | None, typer.Option(help="MER2 (Spirit), MER1 ...; or all")] = None,
    *,
    as_json: JsonOption = False,
    show: Annotated[bool, typer.Option("--open", help="Open the last one in the browser.")] = False,
) -> None:
    """A sol as one page (`report MER2 156`), or how good every adjustment is, in rows."""
    from solmap.flows.cli.tables import report_rows, write_sol_report  # noqa: PLC0415

    if mission_of_sol is not None:
        if sol is None:
            fail(f"name the sol too: `solmap report {mission_of_sol} 156 --out FILE`")
        target = out or Path(f"{mission_of_sol.lower()}-sol{sol:04d}.html")
        write_sol_report(mission_of_sol, sol, workspace_of(store_of(store)), target)
        typer.echo(str(target))
        if show:
            typer.launch(str(target.resolve()))
        return
    rows = report_rows(workspace_of(store_of(store)), mission)
    show_rows(rows, ["adjustment", "made_at", "page"], as_json)
    if show and rows:
        typer.launch(rows[-1]["page"])


for _command in (*simulation_commands.COMMANDS, *archive_commands.COMMANDS):
    app.command()(_command)
