"""`solmap orbital`: an orbital image under the rover's map (`flows.orbital` does the work)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solmap.flows.console import fail, out
from solmap.flows.options import store_of

app = typer.Typer(help="Orbital images under the rover's map.", no_args_is_help=True)


ShiftSigma = Annotated[
    float, typer.Option(help="Standard deviation of its georeference east and north, metres")
]
RotationSigma = Annotated[float, typer.Option(help="The same of its rotation, degrees")]


@app.command()
def add(  # noqa: PLR0913 - options
    file: Annotated[Path, typer.Argument(help="A georeferenced image, any Mars CRS")],
    mission: Annotated[str, typer.Option(help="MER2 (Spirit), MER1 (Opportunity) ...")] = "MER2",
    store: Annotated[
        Path | None, typer.Option("--store", help="Folder of products. [env: SOLMAP_STORE]")
    ] = None,
    reach: Annotated[
        float, typer.Option(help="How far off it, or a stop, may be, metres", min=1.0, max=200.0)
    ] = 12.0,
    shift_sigma: ShiftSigma = 50.0,
    rotation_sigma: RotationSigma = 0.1,
    *,
    as_claimed: Annotated[
        bool, typer.Option("--as-claimed", help="Trust its georeference; register nothing.")
    ] = False,
    heights: Annotated[
        bool, typer.Option("--dtm", help="It is a terrain model: heights are compared.")
    ] = False,
    no_control: Annotated[
        bool, typer.Option("--no-control", help="Do not find the stops in it one by one.")
    ] = False,
) -> None:
    """Find where an orbital image lies on the rover's map, and show it there as base layer."""
    from solmap.flows.orbital import OrbitalWish, add_orbital  # noqa: PLC0415 - slow to import
    from solmap.products.errors import ProductError  # noqa: PLC0415
    from solmap.tasks.control import FrameParams  # noqa: PLC0415

    try:
        frame = None if no_control else FrameParams(shift_sigma, rotation_sigma)
        wish = OrbitalWish(registered=not as_claimed, reach_m=reach, control=frame, heights=heights)
        said = add_orbital(file, mission.upper(), store_of(store), wish)
    except (ProductError, OSError) as error:
        fail(str(error))
    for line in said:
        out.print(line, highlight=False)


@app.callback()
def group() -> None:
    """Orbital images under the rover's map."""
