"""The sequential adjustment: a window along the traverse, earlier stops marginalised exactly.

At every step the stops of the window and the new ones are estimated again, from their own
observations and from the marginal of the observations of earlier stops (`marginal`); then the
oldest stops are marginalised. As long as ties reach back no further than the window, this is the
simultaneous solution of everything so far, and costs the same at every step. It differs from that
solution only in what is fixed when a stop is marginalised: its linearisation point, which of its
observations are blunders, and its pose, which only an overall adjustment changes.

New ties to marginalised stops (loop closures, revisits) re-open the whole traverse: it is adjusted
overall, from its present state, and marginalised again as far as its loops allow.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.assembly import merge_networks
from solmap.photogrammetry.adjustment.model.datum import (
    control_differs,
    held_stops,
    with_remembered_frames,
)
from solmap.photogrammetry.adjustment.model.network import Network, select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_with_outcome, without_past
from solmap.photogrammetry.adjustment.solver.estimate import Outcome
from solmap.photogrammetry.adjustment.solver.marginal import Marginal
from solmap.photogrammetry.adjustment.solver.marginalisation import (
    SolvedNetwork,
    coupling_of,
    marginalise,
)
from solmap.photogrammetry.adjustment.solver.scatter import scatter_of
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId


def adjust_sequential(
    previous: AdjustedNetwork | None,
    network: Network,
    new_stops: Iterable[StopId],
    params: AdjustmentParams,
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Add new stops to an adjusted traverse, equivalent to adjusting all of it together.

    Called like `adjust_stepwise`: `network` holds old and new stops, with the pairs and ties of the
    window, of the stops before it that share ties with it, and of the new stops; with the pairs of
    all stops, loops can be closed. `previous` is the result of earlier steps, or its part at the
    stops whose pairs are given, or None at the start. Marginalised stops keep their poses; stops of
    the window are estimated again.
    """
    new = tuple(stop for stop in network.stop_ids if stop in set(new_stops))
    if previous is None:
        return begin(network.within(set(new)), params)
    if not new:
        raise AdjustmentError("a step along the traverse needs new stops")
    late = late_ties(previous, network, new)
    known, earlier = {stop.stop for stop in previous.stops}, {*network.stop_ids} - {*new}
    complete = earlier <= known and (
        {pair.pair_id for pair in previous.pairs} <= {pair.pair_id for pair in network.pairs}
    )
    gone = (known | earlier) - {*previous.window}
    changed = bool(previous.memory) and control_differs(network, previous, gone)
    if (late or changed) and complete:
        return reopen(previous, network, params)
    adjusted, report = extend(previous, with_remembered_frames(network, previous), new, params)
    notes = [f"{late} ties reach back beyond the window and were left out"] if late else []
    notes += ["control of marginalised stops is new or changed"] if changed else []
    if notes:
        parts = filter(None, (report.message, f"{'; '.join(notes)}: adjust overall"))
        report = replace(report, message="; ".join(parts))
    return merge_networks(previous, adjusted, network), report


def begin(
    network: Network, params: AdjustmentParams, start: AdjustedNetwork | None = None
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Adjust all stops so far together, the first one held; then marginalise the oldest."""
    adjusted, report, outcome = adjust_with_outcome(
        network, held_stops(network), params, without_past(start), "overall adjustment"
    )
    return _marginalise_oldest(adjusted, network, outcome, params), report


def reopen(
    previous: AdjustedNetwork, network: Network, params: AdjustmentParams
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Adjust everything together from its present state."""
    adjusted, report = begin(network, params, previous)
    return adjusted, replace(report, name=f"re-opened by {network.stop_ids[-1]}")


def extend(
    previous: AdjustedNetwork,
    network: Network,
    new_stops: Iterable[StopId],
    params: AdjustmentParams,
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Adjust the window of `previous` and the new stops; the result holds these stops only.

    `network` holds at least the window, its tied predecessors and the new stops.
    """
    new = tuple(new_stops)
    part = _part(network, previous.window, new)
    memory = previous.memory
    inherited = Marginal.of(memory, part) if memory else None
    held = frozenset() if memory else held_stops(part)
    adjusted, report, outcome = adjust_with_outcome(
        part, held, params, previous, f"sequential step to {new[-1]}", inherited
    )
    grown = replace(adjusted, memory=memory)
    return _marginalise_oldest(grown, part, outcome, params), report


def late_ties(previous: AdjustedNetwork, network: Network, new_stops: Iterable[StopId]) -> int:
    """Number of tie points that new stops share with marginalised stops."""
    ties, new = network.ties, set(new_stops)
    if not previous.memory or not len(ties):
        return 0
    of_pair = {pair.pair_id: pair.stop for pair in network.pairs}
    inside = {*previous.window, *new}
    fresh = np.array([of_pair[name] in new for name in ties.pair_ids], dtype=bool)[ties.pair]
    gone = np.array([of_pair[name] not in inside for name in ties.pair_ids], dtype=bool)[ties.pair]
    return len(np.intersect1d(ties.point[gone], ties.point[fresh]))


def _part(network: Network, window: tuple[StopId, ...], new: tuple[StopId, ...]) -> Network:
    """The window and the new stops, without tie points that marginalised stops saw too."""
    stops, ties = {*window, *new}, network.ties
    inside = {pair.pair_id for pair in network.pairs if pair.stop in stops}
    stays = np.array([name in inside for name in ties.pair_ids], dtype=bool)[ties.pair]
    spent = np.zeros(int(ties.point.max(initial=-1)) + 1, dtype=bool)
    spent[ties.point[~stays]] = True
    kept = select(ties, stays & ~spent[ties.point])
    there = np.zeros(len(spent), dtype=bool)
    there[kept.point] = True
    numbers = np.cumsum(there, dtype=np.int32) - 1  # arrays as long as the part, not more
    return network.within(stops, replace(kept, point=numbers[kept.point]))


def _marginalise_oldest(
    adjusted: AdjustedNetwork, network: Network, outcome: Outcome, params: AdjustmentParams
) -> AdjustedNetwork:
    """Marginalise the oldest stops, as many as the window and loops allow; stores the marginal."""
    if not outcome.solution.converged:
        return adjusted  # marginalised observations are not evaluated again
    grounded = np.array([stop.is_tied for stop in adjusted.stops], dtype=bool)
    solved = SolvedNetwork.of_outcome(outcome, grounded)
    marginal = solved.inherited
    number = 0
    while len(network.stops) - number > params.window_stops:
        coupling = coupling_of(solved, number)
        if len(coupling.stops) > params.window_stops:
            # so many stops share ties with this one that marginalising it would save nothing
            break
        marginal = marginalise(solved, coupling)
        solved = solved.without_stop(number, marginal)
        number += 1
    if marginal is None:
        return adjusted
    left, components = np.arange(len(network.stops)) < number, adjusted.components
    past = components.past + scatter_of(outcome, components, left)
    return replace(
        adjusted,
        memory=marginal.memory(network, network.stop_ids[number:]),
        components=replace(components, past=past),
    )
