"""Publication of a sol in waves, each in one transaction.

Positions come first, then each new stop with its first maps, then layers that depend on these, then
all layers of the sol. Stops that were already on the map and moved are replaced in the last wave,
together and with all of their layers. So no stop shows layers of two solutions.

The last wave contains all layers of a sol, including those of earlier waves. If a run is killed
between two waves, the earlier waves remain published, and the next run continues.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from solmap.flows.mission import draw_network
from solmap.flows.runtime.failures import keep_going, keep_outcome
from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sol_inputs import SolInputs
from solmap.flows.sol_maps import Key
from solmap.photogrammetry.imagery import StopId
from solmap.products.catalogue.catalogue import Outcome, published_networks
from solmap.products.model import Layer, ProductKind, ProductRef
from solmap.tasks.mission.publish import publish
from solmap.tasks.mission.vectors import POSITIONS
from solmap.tasks.network.orientations import Standing
from solmap.tasks.scopes import network_scope

Sols = tuple[int, ...]


@dataclass(slots=True, eq=False)
class Waves:
    """Products of a sol, and the jobs that each wave waits for."""

    inputs: SolInputs
    report: SolReport
    new: frozenset[StopId]
    """Stops without maps so far."""
    pointers: list[ProductRef] = field(default_factory=list)
    """Products that are not layers: networks, reports, matches."""
    layers: dict[StopId, list[ProductRef]] = field(default_factory=dict)
    _waiting: list[tuple[set[Key], list[Key]]] = field(default_factory=list)
    """For each wave, the jobs that have not ended, and all jobs."""
    _failed: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, inputs: SolInputs, report: SolReport) -> Waves:
        """Waves of a sol before anything is made."""
        layers = inputs.workspace.catalogue.layers(inputs.mission.mission, {ProductKind.DTM})
        mapped = {layer.ref.scope.name for layer in layers}
        new = frozenset(one.stop for one in inputs.window if str(one.stop) not in mapped)
        return cls(inputs, report, new)

    def plan(self, *waves: Iterable[Key]) -> None:
        """Publish new stops when these jobs are done; in the first wave each stop separately."""
        of_stop: dict[StopId, list[Key]] = {}
        for key in waves[0]:
            of_stop.setdefault(key[0], []).append(key)
        for keys in (*of_stop.values(), *waves[1:]):
            of_new = [key for key in keys if key[0] in self.new]
            self._waiting.append((set(of_new), of_new))

    def show_positions(self, standing: Standing) -> None:
        """Publish an adjustment, and the traverse where no later one is on the map."""
        mission, workspace = self.inputs.mission.mission, self.inputs.workspace
        drawn: list[tuple[ProductRef, Sols]] = []
        with keep_going(self._failed, "traverse"):
            known = [*published_networks(mission, workspace.catalogue), standing.network]
            if max(known, key=lambda ref: ref.scope.name).scope == standing.network.scope:
                drawn = draw_network(
                    mission, standing.network, workspace, self.inputs.config, POSITIONS
                )
        self._publish(drawn, self.pointers)

    def settled(self, key: Key, made: Mapping[Key, Any]) -> None:
        """Add the products of a job, and publish the waves that are complete."""
        if key in made:
            layers, pointers = _refs(key, made[key])
            self.pointers += pointers
            if layers:
                self.layers.setdefault(key[0], []).extend(layers)
        for waiting, keys in self._waiting:
            if key in waiting:
                waiting.remove(key)
                if not waiting:
                    self._publish_wave([(one, made[one]) for one in keys if one in made])

    def _publish_wave(self, made: Sequence[tuple[Key, Any]]) -> None:
        refs = {key: _refs(key, result) for key, result in made}
        layers = [(ref, self._sols[key[0]]) for key, (of_key, _) in refs.items() for ref in of_key]
        self._publish(layers, [ref for _, pointers in refs.values() for ref in pointers])

    def close(self) -> None:
        """Publish all layers of the sol, and its outcome."""
        report, inputs = self.report, self.inputs
        layers = [(ref, self._sols[stop]) for stop, refs in self.layers.items() for ref in refs]
        pointers = sorted(self.pointers)
        published = self._publish(sorted(layers), pointers, [outcome_of(inputs, report)])
        if published is not None:
            report.pointed = tuple(pointers)
            report.layers = len(published)
            report.published = tuple(layer.ref for layer in published)
        if self._failed:
            report.add_failures("publish", self._failed)
            keep_outcome(outcome_of(inputs, report), inputs.workspace)

    def _publish(
        self,
        layers: Sequence[tuple[ProductRef, Sols]],
        pointers: Sequence[ProductRef],
        outcomes: Sequence[Outcome] = (),
    ) -> tuple[Layer, ...] | None:
        """Publish in one transaction, an outcome with the last; None where that failed."""
        with keep_going(self._failed, "layers"):
            published = publish(
                self.inputs.mission,
                layers,
                tuple(pointers),
                outcomes,
                self.inputs.workspace,
                is_last=bool(outcomes),
            )
            self._failed |= published.failures
            return published.layers
        return None

    @property
    def _sols(self) -> dict[StopId, Sols]:
        return {stop.stop: stop.sols for stop in self.inputs.telemetry.stops}


def outcome_of(inputs: SolInputs, report: SolReport) -> Outcome:
    """Outcome of a sol, for `solmap status`."""
    return Outcome.now(
        network_scope(report.mission, inputs.sol, inputs.mode).name,
        (*report.failures, *report.notes),
        is_failure=bool(report.failures),
    )


def _refs(key: Key, made: Any) -> tuple[Sequence[ProductRef], Sequence[ProductRef]]:  # noqa: ANN401
    """The layers of a job, and its other products."""
    match key[1]:
        case "picture":
            return (), ()
        case "quality":
            return (), made
        case "panorama":
            return made[:1], made[1:]
    return ([made] if isinstance(made, ProductRef) else made), ()
