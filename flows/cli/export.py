"""`solmap export`: products of a store as a folder or ZIP archive for people and other programs."""

from __future__ import annotations

import json
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from solmap.flows.cli.console import (
    JsonOption,
    MissionFilter,
    SolFilter,
    StoreOption,
    print_line,
    workspace_of,
)

if TYPE_CHECKING:
    from solmap.products.export.selection import Selection


def export(  # noqa: PLR0913 - the words of the command
    target: Annotated[Path, typer.Argument(metavar="DIR|ZIP", help="Folder, or file.zip")],
    *,
    store: StoreOption = None,
    mission: MissionFilter = None,
    sol: SolFilter = None,
    stop: Annotated[
        list[str] | None,
        typer.Option(help="SITE/DRIVE, such as 10/100; may be given again"),
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            help="maps, traverse, reports (these three by default); dtm, orthophoto ...; colmap, "
            "asp, isis, pds; may be given again"
        ),
    ] = None,
    since: Annotated[
        datetime | None, typer.Option(help="Only what was made at this time (UTC) or later")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Maps, tables and reports under readable names, with a QGIS project and a STAC catalogue.

    A repeated export into the same folder or archive writes only changes. For other programs:
    `--kind colmap` and `--kind asp` write cameras and tie points, `--kind isis` a control network,
    `--kind pds` rasters of every stereo pair.
    """
    from solmap.products.export.contents import export as write_export  # noqa: PLC0415 - slow

    workspace = workspace_of(store)
    selection = _selection(mission, sol, stop or [], kind or [], since)
    with workspace.run_turn():
        done, names = write_export(target, selection, workspace)
    if as_json:
        document = {"target": str(target), **asdict(done), "files": names}
        typer.echo(json.dumps(document, indent=2))
        return
    changes = f"{done.written} written, {done.unchanged} unchanged, {done.removed} removed"
    print_line(f"{target}: {len(names)} files: {changes}")


def _selection(
    mission: str | None,
    sols: frozenset[int] | None,
    stops: list[str],
    kinds: list[str],
    since: datetime | None,
) -> Selection:
    from solmap.products.export.selection import Selection, stop_named  # noqa: PLC0415 - slow

    named = frozenset(stop_named(text) for text in stops)
    return Selection(mission, sols, named, frozenset(kinds), since)
