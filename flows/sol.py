"""Process one sol: from its stereo pairs to the layers of the stops they were taken at."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from prefect import flow
from prefect.task_runners import ThreadPoolTaskRunner

from flows.sol_inputs import SolInputs, SolReport, gather
from flows.sol_maps import map_stops
from flows.sol_network import adjust_stops, match_pairs
from photogrammetry.imagery import StopId
from products.catalogue import Outcome
from products.model import ProductRef
from tasks.adjust import read_network
from tasks.pairs import PairProducts
from tasks.publish import publish
from tasks.scopes import sol_scope
from tasks.telemetry import why_unplaced

WORKERS = 2
"""Tasks at a time; each works on arrays of some hundred megabytes."""


@flow(
    name="sol",
    flow_run_name="{mission}-sol{sol}",
    task_runner=ThreadPoolTaskRunner(max_workers=WORKERS),  # type: ignore[arg-type]
)
def process_sol(
    mission: str, sol: int, store: Path, pipeline: str, previous: ProductRef | None = None
) -> SolReport:
    """Take one sol from raw images to published layers."""
    report = SolReport(mission, sol)
    inputs = gather(mission, sol, store, pipeline)
    report.notes += [why_unplaced(stop) for stop in inputs.unplaced]
    report.notes += [f"{e.id} is unpaired: {e.unpaired_because}" for e in inputs.unpaired]
    if not inputs.touched:
        return report  # none of the sol's stops can be placed
    matched = match_pairs(inputs, sol, report)
    network = adjust_stops(inputs, sol, previous, matched, report)
    if network is not None:
        report.network = network
        layers = map_stops(inputs, network, matched, report)
        publish_sol(inputs, sol, network, layers, matched, report)
    return report


def publish_sol(
    inputs: SolInputs,
    sol: int,
    network: ProductRef,
    layers: dict[StopId, list[ProductRef]],
    matched: dict[StopId, list[PairProducts]],
    report: SolReport,
) -> None:
    """Move the catalogue to what this sol made, in one transaction."""
    product = read_network(network, inputs.workspace.store)
    touched = {str(stop) for stop in inputs.touched}
    links = [_said(link) for link in product.links if link["later"] in touched]
    report.notes += [product.reports[-1], *links]
    sols = {stop.stop: stop.sols for stop in inputs.telemetry.stops}
    outcome = Outcome(
        sol_scope(report.mission, sol).name,
        is_failure=bool(report.failures),
        notes=(*report.failures, *report.notes),
        at=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    published = publish.fn(
        inputs.mission,
        [(ref, sols[stop]) for stop, refs in layers.items() for ref in refs],
        (network, *_stages(matched.values())),
        [outcome],
        inputs.workspace,
    )
    report.layers = len(published)


def _said(link: dict[str, object]) -> str:
    verdict = "linked" if link["linked"] else "not linked"
    return f"{link['earlier']} - {link['later']}: {verdict}, {link['reason']}"


def _stages(matched: Iterable[list[PairProducts]]) -> list[ProductRef]:
    return [ref for pairs in matched for pair in pairs for ref in (pair.matches, pair.parallax)]
