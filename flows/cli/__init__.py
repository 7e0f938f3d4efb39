"""The command line, `solmap`: commands read arguments, call flows, and print.

Anything may be imported but `gis_server`, and nothing else imports this package. Modules that
compute are imported where they are used, because Prefect reads its settings at import and because
`solmap --help` should answer at once.
"""

from __future__ import annotations

from typing import Annotated

import typer

from solmap.flows.cli import configuration, maintenance, processing, results, simulation, terrain
from solmap.flows.cli.orbital import control, orbital
from solmap.flows.cli.traverse import app as traverse

app = typer.Typer(
    help="From a Mars rover's stereo images to maps in the browser.",
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
)

for _name, _group in (
    ("traverse", traverse),
    ("orbital", orbital),
    ("control", control),
    ("dip", terrain.dip),
    ("token", maintenance.tokens),
    ("config", configuration.config),
):
    app.add_typer(_group, name=_name)
for _command in (
    *processing.COMMANDS,
    *results.COMMANDS,
    *simulation.COMMANDS,
    terrain.stl,
    maintenance.prune,
):
    app.command()(_command)
app.command("judge", hidden=True)(simulation.evaluate)  # its name until 0.1


def _print_version(wanted: bool) -> None:  # noqa: FBT001 - as Typer calls it
    if wanted:
        from solmap import __version__  # noqa: PLC0415

        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def main(
    *,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """From a Mars rover's stereo images to maps in the browser."""
