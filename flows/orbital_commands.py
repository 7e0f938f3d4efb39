"""`solmap orbital`: an orbital image under the rover's map (`flows.orbital` does the work)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from config.settings import Settings
from flows.console import fail, out

app = typer.Typer(help="Orbital images under the rover's map.", no_args_is_help=True)


@app.command()
def add(
    file: Annotated[Path, typer.Argument(help="A georeferenced image, any Mars CRS")],
    mission: Annotated[str, typer.Option(help="MER2 (Spirit), MER1 (Opportunity) ...")] = "MER2",
    store: Annotated[
        Path | None, typer.Option("--store", help="Folder of products. [env: SOLMAP_STORE]")
    ] = None,
    *,
    as_claimed: Annotated[
        bool, typer.Option("--as-claimed", help="Trust its georeference; register nothing.")
    ] = False,
) -> None:
    """Find where an orbital image lies on the rover's map, and show it there as base layer."""
    from flows.orbital import add_orbital  # noqa: PLC0415 - slow to import
    from products.errors import ProductError  # noqa: PLC0415

    try:
        said = add_orbital(
            file, mission.upper(), store or Settings().store, registered=not as_claimed
        )
    except (ProductError, OSError) as error:
        fail(str(error))
    out.print(said, highlight=False)


@app.callback()
def group() -> None:
    """Orbital images under the rover's map."""
