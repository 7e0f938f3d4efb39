"""`solmap prune`: remove what nothing refers to any more."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import timedelta
from typing import Annotated, Any

import typer

from solmap.flows.console import fail, out, show_rows, workspace_of
from solmap.flows.options import JsonOption, StoreOption, store_of
from solmap.products.catalogue.pruning import Prunable, PruningParams, prunable
from solmap.products.catalogue.pruning import prune as remove
from solmap.products.errors import ProductError

_MB = 1e6


def prune(
    store: StoreOption = None,
    older_than: Annotated[
        float, typer.Option(help="Days; what is younger stays", min=0.0)
    ] = PruningParams().youngest / timedelta(days=1),
    versions: Annotated[
        int, typer.Option(help="Kept of each product, the published one counted", min=1)
    ] = PruningParams().versions,
    *,
    yes: Annotated[bool, typer.Option("--yes", help="Remove it; else it is only told.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Say what nothing refers to any more, and with --yes remove it; published maps stay."""
    workspace = workspace_of(store_of(store))
    try:
        params = PruningParams(versions, timedelta(days=older_than))
        found = remove(workspace, params) if yes else prunable(workspace, params)
    except ProductError as error:
        fail(str(error))
    rows = _rows(found)
    if as_json:
        typer.echo(json.dumps({"removed": yes, "products": rows}, indent=2))
        return
    if rows:
        show_rows(rows, ["kind", "products", "megabytes"], False)  # noqa: FBT003
    megabytes = sum(one.size for one in found) / _MB
    verb = "removed" if yes else "would go; --yes removes them"
    out.print(f"{len(found)} products, {megabytes:.1f} MB, {verb}", highlight=False)


def _rows(found: Sequence[Prunable]) -> list[dict[str, Any]]:
    """How many of each kind, and how large."""
    kinds = sorted({one.ref.kind for one in found})
    of = {kind: [one.size for one in found if one.ref.kind is kind] for kind in kinds}
    return [
        {"kind": str(kind), "products": len(sizes), "megabytes": round(sum(sizes) / _MB, 3)}
        for kind, sizes in of.items()
    ]
