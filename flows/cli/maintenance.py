"""`solmap prune`, which removes unreferenced products, and `solmap token`: who may write."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from solmap.flows.cli.console import (
    JsonOption,
    StoreOption,
    existing_store,
    fail,
    say,
    show_rows,
    workspace_of,
)

if TYPE_CHECKING:
    from solmap.products.catalogue.maintenance.pruning import UnreferencedProduct
    from solmap.products.catalogue.tokens import Tokens

_MB = 1e6
tokens = typer.Typer(
    name="token", help="Tokens: who may edit ties, annotate and start runs.", no_args_is_help=True
)


def prune(
    store: StoreOption = None,
    older_than: Annotated[
        float,
        typer.Option(help="Days; what is younger stays", min=0.0, max=36_500),
    ] = 7.0,
    versions: Annotated[
        int, typer.Option(help="Kept of each product, the published one counted", min=1)
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
    say(f"{len(found)} products, {megabytes:.1f} MB, {verb}")


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
    name: Annotated[str, typer.Argument(help="Whose it is; edits are signed with it")],
    role: Annotated[
        str, typer.Option(help="viewer; analyst: edits and annotations; operator: runs too")
    ] = "analyst",
    days: Annotated[
        int | None, typer.Option(help="It ends by itself after so many", min=1, max=36_500)
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
    say(text)


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
    """Revoke a token: it opens nothing any more."""
    token = _book(store).revoke(number)
    say(f"the token of {token.name} ({token.id}) is revoked")
