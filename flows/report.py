"""Where the quality reports lie: one for every adjustment that is published."""

from __future__ import annotations

from typing import Any

from products.model import ProductKind, ProductRef
from products.workspace import Workspace
from tasks.scopes import is_of_mission


def report_rows(workspace: Workspace, mission: str | None = None) -> list[dict[str, Any]]:
    """One row an adjustment, in the order of the sols: its page, its figures, and when."""
    figures = {ref.scope: ref for ref in workspace.catalogue.pointers(ProductKind.QUALITY)}
    return [
        {
            "adjustment": page.scope.name,
            "page": str(workspace.store.path(page)),
            "figures": _path(figures.get(page.scope), workspace),
            "made_at": workspace.store.made_at(page),
        }
        for page in workspace.catalogue.pointers(ProductKind.REPORT)
        if mission is None or is_of_mission(page.scope, mission)
    ]


def _path(ref: ProductRef | None, workspace: Workspace) -> str | None:
    return str(workspace.store.path(ref)) if ref else None
