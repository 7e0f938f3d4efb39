"""Commands that show the content of a store, outcomes of sols and adjustments, and images."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from solmap.flows.cli.console import (
    MISSION_HELP,
    JsonOption,
    KindFilter,
    MissionFilter,
    SolFilter,
    StoreOption,
    existing_store,
    fail,
    mission_name,
    mission_of,
    note,
    print_line,
    select_rows,
    show_rows,
    workspace_of,
)


def positions(
    store: StoreOption = None,
    mission: MissionFilter = None,
    sol: SolFilter = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """Telemetry and adjusted position of every stop, in the landing-site frame (LSL)."""
    from solmap.flows.cli.tables import position_rows  # noqa: PLC0415 - slow to import

    rows = select_rows(position_rows(workspace_of(store)), mission, sol)
    show_rows(
        rows, ["stop", "telemetry_ned_m", "adjusted_ned_m", "sigma_ned_m", "held_by"], as_json
    )


def products(
    store: StoreOption = None,
    mission: MissionFilter = None,
    sol: SolFilter = None,
    kind: KindFilter = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """Every published product and the file it lies in."""
    from solmap.flows.cli.tables import product_rows  # noqa: PLC0415 - slow to import

    rows = select_rows(product_rows(workspace_of(store)), mission, sol, kind)
    show_rows(rows, ["kind", "scope", "sols", "cell_m", "path"], as_json)


def status(
    store: StoreOption = None,
    mission: MissionFilter = None,
    sol: SolFilter = None,
    *,
    timings: Annotated[
        bool, typer.Option("--timings", help="Time and memory of the latest products, by kind.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """How the last processing of every file and sol ended."""
    from solmap.flows.cli.tables import outcome_rows, timing_rows  # noqa: PLC0415 - slow to import

    if timings:
        columns = ["kind", "count", "seconds", "cpu_s", "peak_rss_mb"]
        show_rows(timing_rows(workspace_of(store)), columns, as_json)
        return
    rows = select_rows(outcome_rows(workspace_of(store)), mission, sol)
    show_rows(rows, ["subject", "ended", "notes"], as_json)


def report(  # noqa: PLR0913 - the words of the command
    mission_of_sol: Annotated[
        str | None,
        typer.Argument(
            metavar="MISSION", parser=mission_name, help=f"{MISSION_HELP}; with a sol: its report"
        ),
    ] = None,
    sol: Annotated[int | None, typer.Argument(metavar="SOL", min=0, max=999_999)] = None,
    store: StoreOption = None,
    out: Annotated[Path | None, typer.Option(help="The sol's report: .html or .pdf")] = None,
    mission: MissionFilter = None,
    sols: SolFilter = None,
    *,
    as_json: JsonOption = False,
    show: Annotated[bool, typer.Option("--open", help="Open the last one in the browser.")] = False,
) -> None:
    """A sol as one page (`report MER2 156`), or the quality of every adjustment, in rows."""
    from solmap.flows.cli.tables import report_rows, write_sol_report  # noqa: PLC0415 - as above

    if mission_of_sol is not None:
        if sol is None:
            fail(f"name the sol too: `solmap report {mission_of_sol} 156 --out FILE`")
        name = mission_of(mission_of_sol, store)
        target = out or Path(f"{name.lower()}-sol{sol:04d}.html")
        write_sol_report(name, sol, workspace_of(store), target)
        print_line(target)
        if show:
            typer.launch(str(target.resolve()))
        return
    workspace = workspace_of(store)
    of_mission = mission and mission_of(mission, store)
    rows = select_rows(report_rows(workspace), of_mission, sols)
    show_rows(rows, ["adjustment", "made_at", "page"], as_json)
    if show and rows:
        typer.launch(rows[-1]["page"])


def rig(
    store: StoreOption = None,
    mission: MissionFilter = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """Differences of stereo rigs from their labels: applied and remaining corrections.

    Of every camera set: the rotation of the right camera about three axes of the pair (x right, y
    down, z forward; about y is toe-in) that matching applies, and the remaining rotation and
    baseline error that the latest network finds, with standard deviations. Values above three of
    them are marked. Nothing is changed.
    """
    from solmap.flows.cli.tables import rig_correction_rows  # noqa: PLC0415

    name = mission and mission_of(mission, store)
    rows = rig_correction_rows(workspace_of(store), name)
    if as_json or not rows:
        show_rows(rows, [], as_json)
        return
    shown = [
        row
        | {name: f"{row[name]:.4f}" for name in ("applied", "value", "sigma")}
        | {"stands_out": "yes" if row["stands_out"] else ""}
        for row in rows
    ]
    columns = ["mission", "camera", "pairs", "component", "applied", "value", "sigma", "unit"]
    show_rows(shown, [*columns, "stands_out", "parallax_px"], as_json)
    for row in {row["mission"]: row for row in rows}.values():
        print_line(
            f"{row['mission']}: sigma0 {row['sigma0_labelled']:.3f} with rigs as matched, "
            f"{row['sigma0_corrected']:.3f} with what the network finds; nothing was changed"
        )


def inspect(
    files: Annotated[
        list[Path], typer.Argument(help="Images (.img, .png, .jpg) or labels (.lbl, .xml)")
    ],
    png: Annotated[
        Path | None, typer.Option(help="Write the image stretched to eight bits")
    ] = None,
    linearised: Annotated[
        Path | None,
        typer.Option(
            help="Write it linearised by JPL's rule, with the stereo partner that lies beside it"
        ),
    ] = None,
    points: Annotated[
        Path | None, typer.Option(help="Write the points of an XYZ raster, PLY")
    ] = None,
    store: Annotated[
        Path | None,
        typer.Option(help="Compare a raster with what this store measured in the same image"),
    ] = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """Describe an image: time, place, viewing direction, camera and partner.

    For a derived raster (XYZ, range, slope ...): content, unit and frame of its bands, and their
    difference from those of a store.
    """
    from solmap.flows.cli.inspection import (  # noqa: PLC0415
        InspectionError,
        inspect_files,
        write_linearised,
        write_png,
        write_points,
    )
    from solmap.flows.cli.inspection_text import report_of  # noqa: PLC0415

    options = {"png": png, "linearised": linearised, "points": points}
    out = {option: path for option, path in options.items() if path is not None}
    for option in out:
        if len(files) != 1:
            fail(f"--{option} writes one image, but {len(files)} are named")
    findings, faults = inspect_files(files, None if store is None else existing_store(store))
    if as_json:
        typer.echo(json.dumps(findings, indent=2))
    else:
        lines = [line for finding in findings for line in ("", *report_of(finding))]
        for line in lines[1:]:
            print_line(line)
    writers = {"png": write_png, "linearised": write_linearised, "points": write_points}
    try:
        for option, path in () if faults else out.items():
            writers[option](files[0], path)
    except InspectionError as error:
        faults.append(str(error))
    for fault in faults:
        note("error", fault)
    if faults:
        raise typer.Exit(1)
