"""The adjustment of an image network.

The network is first aligned stop by stop (`initialise`), then adjusted as a whole in the two steps
of `estimate`, each repeated until data snooping finds no further blunder. Telemetry is a weighted
observation (`telemetry`), so only the datum can be undetermined: at least one stop is held.

The datum is the held stops, the marginal inherited by a sequential adjustment, or, with control,
the position of the first stop (`datum`). The overall adjustment estimates all other stops;
`stepwise` and `sequential` follow the rover stop by stop.
"""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.initial.diagnosis import (
    Initial,
    complete,
    diagnose,
    with_findings,
    without_unchecked,
)
from solmap.photogrammetry.adjustment.initial.values import (
    initialise,
    intersect_rays,
    propagate_telemetry,
)
from solmap.photogrammetry.adjustment.model.adjusted_network import (
    BLUNDER,
    AdjustedNetwork,
    AdjustedTies,
    AdjustmentReport,
    Consistency,
)
from solmap.photogrammetry.adjustment.model.collinearity import Observations, State, Views
from solmap.photogrammetry.adjustment.model.control_equations import (
    Control,
    frame_places,
    was_used,
)
from solmap.photogrammetry.adjustment.model.datum import held_stops
from solmap.photogrammetry.adjustment.model.network import Network
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.sightings import (
    Comparisons,
    Overview,
    Sightings,
    consistency,
)
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.adjustment.model.variance_components import (
    Scatter,
    VarianceComponents,
)
from solmap.photogrammetry.adjustment.solver.estimate import Outcome, Start, estimate
from solmap.photogrammetry.adjustment.solver.marginal import Marginal
from solmap.photogrammetry.adjustment.solver.results import adjusted_records
from solmap.photogrammetry.adjustment.solver.scatter import scatter_of, weigh
from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId, TieKind, TiePoints

ROUNDS = 8
"""Most estimates of variance components; three are usual."""


