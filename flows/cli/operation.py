"""Commands that operate a store: backups, checks, unreferenced products, tokens, configuration."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from solmap.flows.cli.console import (
    JsonOption,
    PipelineOption,
    StoreOption,
    existing_store,
    fail,
    note,
    print_line,
    progress_shown,
    show_rows,
    workspace_of,
)
from solmap.flows.runtime.progress import report

if TYPE_CHECKING:
    from solmap.products.catalogue.maintenance.backups import BackupReport
    from solmap.products.catalogue.maintenance.pruning import UnreferencedProduct
    from solmap.products.catalogue.tokens import Tokens


_MB = 1e6
tokens = typer.Typer(
    name="token", help="Tokens: who may edit ties, annotate and start runs.", no_args_is_help=True
)
config = typer.Typer(name="config", help="Parameters of the pipeline.", no_args_is_help=True)
OutOption = Annotated[Path | None, typer.Option("--out", help="File to write; else it is printed")]


def backup(
    destination: Annotated[Path, typer.Argument(help="Folder that keeps the backups")],
    store: StoreOption = None,
    keep: Annotated[
        int | None, typer.Option(help="Remove all but so many of the newest backups", min=1)
    ] = None,
) -> None:
    """Back up the store, also during runs; products already in DESTINATION are not copied."""
    from solmap.products.catalogue.maintenance.backups import back_up  # noqa: PLC0415 - `solmap --help` answers at once

    with progress_shown():
        done = back_up(workspace_of(store), destination, keep, partial(report, "back up"))
    _print_report(
        done, "backed up", "`solmap check --repair` removes it, the next run makes it again"
    )


def restore(
    source: Annotated[Path, typer.Argument(help="A backup, or the folder that keeps several")],
    store: Annotated[
        Path, typer.Option("--store", help="Empty folder, to hold the store from now on")
    ],
    *,
    replace: Annotated[
        bool, typer.Option("--replace", help="Replace the content of the store.")
    ] = False,
) -> None:
    """Restore a backup, or the newest of several; the checksum of every file is checked."""
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
    _print_report(done, "restored", f"run `solmap check --repair --store {store}`")


def check(
    store: StoreOption = None,
    *,
    repair: Annotated[
        bool, typer.Option("--repair", help="Remove what is broken, withdraw what is lost.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Check the store: checksums, catalogue, left-overs, databases; one line per finding."""
    from solmap.products.catalogue.maintenance.checking import check as look_through  # noqa: PLC0415 - as above

    findings = []
    with progress_shown():
        progress = partial(report, "check files")
        for finding in look_through(workspace_of(store), repair=repair, on_progress=progress):
            findings.append(finding)
            if not as_json:
                print_line(finding)
    left = sum(not finding.is_repaired for finding in findings)
    if as_json:
        rows = [{"finding": str(one), "is_mended": one.is_repaired} for one in findings]
        typer.echo(json.dumps(rows, indent=2))
    else:
        print_line(
            f"{len(findings) - left} repaired, {left} left" if findings else "nothing is wrong"
        )
    if left:
        raise typer.Exit(1)


def _print_report(done: BackupReport, verb: str, remedy: str) -> None:
    for name in done.broken:
        note("warning", f"{name} is broken and was left out; {remedy}")
    print_line(f"{done.folder}: {done.files} files {verb}, {done.copied} of them copied")
    if done.broken:
        raise typer.Exit(1)


