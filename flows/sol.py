"""Process one sol: from its stereo pairs to the layers of the stops they were taken at."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from prefect import flow
from prefect.futures import PrefectFuture

from solmap.flows.runtime.failures import keep_going, keep_outcome, wait_for
from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol_inputs import SolInputs, gather
from solmap.flows.sol_maps import draw_panoramas, map_far_ground, map_stops, model_stops
from solmap.flows.sol_matching import match_pairs
from solmap.flows.sol_network import adjust_stops
from solmap.photogrammetry.adjustment.quality.movement import ReissueParams
from solmap.photogrammetry.imagery import StopId
from solmap.products.catalogue.catalogue import Outcome
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductRef, Scope
from solmap.tasks.images.pairs import PairProducts
from solmap.tasks.mission.publish import publish
from solmap.tasks.network.orientations import (
    MappedStop,
    Standing,
    choose_orientations,
    read_orientations,
)
from solmap.tasks.network.report import report_quality
from solmap.tasks.scopes import network_scope


@flow(name="sol", flow_run_name="{mission} sol {sol}")
def process_sol(
    mission: str, sol: int, store: Path, pipeline: str, previous: Standing | None = None
) -> SolReport:
    """Take one sol from raw images to published layers."""
    report = SolReport(mission, sol)
    inputs = gather(mission, sol, store, pipeline, previous)
    report.notes += inputs.unplaced
    report.notes += [
        f"{e.id} {'is unpaired' if e.repeats is None else 'is not used'}: {e.unpaired_because}"
        for e in inputs.unpaired
    ]
    of_sol = inputs.workspace.catalogue.images(mission, sol=sol)
    report.notes += [f"{image.id}: {note}" for image in of_sol for note in image.notes]
    if inputs.touched:
        map_what_moved(inputs, previous, report)
    else:  # none of the sol's stops can be placed
        report.add_failures("read", inputs.unread)
        keep_outcome(_outcome(inputs, report), inputs.workspace)
    return report


def map_what_moved(inputs: SolInputs, previous: Standing | None, report: SolReport) -> None:
    """Match, adjust, map what is new or moved, and publish; the report is filled on the way."""
    report.add_failures("read", inputs.unread)
    matched, rig = match_pairs(inputs, previous, report)
    made: list[ProductRef] = [rig] if rig else []
    layers: dict[StopId, list[ProductRef]] = {}
    network = adjust_stops(inputs, previous, matched, report, rig)
    if network is not None:
        made.append(network)
        quality = _submit_quality(network, matched, inputs)
        report.standing = _choose_orientations(network, rig, previous, inputs, report)
        if report.standing is not None:
            made.append(report.standing.orientations)
            made += _map_layers(inputs, report.standing, matched, layers, report)
        stated, failed = wait_for(f"sol {inputs.sol}: report the quality", quality)
        report.add_failures("report", failed)
        made += [ref for refs in stated.values() for ref in refs]
    _publish(inputs, made, layers, matched, report)


def _submit_quality(
    network: ProductRef, matched: dict[StopId, list[PairProducts]], inputs: SolInputs
) -> dict[Scope, PrefectFuture[list[ProductRef]]]:
    pairs = tuple(pair for of_stop in matched.values() for pair in of_stop)
    store = inputs.workspace.store
    return {network.scope: report_quality.submit(network, pairs, inputs.config.quality, store)}


def _choose_orientations(
    network: ProductRef,
    rig: ProductRef | None,
    previous: Standing | None,
    inputs: SolInputs,
    report: SolReport,
) -> Standing | None:
    """What the stops are mapped with; None if that failed."""
    before, store = previous.orientations if previous else None, inputs.workspace.store
    chosen = choose_orientations.submit(network, before, inputs.config.reissue, store, rig)
    stage = f"sol {inputs.sol}: choose the orientations"
    done, failed = wait_for(stage, {network.scope: chosen})
    report.add_failures("choose the orientations of", failed)
    return Standing(network, done[network.scope], rig) if done else None


def _map_layers(
    inputs: SolInputs,
    standing: Standing,
    matched: dict[StopId, list[PairProducts]],
    layers: dict[StopId, list[ProductRef]],
    report: SolReport,
) -> list[ProductRef]:
    """Make the layers of the stops, by stop; what was made besides that is no layer."""
    orientations = standing.orientations
    failed: dict[str, str] = {}
    grounds: list[ProductRef] = []
    with keep_going(failed, "maps"):
        layers |= map_stops(inputs, orientations, matched, report)
    with keep_going(failed, "models"):
        for stop, models in model_stops(inputs, orientations, matched, layers, report).items():
            layers.setdefault(stop, []).extend(models)
    with keep_going(failed, "panoramas"):
        drawn = draw_panoramas(inputs, orientations, matched, layers, report)
        for stop, (panorama, ground) in drawn.items():
            layers.setdefault(stop, []).append(panorama)
            grounds.append(ground)
    with keep_going(failed, "far ground"):
        for stop, far in map_far_ground(inputs, standing, matched, report).items():
            layers.setdefault(stop, []).extend(far)
    report.add_failures("make", failed)
    return grounds


def _publish(
    inputs: SolInputs,
    made: list[ProductRef],
    layers: dict[StopId, list[ProductRef]],
    matched: dict[StopId, list[PairProducts]],
    report: SolReport,
) -> None:
    """Move the catalogue to what was made, in one transaction."""
    failed: dict[str, str] = {}
    if report.standing is not None:
        with keep_going(failed, "its findings"):
            report.notes += _findings(inputs, report.standing)
    report.add_failures("read", failed)
    sols = {stop.stop: stop.sols for stop in inputs.telemetry.stops}
    pointed = (*made, *_match_products(matched.values()))
    unpublished: dict[str, str] = {}
    with keep_going(unpublished, "layers"):
        published = publish(
            inputs.mission,
            [(ref, sols[stop]) for stop, refs in layers.items() for ref in refs],
            pointed,
            [_outcome(inputs, report)],
            inputs.workspace,
        )
        unpublished |= published.failures
        report.pointed = pointed
        report.layers = len(published.layers)
        report.published = tuple(layer.ref for layer in published.layers)
    if unpublished:
        report.add_failures("publish", unpublished)
        keep_outcome(_outcome(inputs, report), inputs.workspace)


def _outcome(inputs: SolInputs, report: SolReport) -> Outcome:
    """How the sol ended, for `solmap status`."""
    return Outcome.now(
        network_scope(report.mission, inputs.sol, inputs.mode).name,
        (*report.failures, *report.notes),
        is_failure=bool(report.failures),
    )


def _findings(inputs: SolInputs, standing: Standing) -> list[str]:
    """How the adjustment went, what was linked, and which stops are mapped again."""
    store = inputs.workspace.store
    product, touched = read_network(standing.network, store), {str(s) for s in inputs.touched}
    links = [_link_line(link) for link in product.links if link["later"] in touched]
    mapped = read_orientations(standing.orientations, store, ()).values()
    again = [stop for stop in mapped if stop.is_new and stop.moved_m is not None]
    return [
        product.report["summary"],
        *product.manual_tie_notes,
        *links,
        *(_remapped_line(stop, inputs.config.reissue) for stop in again),
    ]


def _remapped_line(stop: MappedStop, params: ReissueParams) -> str:
    return (
        f"{stop.stop} is mapped again: ground within {params.range_m:g} m of it moved by up to "
        f"{stop.moved_m:.3f} m"
    )


def _link_line(link: dict[str, object]) -> str:
    verdict = "linked" if link["linked"] else "not linked"
    return f"{link['earlier']} - {link['later']}: {verdict}, {link['reason']}"


def _match_products(matched: Iterable[list[PairProducts]]) -> list[ProductRef]:
    return [ref for pairs in matched for pair in pairs for ref in pair.made]
