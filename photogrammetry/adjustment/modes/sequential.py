"""The sequential adjustment: a window along the traverse, and all that came before it exactly.

At every step the stops of the window and the new ones are estimated anew, from their own
observations and from the marginal that the observations of earlier stops have left (`marginal`);
then the oldest stops leave (`retire`). As long as ties reach back no further than the window, this
is the simultaneous solution of everything so far, and costs the same at every step. It differs from
it only by what is frozen when a stop leaves: its linearisation, and which of its observations are
blunders. `smoothing` carries what was learnt since back to the stops that have left.

New ties to stops that have left (loop closures, revisits) re-open the whole traverse: it is
adjusted overall, from where it stands, and leaves again as far as its loops allow.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustedStop,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.assembly import merged_network
from solmap.photogrammetry.adjustment.model.datum import (
    held_stops,
    says_otherwise,
    with_remembered_frames,
)
from solmap.photogrammetry.adjustment.model.network import Network, select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_and_keep
from solmap.photogrammetry.adjustment.solver.estimate import Outcome
from solmap.photogrammetry.adjustment.solver.marginal import Marginal
from solmap.photogrammetry.adjustment.solver.marginalisation import (
    Conditional,
    Linear,
    leaving,
    retire,
)
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId


@dataclass(frozen=True, slots=True, eq=False)
class Departure:
    """A stop that has left, and what it hangs on."""

    adjusted: AdjustedStop
    """As it was when it left."""
    own_pairs: tuple[str, ...]
    stops: tuple[StopId, ...]
    """Of the chart of its conditional."""
    pair_ids: tuple[str, ...]
    conditional: Conditional
    frames: tuple[str, ...] = ()
    """Control frames of its conditional."""


@dataclass(frozen=True, slots=True, eq=False)
class Traverse:
    """A sequential adjustment under way."""

    window: AdjustedNetwork
    """As the last step left it: stops that have not left, and those that left after it."""
    departures: tuple[Departure, ...] = ()
    """In the order in which they left, since the traverse was last re-opened."""

    @property
    def staying(self) -> tuple[StopId, ...]:
        """The stops that have not left."""
        memory = self.window.memory
        return memory.window if memory else tuple(stop.stop for stop in self.window.stops)


def adjust_sequential(
    previous: AdjustedNetwork | None,
    network: Network,
    new_stops: Iterable[StopId],
    params: AdjustmentParams,
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Add new stops to an adjusted traverse, as exactly as all of it together would.

    Called like `adjust_stepwise`: `network` holds old and new stops, with the pairs and ties of the
    window, of the stops before it that share ties with it, and of the new stops; with the pairs of
    all stops, loops can be closed. `previous` is what former steps returned, or the part of it at
    the stops whose pairs are given, or None at the start.
    Stops that have left the window stay as they were when they left; stops of the window move.
    """
    new = tuple(stop for stop in network.stop_ids if stop in set(new_stops))
    if previous is None:
        traverse, report = begin(network.within(set(new)), params)
        return traverse.window, report
    if not new:
        raise AdjustmentError("a step along the traverse needs new stops")
    before = Traverse(previous)
    late = late_ties(before, network, new)
    known, told_of = {stop.stop for stop in previous.stops}, {*network.stop_ids} - {*new}
    complete = told_of <= known and (
        {pair.pair_id for pair in previous.pairs} <= {pair.pair_id for pair in network.pairs}
    )
    gone = (known | told_of) - {*before.staying}
    changed = bool(previous.memory) and says_otherwise(network, previous, gone)
    if (late or changed) and complete:
        traverse, report = reopened(previous, network, params)
        return traverse.window, report
    traverse, report = extend(before, with_remembered_frames(network, previous), new, params)
    told = [f"{late} ties reach back beyond the window and were left out"] if late else []
    told += ["control of stops that have left the window is new or changed"] if changed else []
    if told:
        parts = filter(None, (report.message, f"{'; '.join(told)}: adjust overall"))
        report = replace(report, message="; ".join(parts))
    return merged_network(previous, traverse.window, network), report


def begin(
    network: Network, params: AdjustmentParams, start: AdjustedNetwork | None = None
) -> tuple[Traverse, AdjustmentReport]:
    """All stops so far adjusted together, the very first one held; then the oldest leave."""
    adjusted, report, outcome = adjust_and_keep(
        network, held_stops(network), params, start, "overall adjustment"
    )
    return _shortened(Traverse(adjusted), network, outcome, params), report


