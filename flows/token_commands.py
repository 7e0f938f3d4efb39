"""`solmap token`: who may write on the map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solmap.flows.console import fail, out, show_rows
from solmap.flows.options import StoreOption, store_of
from solmap.products.catalogue.tokens import Role, TokenBook
from solmap.products.errors import ProductNotFoundError

app = typer.Typer(help="Tokens: who may edit ties, annotate and start runs.", no_args_is_help=True)


def _book(store: Path | None) -> TokenBook:
    root = store_of(store)
    if not root.is_dir():
        fail(f"{root} is no store; `solmap run` makes one")
    return TokenBook.of(root)


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="Whose it is; edits are signed with it")],
    role: Annotated[
        str, typer.Option(help="viewer; analyst: edits and annotations; operator: runs too")
    ] = "analyst",
    days: Annotated[int | None, typer.Option(help="It ends by itself after so many", min=1)] = None,
    store: StoreOption = None,
) -> None:
    """Make a token and print it; it is shown only now."""
    if role.upper() not in Role.__members__:
        fail(f"--role {role} is none of {', '.join(str(one) for one in Role)}")
    if not name.strip():
        fail("a token has a name: edits are signed with it")
    _, text = _book(store).add(name.strip(), Role.named(role), days)
    out.print(text, highlight=False, soft_wrap=True)


@app.command("list")
def list_tokens(
    store: StoreOption = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
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


@app.command()
def revoke(
    number: Annotated[str, typer.Argument(help="The id that `solmap token list` shows")],
    store: StoreOption = None,
) -> None:
    """Have a token open nothing any more."""
    try:
        token = _book(store).revoke(number)
    except ProductNotFoundError as error:
        fail(str(error))
    out.print(f"the token of {token.name} ({token.id}) is revoked", highlight=False)
