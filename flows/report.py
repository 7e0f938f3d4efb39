"""Where the quality reports lie: one for every adjustment that is published."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from solmap.config.settings import Settings
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef
from solmap.products.reports.sol_report import timings
from solmap.products.sol_report_page import sol_report
from solmap.tasks.scopes import is_of_mission


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


def write_sol_report(mission: str, sol: int, workspace: Workspace, path: Path) -> None:
    """Write all that is known of a sol as one page; links lead to the map's server.

    Raises:
        ProductNotFoundError: the store has no image of that sol.
    """
    path.write_text(sol_report(mission, sol, workspace, Settings().map_url), encoding="utf-8")


def timing_rows(workspace: Workspace) -> list[dict[str, Any]]:
    """What all products of the store took, one row a kind, the longest first."""
    return [asdict(row) for row in timings(list(workspace.store.refs()), workspace)]


def _path(ref: ProductRef | None, workspace: Workspace) -> str | None:
    return str(workspace.store.path(ref)) if ref else None
