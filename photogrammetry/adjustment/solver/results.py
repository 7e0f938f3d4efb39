"""Records of an adjustment, made from the arrays of the solution.

Poses, points and control with their covariances, the report, and for every stop what determines its
pose: ties or control that lead to the datum, or the telemetry increment from the stop before.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    BLUNDER,
    KINDS,
    UNUSED,
    USED,
    AdjustedControl,
    AdjustedFrame,
    AdjustedMast,
    AdjustedNetwork,
    AdjustedPair,
    AdjustedStop,
    AdjustedTies,
    AdjustmentReport,
    Consistency,
)
from solmap.photogrammetry.adjustment.model.collinearity import (
    Observations,
    State,
    seen_from_several,
)
from solmap.photogrammetry.adjustment.model.control_equations import Control
from solmap.photogrammetry.adjustment.model.network import MAP, Network
from solmap.photogrammetry.adjustment.solver.blunders import ControlTests
from solmap.photogrammetry.adjustment.solver.estimate import Outcome
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.adjustment.solver.residuals import (
    UNCHECKED,
    joint_covariances,
    pair_covariances,
    point_covariances,
    single_sighting_covariances,
)
from solmap.photogrammetry.arrays import Bool, Float64
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import TieKind

SIGNIFICANT = 0.999
"""Level of the global test: only a significant sigma0 enlarges the sigmas."""


def adjusted_records(
    network: Network,
    held: np.ndarray,
    outcome: Outcome,
    agreement: tuple[dict[TieKind, Consistency], dict[TieKind, Consistency]],
    name: str,
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """The adjusted network and its report."""
    redundancy, cost = outcome.problem.redundancy, outcome.solution.cost
    sigma0 = float(np.sqrt(cost / redundancy)) if redundancy > 0 else float("nan")
    doubtful = redundancy > 0 and cost > chdtri(redundancy, 1.0 - SIGNIFICANT)
    factor = sigma0**2 if doubtful else 1.0
    joint = joint_covariances(outcome.problem, outcome.inverse) * factor
    of_pairs = pair_covariances(outcome.views, joint)
    pairs = _pairs(network, outcome, joint, of_pairs)
    stops = _stops(network, held, outcome, joint)
    kinds = _kinds(outcome.observations, outcome.used)
    ties = _ties(network, outcome, factor, of_pairs, kinds)
    control = adjusted_control(network, outcome.problem, outcome.solution.state, outcome.placed)
    placed = np.isfinite(ties.points).all(axis=1)
    seen = np.bincount(outcome.observations.point[outcome.used], minlength=len(placed)) > 0
    counts = np.bincount(kinds[placed & seen], minlength=len(KINDS)).tolist()
    report = AdjustmentReport(
        name=name,
        converged=outcome.solution.converged,
        iterations=outcome.solution.iterations,
        sigma0=sigma0,
        redundancy=redundancy,
        stops=len(stops),
        pairs=len(pairs),
        ties=dict(zip(KINDS, counts, strict=True)),
        blunders=int((ties.status == BLUNDER).sum()),
        before=agreement[0],
        after=agreement[1],
        untied=tuple(stop.stop for stop in stops if not stop.is_tied),
        message=outcome.solution.message,
        control=sum(one.used and one.control.frame != MAP.name for one in control),
        control_refused=tuple(
            f"{one.control.stop} in {one.control.frame} ({one.note})"
            for one in control
            if not one.used
        ),
    )
    frames = adjusted_frames(network, outcome.problem, outcome.solution.state, outcome.inverse)
    adjusted = AdjustedNetwork(stops, pairs, ties, control=control, frames=frames)
    mast = replace(AdjustedMast(), values=outcome.solution.state.mast)
    if outcome.problem.unknowns.mast:
        mast = replace(mast, covariance=outcome.inverse[outcome.problem.mast_own] * factor)
    return replace(adjusted, mast=mast), report


def _pairs(
    network: Network, outcome: Outcome, joint: np.ndarray, covariances: np.ndarray
) -> tuple[AdjustedPair, ...]:
    """The adjusted pairs, from their joint covariances (9, 9) and those (6, 6) of their poses."""
    state, observations = outcome.solution.state, outcome.observations
    joined = np.bincount(observations.pair[outcome.problem.rows], minlength=len(network.pairs))
    labels = [pair.geometry.rover_from_pair for pair in network.pairs]
    in_lsl = Pose.many(((LSL, label.source) for label in labels), *outcome.views.orientations)
    in_rover = observations.in_rover(state.pointings)
    true = Pose.many(((label.target, label.source) for label in labels), *in_rover)
    return tuple(
        AdjustedPair(
            pair.pair_id,
            pair.stop,
            in_lsl[k],
            true[k],
            state.pointings[k],
            covariances[k],
            joint[k, 6:, 6:],
            int(joined[k]),
        )
        for k, pair in enumerate(network.pairs)
    )


def _stops(
    network: Network, held: np.ndarray, outcome: Outcome, joint: np.ndarray
) -> tuple[AdjustedStop, ...]:
    """The adjusted stops, with what determines each."""
    state, unknowns = outcome.solution.state, outcome.problem.unknowns
    inherited, known = outcome.problem.inherited, np.zeros_like(held)
    past = set(inherited.stops.tolist()) if inherited else set()
    if inherited:
        known[inherited.stops[inherited.grounded]] = True
    control = outcome.problem.control
    holding = Holding.of(outcome.observations, outcome.used, held, known, control)
    frames = ((LSL, prior.stop.frame) for prior in network.stops)
    poses = Pose.many(frames, state.rotations, state.centres)
    with_pairs, first = np.unique(unknowns.pair_stop, return_index=True)
    first_pair = dict(zip(with_pairs.tolist(), first.tolist(), strict=True))
    stops = []
    for k, prior in enumerate(network.stops):
        C = joint[first_pair[k], :6, :6] if k in first_pair else _without_pairs(outcome, k)
        stops.append(
            AdjustedStop(
                prior.stop,
                poses[k],
                (C + C.T) / 2,
                bool(held[k]),
                bool(holding.reached[k]),
                holding.describe(network, k)
                + ("; the marginal of earlier stops" if k in past else ""),
            )
        )
    return tuple(stops)


def _without_pairs(outcome: Outcome, k: int) -> Float64[np.ndarray, "6 6"]:
    """The covariance of a stop that has no pair."""
    problem = outcome.problem
    columns = problem.unknowns.stop_columns[k : k + 1]
    return outcome.inverse[problem.pattern.own(np.array([k]), columns)[0]]


def _ties(
    network: Network, outcome: Outcome, factor: float, of_pairs: np.ndarray, kinds: np.ndarray
) -> AdjustedTies:
    """The tie points as adjusted, with residuals and status; `kinds` as numbers of `KINDS`.

    `of_pairs` (pairs, 6, 6) are covariances of the poses of pairs.
    """
    observations, state, used = outcome.observations, outcome.solution.state, outcome.used
    l = np.zeros((0, 3))
    if len(used):
        l = outcome.views.misclosures(observations.sights).T.copy()
    l[observations.weight == 0] = np.nan
    has_stereo = np.bincount(
        observations.point[observations.is_stereo], minlength=observations.points
    )
    status = np.where(used, USED, np.where(has_stereo[observations.point] > 0, BLUNDER, UNUSED))
    covariances = factor * point_covariances(outcome.problem, state, outcome.ties, outcome.inverse)
    alone = used & observations.is_stereo
    alone[outcome.problem.rows] = False
    rows = np.flatnonzero(alone)
    covariances[observations.point[rows]] = single_sighting_covariances(
        outcome.views, observations.sights.at(rows), of_pairs
    )
    return AdjustedTies(
        network.ties,
        state.points,
        covariances,
        tuple(map(KINDS.__getitem__, kinds.tolist())),
        status.astype(np.int32),
        l,
        outcome.residuals.standardised,
        outcome.residuals.redundancy,
    )


def _kinds(observations: Observations, used: np.ndarray) -> np.ndarray:
    """The kind of tie of each point, by its used observations, as a number of `KINDS`."""
    point, count = observations.point[used], observations.points
    stops = seen_from_several(point, observations.stop[used], count)
    pairs = seen_from_several(point, observations.pair[used], count)
    return np.where(stops, 2, pairs.astype(np.int64))


def adjusted_control(
    network: Network, problem: Problem, state: State, tests: ControlTests
) -> tuple[AdjustedControl, ...]:
    """Result of every control observation."""
    control = problem.control
    if control is None:
        return ()
    off = np.where(control.is_given, control.misclosures(state), np.nan)
    return tuple(
        AdjustedControl(
            one,
            bool(control.used[k]),
            off[k],
            float(tests.length[k]) if tests.redundancy[k] > UNCHECKED else float("nan"),
            float(tests.redundancy[k]),
            _note(off[k], tests, k, used=bool(control.used[k])),
        )
        for k, one in enumerate(network.control)
    )


def _note(off: np.ndarray, tests: ControlTests, k: int, *, used: bool) -> str:
    if not used and tests.length[k] <= tests.gate[k]:
        return "contradicted by another one; it cannot be decided which is wrong"
    if not used:
        return (
            f"off by {off[0]:+.2f} m east and {off[1]:+.2f} m north, {tests.length[k]:.1f} "
            f"standard deviations where {tests.gate[k]:.1f} may be chance"
        )
    return "" if tests.redundancy[k] > UNCHECKED else "no other observation checks it"


def adjusted_frames(
    network: Network, problem: Problem, state: State, inverse: np.ndarray
) -> tuple[AdjustedFrame, ...]:
    """Position of every control frame."""
    if not network.frames:
        return ()
    unknowns = problem.unknowns
    C = inverse[problem.pattern.own(unknowns.frame_blocks, unknowns.frame_columns)]
    return tuple(
        AdjustedFrame(frame, state.frames[k], (C[k] + C[k].T) / 2)
        for k, frame in enumerate(network.frames)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Holding:
    """Connections of the stops of a network by their used ties."""

    shared: tuple[dict[int, int], ...]
    """Number of ties that each stop shares with each other stop."""
    held: Bool[np.ndarray, " stops"]
    reached: Bool[np.ndarray, " stops"]
    """Whether ties or control lead to a stop that is held, or known from before."""
    placed: dict[int, list[int]]
    """Numbers of the control frames that contain each stop."""

    @classmethod
    def of(
        cls,
        observations: Observations,
        used: Bool[np.ndarray, " rows"],
        held: Bool[np.ndarray, " stops"],
        known: Bool[np.ndarray, " stops"],
        control: Control | None = None,
    ) -> Holding:
        """Of a network's used observations; `held` is the datum, `known` stops are joined to it."""
        shared: tuple[dict[int, int], ...] = tuple({} for _ in held)
        stop, point = observations.stop[used], observations.point[used]
        joins = seen_from_several(point, stop, observations.points)[point]
        for (a, b), count in _couples(point[joins], stop[joins], len(held)).items():
            shared[a][b] = shared[b][a] = count
        placed = _frames_by_stop(control)
        near = [
            {*others, *(o for f in placed.get(k, ()) for o in _stops_of_frame(placed, f))}
            for k, others in enumerate(shared)
        ]
        reached = np.array(held | known)
        if control:
            free = control.is_free[control.frame]
            reached[control.stop[control.used & np.logical_not(free.any(axis=1))]] = True
        front = np.flatnonzero(reached).tolist()
        while front:
            for other in near[front.pop()]:
                if not reached[other]:
                    reached[other] = True
                    front.append(other)
        return cls(shared, held, reached, placed)

    def describe(self, network: Network, k: int) -> str:
        """Observations that determine stop k, as text."""
        if self.held[k]:
            return "held as the datum"
        names, frames = network.stop_ids, network.frames
        held = [frames[f].name for f in self.placed.get(k, ())]
        parts = ["datum by its position"] if MAP.name in held else []
        if images := [name for name in held if name != MAP.name]:
            parts.append(f"control: its position in {', '.join(images)}")
        ties = sorted(self.shared[k].items())
        listed = ", ".join(f"{count} with {names[other]}" for other, count in ties)
        if self.reached[k]:
            return "; ".join([*parts, *([f"cross-site ties: {listed}"] if listed else [])])
        carried = f"telemetry increment from {names[k - 1]}" if k else "telemetry"
        return f"{carried}; ties do not reach the datum ({listed})" if listed else carried


def _frames_by_stop(control: Control | None) -> dict[int, list[int]]:
    placed: dict[int, list[int]] = {}
    if control:
        both = np.column_stack([control.stop, control.frame])[control.used]
        for stop, frame in np.unique(both, axis=0).tolist():
            placed.setdefault(stop, []).append(frame)
    return placed


def _stops_of_frame(placed: dict[int, list[int]], frame: int) -> list[int]:
    """Stops located in a control frame."""
    return [stop for stop, frames in placed.items() if frame in frames]


def _couples(point: np.ndarray, stop: np.ndarray, stops: int) -> Counter[tuple[int, int]]:
    """Every two stops (a < b) with points that both saw, and their number."""
    point, stop = np.divmod(np.unique(point.astype(np.int64) * stops + stop), stops)
    couples: Counter[tuple[int, int]] = Counter()
    for lag in range(1, len(point)):
        same = point[lag:] == point[:-lag]
        if not same.any():
            break
        counts = np.bincount(stop[:-lag][same] * stops + stop[lag:][same])
        both = np.flatnonzero(counts)
        for code, count in zip(both.tolist(), counts[both].tolist(), strict=True):
            couples[divmod(code, stops)] += count
    return couples
