"""Process one sol: from its stereo pairs to the layers of the stops they were taken at."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from prefect import flow
from prefect.task_runners import ThreadPoolTaskRunner

from config.landing import landing_site
from config.pipeline import PipelineConfig, load_pipeline
from config.settings import Settings
from flows.outcomes import promised, settled
from photogrammetry.imagery import StopId
from photogrammetry.matching.neighbours import link_candidates
from products.arrays import read_right_turn
from products.catalogue import ImageEntry, MissionEntry, Outcome
from products.crs import LandingPoint
from products.model import ProductRef
from products.workspace import Workspace
from tasks.adjust import NetworkParams, NetworkStep, adjust_network, read_network
from tasks.contour import trace_contours
from tasks.dtm import build_dtm
from tasks.ingest import image_records
from tasks.match import MatchParams, match_stereo_pair
from tasks.orthophoto import render_orthophoto
from tasks.pairs import PairProducts, pairs_of
from tasks.publish import publish
from tasks.quicklook import picture_pair, picture_terrain
from tasks.scopes import sol_scope
from tasks.slope import map_aspect, map_slope, shade_relief
from tasks.telemetry import (
    Telemetry,
    TelemetryStop,
    read_telemetry,
    vector_files,
    why_unplaced,
)
from tasks.tie import StopProducts, link_stops, tie_stop
from tasks.views import Orientation, OrientedPair

WINDOW = 3
"""Earlier stops that a sol may change: as far back as `adjust_stepwise` reaches."""
WORKERS = 2
"""Tasks at a time; each works on arrays of some hundred megabytes."""


@dataclass(slots=True)
class SolReport:
    """How a sol went: what was made, and one line for everything that was not."""

    mission: str
    sol: int
    network: ProductRef | None = None
    layers: int = 0
    notes: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    def blame(self, what: str, failed: Mapping[Any, str]) -> None:
        """Take down failures that carry a cause."""
        self.failures += [f"{what} {key}: {cause}" for key, cause in failed.items() if cause]


@dataclass(frozen=True, slots=True, eq=False)
class SolInputs:
    """What is known when a sol is processed."""

    workspace: Workspace
    config: PipelineConfig
    mission: MissionEntry
    telemetry: Telemetry
    new_stops: tuple[StopId, ...]
    """Stops first seen this sol."""
    touched: tuple[StopId, ...]
    """Stops that images of this sol were taken at."""
    unplaced: tuple[StopId, ...]
    """Stops of this sol that no chain of sites joins to the LSL."""
    unpaired: tuple[ImageEntry, ...]
    """Images of this sol that have no stereo partner."""
    window: tuple[TelemetryStop, ...]
    """Stops whose orientation this sol may change, and those linked to them."""

    @property
    def landing(self) -> LandingPoint:
        """Where the map is tied to Mars."""
        return self.mission.landing


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


def gather(mission: str, sol: int, store: Path, pipeline: str) -> SolInputs:
    """Read settings, labels and vector files."""
    workspace = Workspace.open(store)
    config = load_pipeline(pipeline)
    site = landing_site(mission, Settings().landing_sites)
    entries = [e for e in workspace.catalogue.images(mission) if e.sol <= sol]
    telemetry = read_telemetry(image_records(entries, workspace), vector_files(mission, workspace))
    stops = telemetry.stops
    touched = [stop for stop in stops if sol in stop.sols]
    seen = {entry.stop for entry in entries if entry.sol == sol}
    new = [stop for stop in touched if stop.sols[0] == sol]
    first = min((stops.index(stop) for stop in touched), default=len(stops))
    recent = stops[max(0, first - WINDOW) :]
    window = {stop.stop: stop for stop in recent}
    for stop in recent:
        window |= {old.stop: old for old in _candidates(stop, stops, config)}
    return SolInputs(
        workspace,
        config,
        MissionEntry(mission, site.title, site.landing, telemetry.note),
        telemetry,
        tuple(stop.stop for stop in new),
        tuple(stop.stop for stop in touched),
        tuple(stop for stop in telemetry.unplaced if str(stop) in seen),
        tuple(entry for entry in entries if entry.sol == sol and entry.partner is None),
        tuple(stop for stop in stops if stop.stop in window),
    )


def _candidates(
    stop: TelemetryStop, stops: Sequence[TelemetryStop], config: PipelineConfig
) -> list[TelemetryStop]:
    """The earlier stops that one is tried to be linked with."""
    earlier = {old.stop: old for old in stops[: stops.index(stop)]}
    poses = {name: old.lsl_from_rover for name, old in earlier.items()}
    return [earlier[name] for name in link_candidates(stop.lsl_from_rover, poses, config.links)]


def match_pairs(inputs: SolInputs, sol: int, report: SolReport) -> dict[StopId, list[PairProducts]]:
    """Match the pairs of all stops in the window; those of earlier sols are looked up."""
    config, workspace = inputs.config, inputs.workspace
    params = MatchParams(config.sparse, config.dense)
    window = {stop.stop for stop in inputs.window}
    entries = workspace.catalogue.images(inputs.mission.mission)
    pairs = [pair for pair in pairs_of(entries) if pair.stop in window and pair.sol <= sol]
    futures = {pair.id: match_stereo_pair.submit(pair, params, workspace.store) for pair in pairs}
    done, failed = settled(f"sol {sol}: match stereo pairs", futures)
    report.blame("match", failed)
    pictures = {
        pair: picture_pair.submit(matched, workspace.store) for pair, matched in done.items()
    }
    report.blame("picture", settled(f"sol {sol}: picture the matches", pictures)[1])
    matched: dict[StopId, list[PairProducts]] = {stop: [] for stop in sorted(window)}
    for products in done.values():
        matched[products.files.stop].append(products)
        turn = read_right_turn(workspace.store.path(products.matches))
        if turn is not None and products.files.sol == sol:
            report.notes.append(
                f"{products.files.id}: rows did not correspond; the right camera was turned by "
                f"{np.rad2deg(np.linalg.norm(turn)):.3f} degrees from its label's model"
            )
    return matched


def adjust_stops(
    inputs: SolInputs,
    sol: int,
    previous: ProductRef | None,
    matched: dict[StopId, list[PairProducts]],
    report: SolReport,
) -> ProductRef | None:
    """Tie the stops of the window and adjust them; None if that failed."""
    config, store = inputs.config, inputs.workspace.store
    telemetry = {stop.stop: stop for stop in inputs.window}
    stops = {name: StopProducts(name, tuple(pairs)) for name, pairs in matched.items() if pairs}
    ties, failed = settled(
        f"sol {sol}: tie pairs within stops",
        {
            name: tie_stop.submit(stop, telemetry[name], config.inter_stereo, store)
            for name, stop in stops.items()
        },
    )
    report.blame("tie", failed)
    links, links_failed = settled(
        f"sol {sol}: tie stops across sites",
        {
            f"{old} - {new}": link_stops.submit(
                stops[old], stops[new], telemetry[old], telemetry[new], config.cross_site, store
            )
            for old, new in _links(inputs)
            if old in stops and new in stops
        },
    )
    report.blame("link", links_failed)
    step = NetworkStep(
        mission=inputs.mission.mission,
        sol=sol,
        previous=previous,
        stops=inputs.telemetry.stops,
        new_stops=inputs.new_stops,
        pairs=tuple(pair for stop in stops.values() for pair in stop.pairs),
        ties=tuple(ties.values()),
        links=tuple(links.values()),
    )
    params = NetworkParams(config.tracks, config.adjustment)
    done, undone = settled(
        f"sol {sol}: adjust the network", {sol: adjust_network.submit(step, params, store)}
    )
    report.blame("adjust sol", undone)
    return done.get(sol)


def _links(inputs: SolInputs) -> list[tuple[StopId, StopId]]:
    """Pairs of stops of the window that are tried for a link, the earlier one first."""
    stops = inputs.telemetry.stops
    names = {stop.stop for stop in inputs.window}
    return [
        (old.stop, stop.stop)
        for stop in inputs.window
        for old in _candidates(stop, stops, inputs.config)
        if old.stop in names
    ]


def map_stops(
    inputs: SolInputs,
    network: ProductRef,
    matched: dict[StopId, list[PairProducts]],
    report: SolReport,
) -> dict[StopId, list[ProductRef]]:
    """Map every stop of the window from its adjusted pairs; unchanged ones are looked up."""
    config, store, landing = inputs.config, inputs.workspace.store, inputs.landing
    adjusted = {p.pair_id: p for p in read_network(network, store).adjusted.pairs}
    futures = {}
    for stop, pairs in matched.items():
        oriented = tuple(
            OrientedPair(pair, Orientation.of(adjusted[pair.files.id]))
            for pair in pairs
            if pair.files.id in adjusted
        )
        if not oriented:
            continue
        dtm = build_dtm.submit(stop, oriented, config.dtm, landing, store)
        futures[stop, "dtm"] = dtm
        terrain = promised(dtm)
        futures[stop, "orthophoto"] = render_orthophoto.submit(
            terrain, oriented, config.orthophoto, landing, store
        )
        futures[stop, "contours"] = trace_contours.submit(terrain, config.contour, landing, store)
        futures[stop, "slope"] = map_slope.submit(terrain, config.slope, landing, store)
        futures[stop, "aspect"] = map_aspect.submit(terrain, config.slope, landing, store)
        futures[stop, "picture"] = picture_terrain.submit(terrain, store)
        futures[stop, "hillshade"] = shade_relief.submit(terrain, config.hillshade, landing, store)
    done, failed = settled(f"sol {report.sol}: map the stops", futures)
    report.blame("map", {f"{kind} of {stop}": cause for (stop, kind), cause in failed.items()})
    made: dict[StopId, list[ProductRef]] = {}
    for (stop, kind), ref in done.items():
        if kind != "picture":
            made.setdefault(stop, []).append(ref)
    return made


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
