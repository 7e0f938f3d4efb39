"""`solmap backup`, `restore` and `check`: copies of a store, and whether it is sound."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from solmap.flows.cli.console import (
    JsonOption,
    StoreOption,
    note,
    progress_shown,
    say,
    workspace_of,
)
from solmap.flows.runtime.progress import report

if TYPE_CHECKING:
    from solmap.products.catalogue.maintenance.backups import BackupReport


def backup(
    destination: Annotated[Path, typer.Argument(help="Folder that keeps the backups")],
    store: StoreOption = None,
    keep: Annotated[
        int | None, typer.Option(help="Remove all but so many of the newest backups", min=1)
    ] = None,
) -> None:
    """Back the store up while it is worked on; products that DESTINATION has are not copied."""
    from solmap.products.catalogue.maintenance.backups import back_up  # noqa: PLC0415 - `solmap --help` answers at once

    with progress_shown():
        done = back_up(workspace_of(store), destination, keep, partial(report, "back up"))
    _print_report(
        done, "backed up", "`solmap check --repair` removes it, the next run makes it anew"
    )


def restore(
    source: Annotated[Path, typer.Argument(help="A backup, or the folder that keeps several")],
    store: Annotated[
        Path, typer.Option("--store", help="Empty folder, to hold the store from now on")
    ],
    *,
    replace: Annotated[
        bool, typer.Option("--replace", help="Put it in place of what the store holds.")
    ] = False,
) -> None:
    """Restore a backup, or the newest of several; every file is held against its checksum."""
    from solmap.config.settings import Settings  # noqa: PLC0415 - as above
    from solmap.products.catalogue.maintenance import backups  # noqa: PLC0415

    settings = Settings()
    with progress_shown():
        done = backups.restore(
            source,
            store,
            settings.catalogue_url,
            settings.object_storage,
            replace=replace,
            on_progress=partial(report, "restore"),
        )
    _print_report(done, "restored", f"say `solmap check --repair --store {store}`")


def check(
    store: StoreOption = None,
    *,
    repair: Annotated[
        bool, typer.Option("--repair", help="Remove what is broken, withdraw what is lost.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Look through the store: checksums, catalogue, left-overs, databases; a line a finding."""
    from solmap.products.catalogue.maintenance.checking import check as look_through  # noqa: PLC0415 - as above

    findings = []
    with progress_shown():
        progress = partial(report, "check files")
        for finding in look_through(workspace_of(store), repair=repair, on_progress=progress):
            findings.append(finding)
            if not as_json:
                say(finding)
    left = sum(not finding.is_mended for finding in findings)
    if as_json:
        rows = [{"finding": str(one), "is_mended": one.is_mended} for one in findings]
        typer.echo(json.dumps(rows, indent=2))
    else:
        say(f"{len(findings) - left} mended, {left} left" if findings else "nothing is wrong")
    if left:
        raise typer.Exit(1)


def _print_report(done: BackupReport, verb: str, remedy: str) -> None:
    for name in done.broken:
        note("warning", f"{name} is broken and was left out; {remedy}")
    say(f"{done.folder}: {done.files} files {verb}, {done.copied} of them copied")
    if done.broken:
        raise typer.Exit(1)