def adjust(
    network: Network,
    held: AbstractSet[StopId],
    params: AdjustmentParams,
    start: AdjustedNetwork | None = None,
    name: str = "adjust",
    inherited: Marginal | None = None,
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Adjust a network with some stops held where `start`, or else telemetry, has them.

    Stops and pairs in `start` begin there; the others are aligned to them first. `inherited` is the
    marginal of observations that are no longer in the network. Variance components begin with those
    of `start`; observations that it counts as past are not counted again. Failure to converge is
    returned and reported: check `AdjustmentReport.is_usable`.

    Raises:
        AdjustmentError: no stop is held and nothing inherited, or a held one is not in the network.
    """
    return adjust_with_outcome(network, held, params, start, name, inherited)[:2]


def adjust_with_outcome(
    network: Network,
    held: AbstractSet[StopId],
    params: AdjustmentParams,
    start: AdjustedNetwork | None = None,
    name: str = "adjust",
    inherited: Marginal | None = None,
) -> tuple[AdjustedNetwork, AdjustmentReport, Outcome]:
    """`adjust`, with all results of the iteration."""
    stated, components = params, start.components if start else VarianceComponents()
    components = components.begin(stated)
    params = components.apply(stated)
    is_held = _held_mask(
        network, held, has_datum=inherited is not None or network.datum_is_observed
    )
    observations = weigh(network, components)
    telemetry = Telemetry.of(network, params)
    known, is_known = _known_state(network, telemetry, observations, start)
    root = is_held if is_held.any() or inherited else np.arange(len(is_held)) == 0
    before = propagate_telemetry(known, telemetry, root, is_known)
    overview = Overview.of(observations, known.pointings, len(root), params)
    state, views, fits = initialise(
        observations, telemetry, root, params, known, is_known, overview
    )
    if start:
        fits &= ~_earlier_blunders(network.ties, start.ties)
    placed = root if inherited is None else is_held | is_known
    names, shown = network.stop_ids, frozenset(one.stop for one in network.control)
    controlled = frozenset(k for k, stop in enumerate(names) if stop in shown)
    initial = Initial(names, observations, telemetry, overview, state, fits, placed, controlled)
    findings, alone = diagnose(initial)
    if len(alone):
        rest = without_unchecked(network, observations, alone)
        adjusted, report, outcome = adjust_with_outcome(rest, held, stated, start, name, inherited)
        return *complete((adjusted, report), network, findings), outcome
    state = intersect_rays(state, observations, fits)
    views = views.at(state.points.T.copy())
    used = fits & views.are_in_front(observations.sights)
    control = _control(network, start)
    if control:
        state = replace(state, frames=_frame_places(control, state, network, start))
    beginning = Start(observations, telemetry, is_held, state, views, used, inherited, control)
    outcome, components = _with_components(beginning, components, network, stated)
    outcome = outcome.with_all_points(overview.seen)
    agreement = _agreement(outcome, before, overview.seen)
    adjusted, report = adjusted_records(network, is_held, outcome, agreement, name)
    result = replace(adjusted, components=components), report
    return *with_findings(result, findings), outcome


def _with_components(
    start: Start, components: VarianceComponents, network: Network, stated: AdjustmentParams
) -> tuple[Outcome, VarianceComponents]:
    """The estimate with the variance components of its own residuals."""
    outcome = estimate(start, components.apply(stated))
    counted = np.logical_not(start.held & components.past.redundancy.any())
    for _ in range(ROUNDS):
        scatter = scatter_of(outcome, components, counted)
        shown = components.update(stated.sigma_freedoms, scatter)
        if not outcome.solution.converged or shown.is_near(components, stated.sigma_freedoms):
            return outcome, replace(components, scatter=shown.scatter)
        components, params = shown, shown.apply(stated)
        observations = weigh(network, components)
        again = outcome.start_with(observations, Telemetry.of(network, params))
        outcome = estimate(again, params)
    return outcome, components


def _earlier_blunders(ties: TiePoints, before: AdjustedTies) -> np.ndarray:
    """Blunders of an earlier adjustment; those that fit now are used again."""
    known, rows = before.observations, np.flatnonzero(before.status == BLUNDER)
    places = known.left[rows].tolist()
    wrong = {
        (known.pair_ids[pair], x, y)
        for pair, (x, y) in zip(known.pair[rows].tolist(), places, strict=True)
    }
    found = np.isin(ties.left[:, 0], known.left[rows, 0])
    for row in np.flatnonzero(found).tolist():
        found[row] = (ties.pair_ids[ties.pair[row]], *ties.left[row].tolist()) in wrong
    return found


def _agreement(
    outcome: Outcome, before: State, seen: Sightings
) -> tuple[dict[TieKind, Consistency], dict[TieKind, Consistency]]:
    """Agreement of sightings before and after the adjustment."""
    observations = outcome.observations
    compared = Comparisons.of(observations, seen, outcome.used)
    return (
        consistency(observations, Views.of(before, observations), seen, compared),
        consistency(observations, outcome.views, seen, compared),
    )


def adjust_overall(
    network: Network, params: AdjustmentParams, start: AdjustedNetwork | None = None
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Adjust all stops; the first is held or, with control, its position observed: `datum`."""
    if not network.stops:
        raise AdjustmentError("there is no stop to adjust: the network is empty")
    return adjust(network, held_stops(network), params, without_past(start), "overall adjustment")


def without_past(start: AdjustedNetwork | None) -> AdjustedNetwork | None:
    """Initial values of an adjustment in which all observations take part again."""
    if start is None:
        return None
    return replace(start, components=replace(start.components, past=Scatter()))


def _control(network: Network, start: AdjustedNetwork | None) -> Control | None:
    """The control of a network; control rejected before is initially set aside."""
    if not network.frames:
        return None
    control = Control.of(network)
    return control.with_used(was_used(network.control, start.control)) if start else control


def _frame_places(
    control: Control, state: State, network: Network, start: AdjustedNetwork | None
) -> Float64[np.ndarray, "frames 5"]:
    """Initial positions of control frames: from the previous adjustment, or fitted to the stops."""
    known = {frame.frame.name for frame in start.frames} if start else set()
    is_known = np.array([frame.name in known for frame in network.frames], dtype=bool)
    before = frame_places(start.frames if start else (), network)
    return np.where(is_known[:, None], before, control.fit_frames(state))


def _held_mask(network: Network, held: AbstractSet[StopId], *, has_datum: bool) -> np.ndarray:
    """Which stops are held; raises an error for a network without datum."""
    missing = sorted(set(held) - set(network.stop_ids))
    if missing:
        raise AdjustmentError(f"{missing[0]} cannot be held: it is not in the network")
    if not (held or has_datum):
        raise AdjustmentError(
            f"the datum of the network of {len(network.stops)} stops is undefined: images and "
            "telemetry increments determine only relative positions; hold one stop fixed, "
            "normally the first of the traverse"
        )
    return np.array([stop in held for stop in network.stop_ids], dtype=bool)


def _known_state(
    network: Network,
    telemetry: Telemetry,
    observations: Observations,
    start: AdjustedNetwork | None,
) -> tuple[State, np.ndarray]:
    """Telemetry as a state, overwritten by the previous adjustment where it has values."""
    rotations, centres = telemetry.rotations.copy(), telemetry.centres.copy()
    pointings = np.zeros((len(network.pairs), 3))
    is_known = np.zeros(len(centres), dtype=bool)
    stops = {s.stop: s for s in start.stops} if start else {}
    pairs = {p.pair_id: p for p in start.pairs} if start else {}
    for k, stop in enumerate(network.stop_ids):
        if stop in stops:
            is_known[k] = True
            rotations[k] = stops[stop].lsl_from_rover.rotation
            centres[k] = stops[stop].lsl_from_rover.translation_m
    for k, pair in enumerate(network.pairs):
        if pair.pair_id in pairs:
            pointings[k] = pairs[pair.pair_id].pointing
    points = np.full((observations.points, 3), np.nan)
    known = State(rotations, centres, pointings, points)
    return (replace(known, mast=start.mast.values) if start else known), is_known
