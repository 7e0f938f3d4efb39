"""The command line, `solmap`: commands read arguments, call flows, and print.

Anything may be imported but `gis_server`, and nothing else imports this package. Modules that
compute are imported where they are used, because Prefect reads its settings at import and because
`solmap --help` should answer at once.

Commands catch no errors: an error that ends one is printed as one line here. Exit codes: 0
for success, 1 for a failure, 2 for wrong arguments, 70 for an unexpected error, 130 after Ctrl-C.
"""

from __future__ import annotations

import io
import logging
import sys
from collections.abc import Callable
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from solmap.flows.cli import (
    export,
    operation,
    orbital,
    processing,
    results,
    simulation,
    terrain,
    traverse,
)
from solmap.flows.cli.console import fail, note
from solmap.photogrammetry.threads import use_one_thread_a_call

_UNEXPECTED, _INTERRUPTED = 70, 130
_WITH_FLOWS = {"ties", "traverse", "orbital", "control", "poses", "dip", "simulate", "stl"}
"""Commands that import flows without an engine."""
_PANELS: dict[str, tuple[Callable[..., None] | typer.Typer, ...]] = {
    "Process": (processing.run, processing.adjust, processing.fetch),
    "Inspect": (
        results.status,
        results.report,
        results.positions,
        results.products,
        results.inspect,
        results.rig,
        terrain.dip,
    ),
    "Export": (export.export, terrain.stl, traverse.app),
    "Correct": (processing.ties, orbital.poses, orbital.control, orbital.orbital),
    "Simulate": (simulation.simulate, simulation.simulate_mission, simulation.evaluate),
    "Operate": (
        processing.serve,
        processing.up,
        operation.backup,
        operation.restore,
        operation.check,
        operation.prune,
        operation.tokens,
        operation.config,
    ),
}
"""The commands as `solmap --help` shows them; groups come last in their panel."""


class Commands(TyperGroup):
    """All commands; an error that ends one is printed as one line."""

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401 - as Typer has it
        """Run the named command."""
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(errors="backslashreplace")
        use_one_thread_a_call()
        if "--help" not in sys.argv:
            from solmap.config.settings import unknown_variables  # noqa: PLC0415 - slow to import

            for line in unknown_variables():
                note("warning", line)
        try:
            return super().invoke(ctx)
        except (TyperException, typer.Exit, typer.Abort, BrokenPipeError):
            raise
        except KeyboardInterrupt:
            note("error", "interrupted; what was made stays")
            raise typer.Exit(_INTERRUPTED) from None
        except Exception as error:  # noqa: BLE001 - nothing else reduces it to one line
            _end_command(error)


def _end_command(error: Exception) -> NoReturn:
    if type(error).__module__.startswith("solmap."):
        fail(str(error))
    if isinstance(error, OSError):
        fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    if isinstance(error, UnicodeEncodeError):
        fail(f"{error.object!a:.100} cannot be written as UTF-8 text")
    if isinstance(error, MemoryError):
        fail("there is not enough memory")
    if _is_debugging():
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


def _is_debugging() -> bool:
    from solmap.config.records import ConfigError  # noqa: PLC0415 - slow to import
    from solmap.config.settings import Settings  # noqa: PLC0415

    try:
        return Settings().debug
    except ConfigError:
        return False


app = typer.Typer(
    cls=Commands,
    help="From a Mars rover's stereo images to maps in the browser.",
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
)

for _panel, _commands in _PANELS.items():
    for _command in _commands:
        if isinstance(_command, typer.Typer):
            app.add_typer(_command, rich_help_panel=_panel)
        else:
            app.command(rich_help_panel=_panel)(_command)
app.command("judge", hidden=True)(simulation.evaluate)  # its name until 0.1


def _print_version(is_requested: bool) -> None:  # noqa: FBT001 - as Typer calls it
    if is_requested:
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
        from solmap.flows.runtime.engine import import_prefect  # noqa: PLC0415 - slow to import

        import_prefect()
