"""`solmap traverse`: compare, import and export traverses (`flows.traverse` does the work)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solmap.flows.cli.console import (
    MISSION_HELP,
    JsonOption,
    MissionOption,
    StoreOption,
    existing_store,
    fail,
    input_file,
    mission_name,
    mission_of,
    note,
    print_line,
    show_rows,
    store_of,
)

app = typer.Typer(
    name="traverse", help="Compare, import and export traverses.", no_args_is_help=True
)

Files = Annotated[
    list[Path],
    typer.Argument(
        help="Traverse tables, .svf, .rvf, PLACES tables, locations.xml of one mission",
        parser=input_file,
    ),
]
Mission = Annotated[str, typer.Option(help=MISSION_HELP, parser=mission_name, metavar="MISSION")]
COLUMNS = ["where", "stop", "sol", "distance_m", "horizontal_m", "percent", "elevation_m"]


@app.command()
def compare(  # noqa: PLR0913 - options
    files: Files,
    mission: Mission = "MER2",
    first_sol: Annotated[int, typer.Option(help="Begin the comparison here")] = 0,
    last_sol: Annotated[int, typer.Option(help="End it here")] = 1 << 30,
    figure: Annotated[Path | None, typer.Option(help="Write map and plots, SVG")] = None,
    *,
    every_sol: Annotated[bool, typer.Option("--sols", help="A row for every sol.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Differences of telemetry from the localised traverse, as the paper reports them."""
    from solmap.flows.traverse import compare_files  # noqa: PLC0415 - slow to import

    found = compare_files(files, mission, (first_sol, last_sol), figure)
    for line in found.notes:
        note("note", line)
    show_rows(found.rows(every_sol=every_sol), COLUMNS, as_json)
    if not as_json:
        print_line(found.as_a_whole)


@app.command("import")
def take(files: Files, mission: Mission = "MER2", store: StoreOption = None) -> None:
    """Put a mission's traverse on the map: lines and stops of every solution in the files."""
    root = existing_store(store)
    from solmap.flows.traverse import import_files  # noqa: PLC0415 - slow to import

    print_line(import_files(files, mission, root))


@app.command()
def export(
    folder: Annotated[Path, typer.Argument(help="Where to write the files")],
    mission: MissionOption = None,
    store: StoreOption = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """Export the adjusted traverse: PLACES table, vector files, differences, figure."""
    from solmap.flows.traverse import export_files  # noqa: PLC0415 - slow to import

    root = store_of(store)
    name = mission_of(mission, root)
    made = export_files(folder, name, root)
    if not made:
        fail(f"no adjusted traverse of {name} is in the store: run its downlink first")
    if as_json:
        show_rows([{"file": str(file)} for file in made], [], as_json)
        return
    for file in made:
        print_line(file)


@app.command("georeference")
def georeference_track(
    file: Annotated[
        Path,
        typer.Argument(
            help="CSV: name, mosaic_x_m, mosaic_y_m, east_m, north_m", parser=input_file
        ),
    ],
    *,
    affine: Annotated[bool, typer.Option("--affine", help="Six parameters, not four.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Georeference an uncontrolled mosaic by points of the traverse: rotation, scale, residuals."""
    from solmap.flows.traverse import georeference_mosaic  # noqa: PLC0415 - slow to import

    found = georeference_mosaic(file, affine=affine)
    if as_json:
        show_rows([found.document()], [], as_json)
        return
    show_rows(found.rows(), list(found.rows()[0]), as_json)
    print_line(found.summary)


@app.command("simulate-mosaic")
def simulate_points(
    file: Annotated[Path, typer.Argument(help="Where to write the points, CSV")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random points")] = 1,
    rotation: Annotated[
        float,
        typer.Option(min=-360, max=360, help="Rotation of the mosaic against the map, degrees"),
    ] = 1.3,
) -> None:
    """Simulate points of a track in a mosaic, with the true result beside them (.truth.json)."""
    from solmap.flows.traverse import write_simulated  # noqa: PLC0415 - slow to import

    truth = write_simulated(file, seed, rotation)
    print_line(f"{file}; the answer is in {truth}")