def reopened(
    previous: AdjustedNetwork, network: Network, params: AdjustmentParams
) -> tuple[Traverse, AdjustmentReport]:
    """Everything adjusted together from where it stands."""
    traverse, report = begin(network, params, previous)
    return traverse, replace(report, name=f"re-opened by {network.stop_ids[-1]}")


def extend(
    traverse: Traverse, network: Network, new_stops: Iterable[StopId], params: AdjustmentParams
) -> tuple[Traverse, AdjustmentReport]:
    """One step: `network` holds at least the window, its tied predecessors and the new stops."""
    new = tuple(new_stops)
    part = _part(network, traverse.staying, new)
    memory = traverse.window.memory
    inherited = Marginal.of(memory, part) if memory else None
    held = frozenset() if memory else held_stops(part)
    adjusted, report, outcome = adjust_and_keep(
        part, held, params, traverse.window, f"sequential step to {new[-1]}", inherited
    )
    grown = Traverse(replace(adjusted, memory=memory), traverse.departures)
    return _shortened(grown, part, outcome, params), report


def late_ties(traverse: Traverse, network: Network, new_stops: Iterable[StopId]) -> int:
    """How many tie points new stops share with stops that have left."""
    ties, new = network.ties, set(new_stops)
    if not traverse.window.memory or not len(ties):
        return 0
    of_pair = {pair.pair_id: pair.stop for pair in network.pairs}
    inside = {*traverse.staying, *new}
    fresh = np.array([of_pair[name] in new for name in ties.pair_ids], dtype=bool)[ties.pair]
    gone = np.array([of_pair[name] not in inside for name in ties.pair_ids], dtype=bool)[ties.pair]
    return len(np.intersect1d(ties.point[gone], ties.point[fresh]))


def _part(network: Network, staying: tuple[StopId, ...], new: tuple[StopId, ...]) -> Network:
    """The window and the new stops, without tie points that stops which have left saw too."""
    stops, ties = {*staying, *new}, network.ties
    inside = {pair.pair_id for pair in network.pairs if pair.stop in stops}
    stays = np.array([name in inside for name in ties.pair_ids], dtype=bool)[ties.pair]
    spent = np.zeros(int(ties.point.max(initial=-1)) + 1, dtype=bool)
    spent[ties.point[~stays]] = True
    kept = select(ties, stays & ~spent[ties.point])
    there = np.zeros(len(spent), dtype=bool)
    there[kept.point] = True
    numbers = np.cumsum(there, dtype=np.int32) - 1  # arrays as long as the part, not more
    return network.within(stops, replace(kept, point=numbers[kept.point]))


def _shortened(
    traverse: Traverse, network: Network, outcome: Outcome, params: AdjustmentParams
) -> Traverse:
    """The traverse after its oldest stops have left, as many as the window and loops allow."""
    if not outcome.solution.converged:
        return traverse  # what leaves is never looked at again
    adjusted, departures = traverse.window, list(traverse.departures)
    grounded = np.array([stop.is_tied for stop in adjusted.stops], dtype=bool)
    linear = Linear.where_solved(outcome, grounded)
    marginal = linear.inherited
    number = 0
    while len(network.stops) - number > params.window_stops:
        leaves = leaving(linear, number)
        if len(leaves.stops) > params.window_stops:
            break  # so many stops hang on this one that leaving would save nothing
        conditional, marginal = retire(linear, leaves)
        departures.append(_departure(adjusted, network, number, conditional))
        linear = linear.without(number, marginal)
        number += 1
    if marginal is None:
        return traverse
    memory = marginal.memory(network, network.stop_ids[number:])
    return Traverse(replace(adjusted, memory=memory), tuple(departures))


def _departure(
    adjusted: AdjustedNetwork, network: Network, number: int, conditional: Conditional
) -> Departure:
    chart, names = conditional.chart, network.stop_ids
    return Departure(
        adjusted.stop(names[number]),
        tuple(pair.pair_id for pair in network.pairs if pair.stop == names[number]),
        tuple(names[k] for k in chart.stops.tolist()),
        tuple(network.pairs[k].pair_id for k in chart.pairs.tolist()),
        conditional,
        tuple(network.frames[k].name for k in chart.frames.tolist()),
    )
