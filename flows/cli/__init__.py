"""The command line, `solmap`: commands read arguments, call flows, and print.

Anything may be imported but `gis_server`, and nothing else imports this package. Modules that
compute are imported where they are used, because Prefect reads its settings at import and because
`solmap --help` should answer at once.

Commands catch no errors: whatever ends one becomes one line here. Exit codes are 0 where all went
well, 1 where something failed, 2 for wrong arguments, 70 for an error that nobody expected and 130
after Ctrl-C.
"""

from __future__ import annotations

import contextlib
import io
import logging
import sys
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from solmap.config.records import ConfigError
from solmap.config.settings import Settings, unknown_variables
from solmap.flows.cli import (
    configuration,
    maintenance,
    processing,
    results,
    safekeeping,
    simulation,
    terrain,
)
from solmap.flows.cli.console import fail, note
from solmap.flows.cli.orbital import control, orbital
from solmap.flows.cli.traverse import app as traverse
from solmap.flows.runtime.engine import import_prefect

_UNEXPECTED, _INTERRUPTED = 70, 130
_WITH_FLOWS = {"ties", "traverse", "orbital", "control", "dip", "simulate", "stl"}
"""Commands that import flows without an engine."""


class Commands(TyperGroup):
    """All commands; an error that ends one is printed as one line."""

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401 - as Typer has it
        """Run the command that is named."""
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(errors="backslashreplace")
        for line in unknown_variables():
            note("warning", line)
        try:
            return super().invoke(ctx)
        except (TyperException, typer.Exit, typer.Abort, BrokenPipeError):
            raise
        except KeyboardInterrupt:
            note("error", "interrupted; what was made stays")
            raise typer.Exit(_INTERRUPTED) from None
        except Exception as error:  # noqa: BLE001 - nothing else would say it in one line
            _end_command(error)


def _end_command(error: Exception) -> NoReturn:
    if type(error).__module__.startswith("solmap."):
        fail(str(error))
    if isinstance(error, OSError):
        fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    if isinstance(error, UnicodeEncodeError):
        fail(f"{error.object!a:.100} is no text that can be written as UTF-8")
    if isinstance(error, MemoryError):
        fail("there is not enough memory")
    with contextlib.suppress(ConfigError):
        if Settings().debug:
            raise error
    log = logging.getLogger("solmap")
    files = [one.baseFilename for one in log.handlers if isinstance(one, logging.FileHandler)]
    if files:
        log.error("a command ended unexpectedly", exc_info=error)
    where = f"is in {files[0]}" if files else "is shown with SOLMAP_DEBUG=1"
    note(
        "error",
        f"unexpected {type(error).__name__}: {error}; the traceback {where}, please report it",
    )
    raise typer.Exit(_UNEXPECTED) from error


app = typer.Typer(
    cls=Commands,
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
    *safekeeping.COMMANDS,
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
    context: typer.Context,
    *,
    version: Annotated[  # noqa: ARG001 - its callback prints it
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """From a Mars rover's stereo images to maps in the browser."""
    if context.invoked_subcommand in _WITH_FLOWS and "--help" not in sys.argv:
        import_prefect()
