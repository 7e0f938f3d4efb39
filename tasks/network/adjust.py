"""Adjust: one step of the network along the traverse, sol by sol.

Each sol's network starts from the one before and adds the new stops, in the mode of the pipeline
(`adjustment.modes`). It contains the stops that the step may change; those it leaves behind are
separate products, to which it refers (`products.formats.documents.network`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.datum import with_control
from solmap.photogrammetry.adjustment.model.network import Network, PairGeometry, StopPrior
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode, AdjustmentParams
from solmap.photogrammetry.adjustment.modes.mission import advance
from solmap.photogrammetry.imagery import StereoMatches, StopId
from solmap.photogrammetry.matching.manual.editing import EditRequest
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.matching.tracks import TrackParams, build_tie_points
from solmap.products.formats.documents.adjusted_network import report_document
from solmap.products.formats.documents.archives import read_matches, read_ties
from solmap.products.formats.documents.control import control_product, read_control
from solmap.products.formats.documents.network import (
    NetworkPart,
    NetworkProduct,
    References,
    part_document,
    product_document,
    read_network,
)
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.manual_ties import edit_ties, named_in, without_rows
from solmap.tasks.images.pairs import PairProducts
from solmap.tasks.images.telemetry import StatedPoses
from solmap.tasks.network.singles import read_singles
from solmap.tasks.network.tie import PlainPose
from solmap.tasks.scopes import is_overall, network_scope, stop_scope
from solmap.tasks.stage import stage

VETOED = {"linked": False, "reason": "all its ties are vetoed manually"}
"""Status of a link that a person rejects."""


@dataclass(frozen=True, slots=True)
class NetworkParams:
    """Parameters of tie points and their adjustment."""

    tracks: TrackParams = field(default_factory=TrackParams)
    adjustment: AdjustmentParams = field(default_factory=AdjustmentParams)


@dataclass(frozen=True, slots=True, eq=False)
class NetworkStep:
    """Input of one step of the adjustment."""

    mission: str
    sol: int
    mode: AdjustmentMode
    previous: ProductRef | None
    """The previous network: that of an earlier sol, or the sol's own for an overall adjustment."""
    stops: tuple[StopPrior, ...]
    """All stops up to this sol, in the order of the traverse."""
    new_stops: tuple[StopId, ...]
    window: tuple[StopId, ...]
    """The stops that the step may change, and those linked to them; including the new ones."""
    pairs: tuple[PairProducts, ...]
    """Pairs of the window."""
    ties: tuple[ProductRef, ...]
    links: tuple[ProductRef, ...]
    singles: tuple[ProductRef, ...] = ()
    """Ties of images without a stereo partner, by stop."""
    edit_requests: tuple[EditRequest, ...] = ()
    """Edit requests for these pairs."""
    control: tuple[ProductRef, ...] = ()
    """Positions of stops in orbital images, or measured by people."""
    stated: tuple[StatedPoses, ...] = ()
    """Poses of stops from other sources than their labels."""

    @property
    def names(self) -> frozenset[str]:
        """The names of the window's stops."""
        return frozenset(map(str, self.window))

    @property
    def touched(self) -> tuple[StopPrior, ...]:
        """The telemetry of the window's stops."""
        window = set(self.window)
        return tuple(stop for stop in self.stops if stop.stop in window)

    @property
    def inputs(self) -> tuple[ProductRef, ...]:
        """The input products of the step."""
        named = named_in(self.edit_requests)
        return (
            *((self.previous,) if self.previous else ()),
            *(pair.matches for pair in self.pairs),
            *self.ties,
            *self.links,
            *self.singles,
            *(pair.parallax for pair in self.pairs if pair.files.id in named),
            *self.control,
        )