def prune(
    store: StoreOption = None,
    older_than: Annotated[
        float,
        typer.Option(help="Days; younger products stay", min=0.0, max=36_500),
    ] = 7.0,
    versions: Annotated[
        int, typer.Option(help="Versions kept of each product, including the published one", min=1)
    ] = 2,
    *,
    yes: Annotated[bool, typer.Option("--yes", help="Delete them; else they are listed.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List unreferenced products, and with --yes delete them; published maps stay."""
    from solmap.products.catalogue.maintenance import pruning  # noqa: PLC0415 - `solmap --help` answers at once

    workspace = workspace_of(store)
    params = pruning.PruningParams(versions, timedelta(days=older_than))
    find = pruning.prune if yes else pruning.unreferenced_products
    found = find(workspace, params)
    rows = _rows(found)
    if as_json:
        typer.echo(json.dumps({"removed": yes, "products": rows}, indent=2))
        return
    if rows:
        show_rows(rows, ["kind", "products", "megabytes"], False)  # noqa: FBT003
    megabytes = sum(one.size for one in found) / _MB
    verb = "removed" if yes else "would go; --yes removes them"
    print_line(f"{len(found)} products, {megabytes:.1f} MB, {verb}")


def _rows(found: Sequence[UnreferencedProduct]) -> list[dict[str, Any]]:
    """How many of each kind, and how large."""
    kinds = sorted({one.ref.kind for one in found})
    of = {kind: [one.size for one in found if one.ref.kind is kind] for kind in kinds}
    return [
        {"kind": str(kind), "products": len(sizes), "megabytes": round(sum(sizes) / _MB, 3)}
        for kind, sizes in of.items()
    ]


def _book(store: Path | None) -> Tokens:
    from solmap.products.catalogue.tokens import Tokens  # noqa: PLC0415 - as above

    return Tokens.of(existing_store(store))


@tokens.command()
def add(
    name: Annotated[str, typer.Argument(help="Name of its owner; edits are signed with it")],
    role: Annotated[
        str, typer.Option(help="viewer; analyst: edits and annotations; operator: runs too")
    ] = "analyst",
    days: Annotated[
        int | None, typer.Option(help="Days until it expires", min=1, max=36_500)
    ] = None,
    store: StoreOption = None,
) -> None:
    """Make a token and print it; it is shown only now."""
    from solmap.products.catalogue.tokens import Role  # noqa: PLC0415 - as above

    if role.upper() not in Role.__members__:
        fail(f"--role {role} is none of {', '.join(str(one) for one in Role)}")
    if not name.strip():
        fail("a token has a name: edits are signed with it")
    _, text = _book(store).add(name.strip(), Role.of_name(role), days)
    print_line(text)


@tokens.command("list")
def list_tokens(
    store: StoreOption = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """Every token without its secret, revoked ones too."""
    rows = [
        {
            "id": token.id,
            "name": token.name,
            "role": str(token.role),
            "made_at": token.made_at,
            "ends_at": token.ends_at,
            "state": "valid" if token.is_valid else "revoked" if token.revoked_at else "ended",
        }
        for token in _book(store).tokens()
    ]
    show_rows(rows, ["id", "name", "role", "made_at", "ends_at", "state"], as_json)


@tokens.command()
def revoke(
    number: Annotated[str, typer.Argument(help="The id that `solmap token list` shows")],
    store: StoreOption = None,
) -> None:
    """Revoke a token: it is refused from now on."""
    token = _book(store).revoke(number)
    print_line(f"the token of {token.name} ({token.id}) is revoked")


@config.command()
def show(
    pipeline: PipelineOption = None,
    file: OutOption = None,
) -> None:
    """Print every parameter with its effective value, unit and reason, as a pipeline file."""
    from solmap.config.description import pipeline_toml  # noqa: PLC0415 - slow to import
    from solmap.config.pipeline import load_pipeline  # noqa: PLC0415
    from solmap.config.settings import Settings  # noqa: PLC0415

    _put(pipeline_toml(load_pipeline(pipeline or Settings().pipeline)), file)


@config.command("check")
def check_pipeline(
    file: Annotated[str, typer.Argument(help="TOML file, or the name of a shipped pipeline")],
) -> None:
    """Name every wrong key and value of a pipeline file; exit code 1 if there is any."""
    from solmap.config.pipeline import faults_of_pipeline  # noqa: PLC0415 - slow to import

    faults = faults_of_pipeline(file)
    for fault in faults:
        note("error", fault)
    if faults:
        raise typer.Exit(1)
    print_line(f"{file} is a valid pipeline")


@config.command()
def docs(file: OutOption = None) -> None:
    """Print the documentation's page of all parameters and settings, as Markdown."""
    from solmap.config.description import configuration_page  # noqa: PLC0415 - slow to import

    _put(configuration_page(), file)


def _put(text: str, file: Path | None) -> None:
    if file is None:
        typer.echo(text, nl=False)
        return
    file.write_text(text, encoding="utf-8")
