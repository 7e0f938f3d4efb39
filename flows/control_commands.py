"""`solmap control`: places of stops that people measured (`flows.control` does the work)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solmap.flows.console import fail, out, show_rows
from solmap.flows.options import StoreOption, store_of
from solmap.flows.orbital_commands import RotationSigma, ShiftSigma

app = typer.Typer(help="Places of stops in orbital images, as control.", no_args_is_help=True)

Mission = Annotated[str, typer.Option(help="MER2 (Spirit), MER1 (Opportunity) ...")]


@app.command()
def add(
    file: Annotated[Path, typer.Argument(help="CSV or GeoJSON: stop, place, sigma_m ...")],
    mission: Mission = "MER2",
    store: StoreOption = None,
    shift_sigma: ShiftSigma = 50.0,
    rotation_sigma: RotationSigma = 0.1,
    scale_sigma: Annotated[float, typer.Option(help="The same of its scale")] = 1e-3,
) -> None:
    """Take measured places of stops as control; a file of the same name before counts no more.

    The places may lie on an orbital image that is off as a whole: its place is found with the
    network. With all three standard deviations zero they are places on the map itself.
    """
    from solmap.flows.control import add_control  # noqa: PLC0415 - slow to import
    from solmap.photogrammetry.errors import PhotogrammetryError  # noqa: PLC0415
    from solmap.products.errors import ProductError  # noqa: PLC0415
    from solmap.tasks.control import FrameParams  # noqa: PLC0415

    try:
        params = FrameParams(shift_sigma, rotation_sigma, scale_sigma)
        said = add_control(file, mission.upper(), store_of(store), params)
    except (PhotogrammetryError, ProductError, OSError) as error:
        fail(str(error))
    out.print(said, highlight=False)


@app.command("list")
def show(
    mission: Mission = "MER2",
    store: StoreOption = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Every place that counts as control, by registration or by hand."""
    from solmap.flows.control import control_rows  # noqa: PLC0415 - slow to import

    rows = control_rows(mission.upper(), store_of(store))
    columns = ["frame", "stop", "east_m", "north_m", "sigma_m", "up_m", "azimuth_deg"]
    show_rows(rows, columns, as_json)