@stage(task_run_name="adjust-sol{step.sol}")
def adjust_network(step: NetworkStep, params: NetworkParams, store: ProductStore) -> ProductRef:
    """Adjust the network of a mission up to a sol, at the stops that the step changes."""
    before = read_network(step.previous, store) if step.previous else None
    settled = _keep_left_stops(step, before, store) if before else {}

    def write(path: Path) -> None:
        joining = _edited_ties(step, store)
        network = _network(step, joining, params, store)
        start = before.with_stops(step.names, store).part.at(step.window) if before else None
        adjusted, report = advance(
            step.mode, start.adjusted if start else None, network, step.new_stops, params.adjustment
        )
        held = {**before.references, **settled} if before else {}
        holders = {name: ref for name, ref in held.items() if name not in step.names}
        path.write_text(json.dumps(_document(step, adjusted, report, joining, holders)))

    telemetry = tuple(
        (str(stop.stop), stop.sols, PlainPose.of(stop.lsl_from_rover)) for stop in step.touched
    )
    scope = network_scope(step.mission, step.sol, step.mode)
    stated = [control_product(frame, control, {}) for frame, control in step.stated]
    settings = (params, telemetry, step.mode, *without_rows(step.edit_requests), *stated)
    inputs = (*step.inputs, *(ref for ref in settled.values() if ref != step.previous))
    return store.make(Recipe(ProductKind.NETWORK, scope, inputs, settings), write)


def _keep_left_stops(
    step: NetworkStep, before: NetworkProduct, store: ProductStore
) -> dict[str, ProductRef]:
    """Products of the stops that the step leaves behind, in their last state.

    An overall adjustment contains all stops, including those left behind.
    """
    left = [stop for stop in before.telemetry if stop not in set(step.window)]
    if step.previous is None or is_overall(step.previous.scope):
        return {str(stop): step.previous for stop in left if step.previous}
    inputs = (step.previous,)

    def write(path: Path, stop: StopId) -> None:
        path.write_text(json.dumps(part_document(before.part.at([stop]).settled)))

    return {
        str(stop): store.make(
            Recipe(ProductKind.MARGINALISED_STOP, stop_scope(stop), inputs),
            partial(write, stop=stop),
        )
        for stop in left
    }


@dataclass(frozen=True, slots=True, eq=False)
class _EditedTies:
    """Ties between pairs after edit requests."""

    ties: tuple[Ties, ...]
    links: tuple[dict[str, Any], ...]
    manual_tie_notes: tuple[str, ...] = ()


def _edited_ties(step: NetworkStep, store: ProductStore) -> _EditedTies:
    read = [read_ties(store.path(ref)) for ref in (*step.ties, *step.links)]
    links = tuple(header for _, header in read[len(step.ties) :])
    ties = tuple(some for some, _ in read)
    if not step.edit_requests:
        return _EditedTies(ties, links)
    changed = edit_ties(step.edit_requests, ties, step.pairs, store)
    left = changed.ties[len(step.ties) : len(ties)]
    links = tuple(
        link if len(some) or not link["linked"] else link | VETOED
        for link, some in zip(links, left, strict=True)
    )
    return _EditedTies(changed.ties, links, (str(changed), *changed.notes))


def _network(
    step: NetworkStep, joining: _EditedTies, params: NetworkParams, store: ProductStore
) -> Network:
    read = [(pair, *read_matches(store.path(pair.matches))) for pair in step.pairs]
    singles = [read_singles(ref, store) for ref in step.singles]
    alone = [body for some in singles for body in some.bodies]
    matches = [matches for _, _, matches in read]
    matches += [StereoMatches.none(body.pair_id) for body in alone]
    ties = [*joining.ties, *(some.ties for some in singles)]
    network = Network(
        stops=step.stops,
        pairs=tuple(
            PairGeometry(pair.files.id, pair.files.stop, geometry) for pair, geometry, _ in read
        )
        + tuple(alone),
        ties=build_tie_points(matches, ties, params.tracks),
    )
    places = [*(read_control(ref, store) for ref in step.control), *step.stated]
    for frame, control in places:
        if control:
            network = with_control(network, [frame], control, params.adjustment)
    return network


def _document(
    step: NetworkStep,
    adjusted: AdjustedNetwork,
    report: AdjustmentReport,
    joining: _EditedTies,
    holders: References,
) -> dict[str, Any]:
    part = NetworkPart(
        {stop.stop: stop.lsl_from_rover for stop in step.stops},
        {stop.stop: stop.sols for stop in step.stops},
        adjusted,
    ).at(step.window)
    product = NetworkProduct(
        mission=step.mission,
        sol=step.sol,
        telemetry=part.telemetry,
        sols=part.sols,
        adjusted=part.adjusted,
        links=joining.links,
        report=report_document(report),
        manual_tie_notes=joining.manual_tie_notes,
        references=holders,
    )
    return product_document(product)
