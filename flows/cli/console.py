"""What commands share: output, progress bars, tables, errors, and the options of a store.

Everything that reaches the terminal goes through `say`, `note`, `fail`, `show_rows` or a bar. None
of them reads markup in a text, and `printable` shows what would steer a terminal as an escape, so
that file names, labels and messages may be passed as they are.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from solmap.config.settings import Settings
from solmap.flows.runtime.progress import Step, listen
from solmap.products.errors import printable

if TYPE_CHECKING:
    from solmap.products.catalogue.workspace import Workspace

WIDE = 200
"""Columns of a table that goes to a file or a pipe: nothing is cut off."""

_out = Console(soft_wrap=True, width=None if sys.stdout.isatty() else WIDE)
_errors = Console(stderr=True, soft_wrap=True)
_STYLES = {"error": "red", "failed": "red", "warning": "yellow", "note": "yellow"}
StoreOption = Annotated[
    Path | None, typer.Option("--store", help="Folder of products. [env: SOLMAP_STORE]")
]
MissionOption = Annotated[
    str | None,
    typer.Option("--mission", help="MER2 (Spirit), MER1 ...; the store's own if it holds one."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]


def say(text: object) -> None:
    """Print one line."""
    _out.print(Text(printable(text)))


def note(kind: Literal["error", "failed", "warning", "note"], text: object) -> None:
    """Print one line of a kind to the standard error."""
    _errors.print(Text.assemble((kind, _STYLES[kind]), " ", printable(text)))


@contextmanager
def progress_shown() -> Iterator[None]:
    """Show steps as bars on a terminal, as a line a finished stage elsewhere."""
    if sys.stderr.isatty():
        with _bars() as bars, listen(_BarListener(bars)):
            yield
    else:
        with listen(_print_finished):
            yield


def _bars() -> Progress:
    return Progress(
        TextColumn("{task.description:<44}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=_errors,
    )


class _BarListener:
    """One bar a stage."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._tasks: dict[str, int] = {}

    def __call__(self, step: Step) -> None:
        if step.stage not in self._tasks:
            self._tasks[step.stage] = self._bars.add_task(printable(step.stage), total=step.total)
        task = self._tasks[step.stage]
        self._bars.update(task, completed=step.done, total=step.total)  # type: ignore[arg-type]


def _print_finished(step: Step) -> None:
    if step.done == step.total:
        _errors.print(Text(printable(f"{step.stage}: {step.total} done")))


def fail(message: str) -> NoReturn:
    """Say what is wrong, and end the command with 1."""
    note("error", message)
    raise typer.Exit(1)


def workspace_of(given: Path | None) -> Workspace:
    """The store that is named, or else the one of the settings; there has to be one."""
    from solmap.config.workspace import open_workspace  # noqa: PLC0415 - `solmap --help` answers at once

    return open_workspace(existing_store(given))


def existing_store(given: Path | None) -> Path:
    """The folder of a store that is there: what reads makes none."""
    root = store_of(given)
    if not any((root / name).exists() for name in ("drafts", "products", "catalogue.sqlite")):
        fail(f"{root} is no store; name one by --store or SOLMAP_STORE, `solmap run` makes one")
    return root


def input_file(text: str) -> Path:
    """A file that is read, as an argument names it: no folder, FIFO or device is waited for."""
    path = Path(text)
    if not path.is_file():
        fail(f"{text} {'is no file' if path.exists() else 'is not there'}; name a file to read")
    return path


def mission_of(given: str | None, store: Path | None) -> str:
    """The mission of a store that is named, or else the only one that it holds."""
    from solmap.config.workspace import open_catalogue  # noqa: PLC0415 - `solmap --help` answers at once

    root = existing_store(store)
    held = [entry.mission for entry in open_catalogue(root).missions()]
    if given is None and len(held) == 1:
        return held[0]
    if given is None or given.upper() not in held:
        wrong = "name one by --mission" if given is None else f"{given} is not one of them"
        fail(f"{root} holds {', '.join(held) or 'no mission yet'}; {wrong}")
    return given.upper()


def show_rows(rows: list[dict[str, Any]], columns: list[str], as_json: bool) -> None:  # noqa: FBT001
    """Rows as a table of some columns, or whole as JSON."""
    if as_json:
        typer.echo(json.dumps(rows, indent=2))
        return
    if not rows:
        say("nothing yet: `solmap run DOWNLINK_DIR --store STORE` makes it")
        return
    table = Table(*columns)
    for row in rows:
        table.add_row(*(Text(printable(_cell(row.get(column)))) for column in columns))
    _out.print(table)


def _cell(value: Any) -> str:  # noqa: ANN401 - anything JSON holds
    if isinstance(value, float):
        return f"{value:.3f}"
    if isinstance(value, list):
        return ", ".join(_cell(item) for item in value)
    return "" if value is None else str(value)


def store_of(given: Path | None) -> Path:
    """The store that is named, or else the one of the settings."""
    return given or Settings().store
