"""What commands share: output, progress bars, tables, errors, and the options of a store.

Everything for the terminal goes through `print_line`, `note`, `fail`, `show_rows` or a bar. None of
them interprets markup, and `printable` escapes control characters, so file names, labels and
messages may be passed unchanged. A table fits the terminal; to a pipe or file it is written as
tab-separated lines with a header.

Options of several commands are defined here, so that they have one meaning.
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
from rich.table import Column, Table
from rich.text import Text

from solmap.flows.runtime.progress import Step, listen
from solmap.products.errors import printable

if TYPE_CHECKING:
    from rich.progress import Progress

    from solmap.products.catalogue.workspace import Workspace

_out = Console(soft_wrap=True)
_errors = Console(stderr=True, soft_wrap=True)
_STYLES = {"error": "red", "failed": "red", "warning": "yellow", "note": "yellow"}


def mission_name(text: str) -> str:
    """The identifier of a mission that an argument names: MER2 of `Spirit`, `MER-A` or `mer2`."""
    from solmap.photogrammetry.archive.missions import mission_id  # noqa: PLC0415 - slow to import

    return mission_id(text)


def sols_named(text: str) -> frozenset[int]:
    """The sols that an option names: `156`, `155-157`, or several with commas between."""
    from solmap.config.archive import sols_of  # noqa: PLC0415 - `solmap --help` answers at once
    from solmap.config.records import ConfigError  # noqa: PLC0415

    try:
        return sols_of(text)
    except ConfigError as error:
        raise typer.BadParameter(str(error)) from None


StoreOption = Annotated[
    Path | None,
    typer.Option(
        "--store", help="Folder of products", envvar="SOLMAP_STORE", show_default="solmap-store"
    ),
]
PipelineOption = Annotated[
    str | None,
    typer.Option(
        "--pipeline",
        help="Shipped pipeline or a TOML file",
        envvar="SOLMAP_PIPELINE",
        show_default="default",
    ),
]
POSE_FILES = "Poses: PLACES table, locations.xml of MSL, .svf, .rvf, poses CSV, SPICE kernels"
MISSION_HELP = "MER2, Spirit or MER-A; MER1; MSL; M20 ..."
MissionOption = Annotated[
    str | None,
    typer.Option(
        "--mission",
        help=MISSION_HELP,
        parser=mission_name,
        metavar="MISSION",
        show_default="the only one in the store",
    ),
]
MissionFilter = Annotated[
    str | None,
    typer.Option("--mission", help=MISSION_HELP, parser=mission_name, metavar="MISSION"),
]
SolFilter = Annotated[
    frozenset[int] | None,
    typer.Option("--sol", help="156, 155-157 or 150,155-157", parser=sols_named, metavar="SOLS"),
]
KindFilter = Annotated[
    list[str] | None,
    typer.Option("--kind", help="dtm, orthophoto, slope ...; may be given again"),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]


def print_line(text: object) -> None:
    """Print one line."""
    _out.print(Text(printable(text)))


def note(kind: Literal["error", "failed", "warning", "note"], text: object) -> None:
    """Print one line of a kind to the standard error."""
    _errors.print(Text.assemble((kind, _STYLES[kind]), " ", printable(text)))


@contextmanager
def progress_shown() -> Iterator[None]:
    """Show steps as bars on a terminal, elsewhere as one line per finished stage."""
    if sys.stderr.isatty():
        with _bars() as bars, listen(_BarListener(bars)):
            yield
    else:
        with listen(_print_finished):
            yield


def _bars() -> Progress:
    from rich.progress import (  # noqa: PLC0415 - `solmap --help` answers at once
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
    )

    return Progress(
        TextColumn("{task.description:<44}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=_errors,
    )


class _BarListener:
    """One bar per stage."""

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
    """Print an error, and end the command with exit code 1."""
    note("error", message)
    raise typer.Exit(1)


def workspace_of(given: Path | None) -> Workspace:
    """The named store, or that of the settings; it must exist."""
    from solmap.config.workspace import open_workspace  # noqa: PLC0415 - `solmap --help` answers at once

    return open_workspace(existing_store(given))


def existing_store(given: Path | None) -> Path:
    """The folder of an existing store: commands that read create none."""
    root = store_of(given)
    if not any((root / name).exists() for name in ("drafts", "products", "catalogue.sqlite")):
        fail(f"{root} is not a store; name one by --store or SOLMAP_STORE, `solmap run` makes one")
    return root


def input_file(text: str) -> Path:
    """An argument that names a file to read; folders, FIFOs and devices are refused."""
    path = Path(text)
    if not path.is_file():
        fail(
            f"{text} {'is not a file' if path.exists() else 'does not exist'}; name a file to read"
        )
    return path


def mission_of(given: str | None, store: Path | None) -> str:
    """The named map of a store (by its mission if that has one map), or the only one."""
    from solmap.config.workspace import open_catalogue  # noqa: PLC0415 - `solmap --help` answers at once
    from solmap.products.model import mission_of as mission_of_map  # noqa: PLC0415 - slow to import

    root = existing_store(store)
    held = [entry.mission for entry in open_catalogue(root).missions()]
    if given is None and len(held) == 1:
        return held[0]
    selected = mission_name(given) if given is not None else None
    of_mission = [name for name in held if mission_of_map(name) == selected]
    for name in (name for name in held if name == selected or [name] == of_mission):
        return name
    wrong = "name one by --mission" if given is None else f"{given} is not one of them"
    fail(f"{root} holds {', '.join(held) or 'no mission yet'}; {wrong}")


def select_rows(
    rows: list[dict[str, Any]],
    mission: str | None = None,
    sols: frozenset[int] | None = None,
    kinds: list[str] | None = None,
) -> list[dict[str, Any]]:
    """The rows of a mission or one of its maps, of some sols and kinds; None selects all.

    Rows have `mission`, `sols` and, to be selected by it, `kind`.
    """
    from solmap.products.model import mission_of as mission_of_map  # noqa: PLC0415 - slow to import

    maps = {row["mission"] for row in rows} - {None}
    if mission is not None:
        selected = {name for name in maps if mission in {name, mission_name(mission_of_map(name))}}
        if maps and not selected:
            fail(f"nothing is of {mission}; there are {', '.join(sorted(maps))}")
        rows = [row for row in rows if row["mission"] in selected]
    known = {row["kind"] for row in rows} if kinds else set()
    for kind in kinds or []:
        if known and kind not in known:
            fail(f"nothing is of kind {kind}; there are {', '.join(sorted(known))}")
    return [
        row
        for row in rows
        if (sols is None or not sols.isdisjoint(row["sols"]))
        and (not kinds or row["kind"] in kinds)
    ]


def show_rows(rows: list[dict[str, Any]], columns: list[str], as_json: bool) -> None:  # noqa: FBT001
    """Rows as a table of some columns, or whole as JSON."""
    if as_json:
        typer.echo(json.dumps(rows, indent=2))
        return
    if not rows:
        note("note", "nothing to show: `solmap run DOWNLINK_DIR --store STORE` makes products")
        return
    cells = [[printable(_cell(row.get(column))) for column in columns] for row in rows]
    if not _out.is_terminal:
        for line in (columns, *cells):
            typer.echo("\t".join(line))
        return
    table = Table(*(Column(name, overflow="fold") for name in columns))
    for line in cells:
        table.add_row(*map(Text, line))
    _out.print(table, soft_wrap=False)


def _cell(value: Any) -> str:  # noqa: ANN401 - anything JSON holds
    if isinstance(value, float):
        return f"{value:.3f}"
    if isinstance(value, list):
        return ", ".join(_cell(item) for item in value)
    return "" if value is None else str(value)


def store_of(given: Path | None) -> Path:
    """The named store, or that of the settings."""
    from solmap.config.settings import Settings  # noqa: PLC0415 - `solmap --help` answers at once

    return given or Settings().store
