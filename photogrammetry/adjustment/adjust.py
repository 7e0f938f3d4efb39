"""The adjustment of an image network.

Stop by stop the network is first brought together (`initialise`), then adjusted as a whole in the
two steps of `STEPS`, each repeated until data snooping finds no further blunder. What telemetry
knows is weighted in (`priors`), so nothing is ever undetermined but the datum: at least one stop
is held.

The datum are the stops that are held, or what a sequential adjustment has inherited. The overall
adjustment holds the first stop and estimates all others; the modes that follow the rover stop by
stop are in `stepwise` and `sequential`.
"""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import numpy as np

from photogrammetry.adjustment.collinearity import Observations, State, misclosures
from photogrammetry.adjustment.consistency import consistency
from photogrammetry.adjustment.diagnosis import Initial, diagnose
from photogrammetry.adjustment.findings import completed, with_findings, without_unchecked
from photogrammetry.adjustment.initialise import carried, initialise
from photogrammetry.adjustment.intersection import with_rays_intersected
from photogrammetry.adjustment.marginal import Marginal
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.priors import Telemetry
from photogrammetry.adjustment.records import (
    AdjustedNetwork,
    AdjustmentReport,
    Network,
    select,
)
from photogrammetry.adjustment.result import Outcome, assembled
from photogrammetry.adjustment.sightings import sightings, with_points
from photogrammetry.adjustment.snooping import reinstated, residuals, suspects
from photogrammetry.adjustment.solver import Problem, linearise, solve
from photogrammetry.errors import AdjustmentError
from photogrammetry.imagery import StopId


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the adjustment."""

    name: str
    robust: bool
    """Whether large residuals count linearly (Huber) rather than squared."""


STEPS = (
    Step("bring the stops together while blunders hide", robust=True),
    Step("weigh every remaining tie fully", robust=False),
)


def adjust(
    network: Network,
    held: AbstractSet[StopId],
    params: AdjustmentParams,
    start: AdjustedNetwork | None = None,
    name: str = "adjust",
    inherited: Marginal | None = None,
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Adjust a network with some stops held where `start`, or else telemetry, has them.

    Stops and pairs that `start` knows begin there; the others are aligned to them first. What
    observations that are no longer in the network said of its stops may be `inherited`. Not
    converging is returned and reported; look at `AdjustmentReport.is_usable`.

    Raises:
        AdjustmentError: no stop is held and nothing inherited, or a held one is not in the network.
    """
    is_held = _held(network, held, has_datum=inherited is not None)
    observations, telemetry = Observations.of(network), Telemetry.of(network, params)
    known, is_known = _known(network, telemetry, observations, start)
    before = carried(known, telemetry, is_held, is_known)
    state, fits = initialise(observations, telemetry, is_held, params, known, is_known)
    seen = sightings(observations, known.pointings, params)
    placed = is_held if inherited is None else is_held | is_known
    initial = Initial(network.stop_ids, observations, telemetry, seen, state, fits, placed)
    findings, alone = diagnose(initial)
    if len(alone):
        rest = without_unchecked(network, observations, alone)
        again = adjust(rest, held, params, start, name, inherited)
        return completed(again, network, findings)
    state = with_rays_intersected(state, observations, fits)
    used = fits & np.isfinite(misclosures(state, observations, np.arange(len(fits)))).all(axis=1)
    outcome = _run(STEPS, observations, telemetry, is_held, state, used, params, inherited)
    agreement = (
        consistency(observations, before, seen, outcome.used),
        consistency(
            observations,
            outcome.solution.state,
            sightings(observations, outcome.solution.state.pointings, params),
            outcome.used,
        ),
    )
    return with_findings(assembled(network, is_held, outcome, agreement, name), findings)


def adjust_overall(
    network: Network, params: AdjustmentParams, start: AdjustedNetwork | None = None
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Adjust all stops at once, the first one held."""
    if not network.stops:
        raise AdjustmentError("there is no stop to adjust: the network is empty")
    return adjust(network, {network.stop_ids[0]}, params, start, "overall adjustment")


def telemetry_network(network: Network, params: AdjustmentParams) -> AdjustedNetwork:
    """The network where telemetry alone has it, with the covariance that telemetry deserves.

    The answer to fall back on when an adjustment is not usable; its ties are left out.
    """
    bare = replace(network, ties=select(network.ties, np.zeros(len(network.ties), dtype=bool)))
    return adjust_overall(bare, params)[0]


def _held(network: Network, held: AbstractSet[StopId], *, has_datum: bool) -> np.ndarray:
    """Which stops are held; refuses a network without datum."""
    strangers = sorted(set(held) - set(network.stop_ids))
    if strangers:
        raise AdjustmentError(f"{strangers[0]} cannot be held: it is not in the network")
    if not (held or has_datum):
        raise AdjustmentError(
            f"the datum of the network of {len(network.stops)} stops is undefined: images and "
            "telemetry increments only tell where stops are relative to each other; hold one stop "
            "fixed, normally the first of the traverse"
        )
    return np.array([stop in held for stop in network.stop_ids], dtype=bool)


def _known(
    network: Network,
    telemetry: Telemetry,
    observations: Observations,
    start: AdjustedNetwork | None,
) -> tuple[State, np.ndarray]:
    """Telemetry as a state, overwritten by what a former adjustment knows."""
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
    return State(rotations, centres, pointings, points), is_known


def _run(  # noqa: PLR0913, PLR0917 - the problem, and where it starts
    steps: tuple[Step, ...],
    observations: Observations,
    telemetry: Telemetry,
    held: np.ndarray,
    state: State,
    used: np.ndarray,
    params: AdjustmentParams,
    inherited: Marginal | None = None,
) -> Outcome:
    """Run the steps, each until no blunder is found any more."""
    iterations = 0
    for step in steps:
        for _ in range(params.max_rounds):
            problem = Problem.of(observations, telemetry, held, used, inherited)
            solution = solve(problem, state, params, robust=step.robust)
            iterations += solution.iterations
            state = solution.state
            threshold = params.huber if step.robust else None
            now = linearise(problem, state, threshold)
            inverse = now.factor.inverse()
            found = residuals(problem, state, now.ties, inverse)
            wrong = suspects(problem, found, params)
            if not len(wrong):
                break
            used = used.copy()
            used[wrong] = False
        if step.robust:
            state = _placed(observations, state, used, problem, params)
            used = used.copy()
            used[reinstated(problem, state, found, used, inverse, params)] = True
    placed = _placed(observations, state, used, problem, params)
    final = replace(solution, state=placed, iterations=iterations)
    return Outcome(observations, problem, final, used, found, inverse)


def _placed(
    observations: Observations,
    state: State,
    used: np.ndarray,
    problem: Problem,
    params: AdjustmentParams,
) -> State:
    """The state with the points that were not in the adjustment placed by their best sighting."""
    alone = with_points(state, observations, sightings(observations, state.pointings, params), used)
    adjusted = problem.anchor >= 0
    return replace(state, points=np.where(adjusted[:, None], state.points, alone.points))


__all__ = ["STEPS", "adjust", "adjust_overall", "telemetry_network"]
