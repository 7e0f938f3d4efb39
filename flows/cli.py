"""The command line: `solmap run`, `serve`, `fetch`, `inspect`, `positions`, `products` and more.

Modules are imported where they are used, because Prefect reads its settings at import and because
`solmap --help` should answer at once.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from config.settings import Settings
from flows.console import errors, fail, out, progress_shown, show_rows, workspace_of
from flows.control_commands import app as control
from flows.dip_commands import app as dip
from flows.engine_server import start_engine
from flows.orbital_commands import app as orbital
from flows.token_commands import app as token
from flows.traverse_commands import app as traverse
from flows.up_commands import up

if TYPE_CHECKING:
    from flows.fetch import FetchReport

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

StoreOption = Annotated[
    Path | None, typer.Option("--store", help="Folder of products. [env: SOLMAP_STORE]")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]


def _store(given: Path | None) -> Path:
    return given or Settings().store


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
    root = _store(store)
    from config.errors import ConfigError  # noqa: PLC0415
    from products.errors import ProductError  # noqa: PLC0415

    try:
        start_engine(root)
        with progress_shown():
            from flows.downlink import process_downlink  # noqa: PLC0415 - Prefect is ready now

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
    root = _store(store)
    from config.errors import ConfigError  # noqa: PLC0415
    from products.errors import ProductError  # noqa: PLC0415

    try:
        start_engine(root)
        with progress_shown():
            from flows.overall import readjust  # noqa: PLC0415 - Prefect is ready now

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
    from flows.ties import take_ties_file  # noqa: PLC0415
    from photogrammetry.errors import PhotogrammetryError  # noqa: PLC0415

    try:
        taken = take_ties_file(file, _store(store))
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
    os.environ["SOLMAP_STORE"] = str(_store(store).resolve())
    out.print(f"map at http://{address}:{listening_port}/  (Ctrl-C stops)", highlight=False)
    uvicorn.run(
        "gis_server.app:create_app_from_settings",
        factory=True,
        host=address,
        port=listening_port,
        log_level="warning",
        timeout_graceful_shutdown=2,  # browsers that listen for events never hang up
    )


@app.command()
def positions(store: StoreOption = None, *, as_json: JsonOption = False) -> None:
    """Where the rover stood: telemetry and adjusted position of every stop, in the LSL."""
    from flows.listing import position_rows  # noqa: PLC0415

    rows = position_rows(workspace_of(_store(store)))
    show_rows(
        rows, ["stop", "telemetry_ned_m", "adjusted_ned_m", "sigma_ned_m", "held_by"], as_json
    )


@app.command()
def products(store: StoreOption = None, *, as_json: JsonOption = False) -> None:
    """Every published product and the file it lies in."""
    from flows.listing import product_rows  # noqa: PLC0415

    rows = product_rows(workspace_of(_store(store)))
    show_rows(rows, ["kind", "scope", "cell_m", "path"], as_json)


@app.command()
def status(store: StoreOption = None, *, as_json: JsonOption = False) -> None:
    """How the last processing of every file and sol ended."""
    from flows.listing import outcome_rows  # noqa: PLC0415

    rows = outcome_rows(workspace_of(_store(store)))
    show_rows(rows, ["subject", "ended", "notes"], as_json)


@app.command()
def report(
    store: StoreOption = None,
    mission: Annotated[str | None, typer.Option(help="MER2 (Spirit), MER1 ...; or all")] = None,
    *,
    as_json: JsonOption = False,
    show: Annotated[bool, typer.Option("--open", help="Open the last one in the browser.")] = False,
) -> None:
    """How good every adjustment is: the page and the figures of its quality report."""
    from flows.report import report_rows  # noqa: PLC0415

    rows = report_rows(workspace_of(_store(store)), mission)
    show_rows(rows, ["adjustment", "made_at", "page"], as_json)
    if show and rows:
        typer.launch(rows[-1]["page"])


@app.command()
def simulate(
    out_dir: Annotated[Path, typer.Argument(help="Folder to write the downlink to")],
    stops: Annotated[int, typer.Option(help="Number of stops", min=1, max=100)] = 2,
    seed: Annotated[int, typer.Option(help="Repeats a world bit for bit")] = 1,
    terrain: Annotated[str, typer.Option(help="plains, hills or crater")] = "hills",
) -> None:
    """Make a synthetic downlink with known truth: PDS3 images, vector files and the truth."""
    from flows.simulation import write_downlink  # noqa: PLC0415

    with progress_shown():
        files = write_downlink(out_dir, stops=stops, seed=seed, terrain=terrain)
    out.print(f"{files} files in {out_dir}; {out_dir / 'truth'} is for judging only")


@app.command("simulate-mission")
def simulate_mission(
    store: StoreOption = None,
    stops: Annotated[int, typer.Option(help="Number of stops", min=2, max=500)] = 500,
    distance: Annotated[float, typer.Option(help="Metres driven", min=1.0)] = 7000.0,
    gaps: Annotated[int, typer.Option(help="Places where images tie nothing", min=0)] = 10,
    control: Annotated[int, typer.Option(help="Stops to an orbital tie; 0: none", min=0)] = 10,
    seed: Annotated[int, typer.Option(help="Repeats a mission bit for bit")] = 1,
) -> None:
    """Fill an empty store with a simulated mission of many stops and no images, for the map."""
    root = _store(store)
    from photogrammetry.errors import PhotogrammetryError  # noqa: PLC0415
    from photogrammetry.synthetic.mission import MissionPlan  # noqa: PLC0415

    try:
        plan = MissionPlan(stops=stops, distance_m=distance, gaps=gaps, control_every=control)
        start_engine(root)
        with progress_shown():
            from flows.simulated_mission import simulate_into  # noqa: PLC0415 - Prefect is ready now

            told = simulate_into(root, plan, seed)
    except PhotogrammetryError as error:
        fail(str(error))
    out.print(told, highlight=False)


@app.command()
def judge(
    truth: Annotated[Path, typer.Argument(help="Folder `truth` of a simulated downlink")],
    store: StoreOption = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """State the errors of positions and terrain against a simulated world's truth."""
    from flows.judgement import judge_positions, judge_terrain, true_stops  # noqa: PLC0415
    from flows.listing import position_rows  # noqa: PLC0415

    workspace = workspace_of(_store(store))
    positions_judged = judge_positions(position_rows(workspace), true_stops(truth))
    terrain_judged = judge_terrain(workspace, truth)
    if as_json:
        show_rows([{"positions": positions_judged, "terrain": terrain_judged}], [], as_json)
        return
    show_rows(positions_judged, list(positions_judged[0]) if positions_judged else [], as_json)
    show_rows(terrain_judged, list(terrain_judged[0]) if terrain_judged else [], as_json)


@app.command()
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
    from config.errors import ConfigError  # noqa: PLC0415
    from tasks.fetch.errors import FetchError  # noqa: PLC0415

    try:
        start_engine(out_dir / ".fetch")
        with progress_shown():
            from flows.fetch import fetch_archive  # noqa: PLC0415 - Prefect is ready now

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


@app.command()
def inspect(
    files: Annotated[
        list[Path], typer.Argument(help="Images (.img, .png, .jpg) or labels (.lbl, .xml)")
    ],
    png: Annotated[Path | None, typer.Option(help="Write a stretched picture of the image")] = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """What an image is: when and where it was taken, where it looks, its camera and partner."""
    from flows.inspection import InspectionError, inspect_files, write_png  # noqa: PLC0415
    from flows.inspection_text import report_of  # noqa: PLC0415

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


if __name__ == "__main__":
    app()
