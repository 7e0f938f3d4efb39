"""A network at the state to which it was adjusted, ready to be linearised there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.adjustment.collinearity import Observations, State
from solmap.photogrammetry.adjustment.control_equations import Control, frame_places, known_used
from solmap.photogrammetry.adjustment.elimination import EliminatedTies
from solmap.photogrammetry.adjustment.marginal import Marginal
from solmap.photogrammetry.adjustment.params import AdjustmentParams
from solmap.photogrammetry.adjustment.priors import Telemetry
from solmap.photogrammetry.adjustment.records import USED, AdjustedNetwork, Network
from solmap.photogrammetry.adjustment.result import Outcome
from solmap.photogrammetry.arrays import Bool


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """A network at the state where it is linearised."""

    observations: Observations
    telemetry: Telemetry
    held: Bool[np.ndarray, " stops"]
    state: State
    used: Bool[np.ndarray, " rows"]
    inherited: Marginal | None
    grounded: Bool[np.ndarray, " stops"]
    """Stops that images join to the datum."""
    control: Control | None = None
    ties: tuple[EliminatedTies, ...] = ()
    """The used tie points that several pairs see, as the adjustment linearised them last."""

    @classmethod
    def of(
        cls,
        adjusted: AdjustedNetwork,
        network: Network,
        params: AdjustmentParams,
        rows: np.ndarray | None = None,
    ) -> Linear:
        """A network at the state to which it was adjusted, with what it has inherited.

        `rows` are those of the adjusted ties that the network has, if not all.
        """
        status = adjusted.ties.status if rows is None else adjusted.ties.status[rows]
        stops = {stop.stop: stop for stop in adjusted.stops}
        pairs = {pair.pair_id: pair for pair in adjusted.pairs}
        poses = [stops[stop] for stop in network.stop_ids]
        state = State(
            np.array([stop.lsl_from_rover.rotation for stop in poses]),
            np.array([stop.lsl_from_rover.translation_m for stop in poses]),
            np.array([pairs[pair.pair_id].pointing for pair in network.pairs]).reshape(-1, 3),
            adjusted.ties.points,
            frame_places(adjusted.frames, network),
        )
        return cls(
            Observations.of(network),
            Telemetry.of(network, params),
            np.array([stop.held for stop in poses], dtype=bool),
            state,
            status == USED,
            Marginal.of(adjusted.memory, network) if adjusted.memory else None,
            np.array([stop.is_tied for stop in poses], dtype=bool),
            _control(adjusted, network),
        )

    @classmethod
    def where_solved(cls, outcome: Outcome, grounded: Bool[np.ndarray, " stops"]) -> Linear:
        """The network where an adjustment ended."""
        problem = outcome.problem
        return cls(
            outcome.observations,
            problem.telemetry,
            problem.held,
            outcome.solution.state,
            outcome.used,
            problem.inherited,
            grounded,
            problem.control,
            outcome.ties,
        )

    def without(self, k: int, inherited: Marginal) -> Linear:
        """The network after stop k has left, and every tie point that it saw."""
        seen = np.zeros(self.observations.points, dtype=bool)
        seen[self.observations.point[self.observations.stop == k]] = True
        used = self.used & ~seen[self.observations.point]
        return replace(self, used=used, inherited=inherited)


def _control(adjusted: AdjustedNetwork, network: Network) -> Control | None:
    """The control of a network, used where the adjustment used it."""
    if not network.frames:
        return None
    control = Control.of(network)
    return control.using(known_used(network.control, adjusted.control))
