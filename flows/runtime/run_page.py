"""A run's page in Prefect: its name, tables of sols and adjustments, figures and links."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import UUID

from httpx import HTTPError
from prefect import runtime
from prefect.artifacts import (
    create_image_artifact,
    create_link_artifact,
    create_markdown_artifact,
    create_table_artifact,
)
from prefect.client.orchestration import get_client
from prefect.context import FlowRunContext

from solmap.config.settings import Settings
from solmap.photogrammetry.imagery import RoverImage
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef, Scope
from solmap.tasks.scopes import region_scope

if TYPE_CHECKING:
    from solmap.flows.runtime.sol_report import DownlinkReport, SolReport

_LAST = 60
"""Sols in a table: a mission of years has more than a page can hold."""
log = logging.getLogger(__name__)
_SPANS = 3
"""Most spans of sols that are listed."""


def write_report(report: DownlinkReport, workspace: Workspace) -> None:
    """Leave the outcome of a downlink on the page of the run."""
    if report.sols:
        rows = [_row(sol) for sol in report.sols[-_LAST:]]
        create_table_artifact(rows, key="sols", description="Every sol that was processed")
    write_adjustments(report.sols, workspace)
    create_markdown_artifact(_text(report), key="downlink", description="Outcome of the downlink")


def write_adjustments(sols: Sequence[SolReport], workspace: Workspace) -> None:
    """Write the quality of the adjustments, the figure of each traverse, and links to the pages."""
    rows = [row for sol in sols[-_LAST:] if (row := _adjustment(sol, workspace))]
    if rows:
        create_table_artifact(rows, key="adjustments", description="Quality of the adjustments")
    address = Settings().map_url
    for mission in dict.fromkeys(sol.mission for sol in sols):
        name = mission.lower()
        _write_traverse_figure(mission, workspace)
        latest = max(sol.sol for sol in sols if sol.mission == mission)
        page = f"{address}/api/missions/{mission}/sols/{latest}/report"
        create_link_artifact(page, f"All of sol {latest}", key=f"sol-{name}")
        last = [row["report"] for row in rows if row["mission"] == mission][-1:]
        for page in last:
            create_link_artifact(page, "Quality of the last adjustment", key=f"report-{name}")
    create_link_artifact(f"{address}/", "The map", key="map", description="All layers")


def _write_traverse_figure(mission: str, workspace: Workspace) -> None:
    """The traverse as telemetry and as the adjustment have it."""
    scope, kind = region_scope(mission), ProductKind.TRAVERSE_FIGURE_PNG
    digest = workspace.catalogue.latest(scope.name, kind)
    if digest is not None:
        text = "The traverse: telemetry and adjusted"
        address = _address(ProductRef(kind, scope, digest))
        create_image_artifact(address, key=f"traverse-{mission.lower()}", description=text)


def _adjustment(sol: SolReport, workspace: Workspace) -> dict[str, Any] | None:
    """The figures of the adjustment that a sol ended with, and the address of its report."""
    if sol.standing is None:
        return None
    scope = sol.standing.network.scope
    quality = _latest(scope, ProductKind.QUALITY, workspace)
    page = _latest(scope, ProductKind.REPORT, workspace)
    if quality is None or page is None:
        return None
    adjustment = json.loads(workspace.store.path(quality).read_text())["adjustment"]
    figures = ("name", "converged", "sigma0", "redundancy", "stops", "pairs", "blunders")
    ties = ", ".join(f"{count} {kind}" for kind, count in adjustment["ties"].items())
    return {
        "mission": sol.mission,
        "sol": sol.sol,
        **{name: adjustment[name] for name in figures},
        "ties": ties,
        "report": f"{Settings().map_url}/reports/{page.scope.name}/{page.digest}.html",
    }


def _latest(scope: Scope, kind: ProductKind, workspace: Workspace) -> ProductRef | None:
    digest = workspace.catalogue.latest(scope.name, kind)
    return ProductRef(kind, scope, digest) if digest else None


def _address(ref: ProductRef) -> str:
    file = f"{ref.kind}/{ref.scope.name}/{ref.digest}{ref.kind.suffix}"
    return f"{Settings().map_url}/products/{file}"


def _row(sol: SolReport) -> dict[str, Any]:
    return {
        "mission": sol.mission,
        "sol": sol.sol,
        "layers": sol.layers,
        "failures": "; ".join(sol.failures),
        "notes": "; ".join(sol.notes),
    }


def _text(report: DownlinkReport) -> str:
    parts = [f"{report.images} images, {len(report.sols)} sols"]
    for title, lines in (
        ("Failures", report.failures),
        ("Warnings", report.warnings),
        ("Poses by other sources", report.poses),
        ("Seams of regions", report.seams),
    ):
        if lines:
            parts.append(f"## {title}\n" + "\n".join(f"- {line}" for line in lines))
    return "\n\n".join(parts)


def folder_name() -> str:
    """Name of the run of a downlink before its images are read."""
    given = runtime.flow_run.parameters
    return f"downlink {Path(str(given['downlink'] or given['places'][0])).name}"


def mission_name() -> str:
    """Name of the run of a flow for one mission or all."""
    return f"{runtime.flow_run.flow_name} {runtime.flow_run.parameters['mission'] or 'of all'}"


def downlink_name(images: Iterable[RoverImage]) -> str:
    """Such as `downlink MER2 sol 156-160`, by its images."""
    sols: dict[str, set[int]] = {}
    for image in images:
        sols.setdefault(image.stop.mission, set()).add(image.sol)
    return "downlink " + ", ".join(f"{name} sol {format_sols(of)}" for name, of in sols.items())


def format_sols(sols: Iterable[int]) -> str:
    """Sols as spans: `156-160,163`; many spans as one, with their number."""
    known = sorted(set(sols))
    starts = [known[0], *(b for a, b in pairwise(known) if b != a + 1)]
    ends = [*(a for a, b in pairwise(known) if b != a + 1), known[-1]]
    if len(starts) > _SPANS:
        return f"{known[0]}-{known[-1]} ({len(known)} sols)"
    return ",".join(_span(a, b) for a, b in zip(starts, ends, strict=True))


def deployed_run() -> tuple[str | None, dict[str, Any]]:
    """The run of a deployment that contains this one, with its parameters; None outside one."""
    if FlowRunContext.get() is None:
        return None, {}
    try:
        with get_client(sync_client=True) as client:
            run = client.read_flow_run(UUID(runtime.flow_run.root_flow_run_id))
    except HTTPError as error:
        log.warning("the engine's name for this run could not be read: %s", error)
        return None, {}
    return (str(run.id), run.parameters) if run.deployment_id else (None, {})


def rename_run(name: str) -> None:
    """Rename the current run; nothing depends on it."""
    context = FlowRunContext.get()
    if context is None or context.flow_run is None:
        return
    try:
        with get_client(sync_client=True) as client:
            client.update_flow_run(context.flow_run.id, name=name)
    except HTTPError as error:
        log.warning("the run could not be renamed to %r: %s", name, error)


def _span(first: int, last: int) -> str:
    return str(first) if first == last else f"{first}-{last}"
