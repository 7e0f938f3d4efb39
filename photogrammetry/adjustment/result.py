"""From the solution's arrays to the records that leave the adjustment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from solmap.photogrammetry.adjustment.collinearity import (
    Observations,
    Views,
)
from solmap.photogrammetry.adjustment.control_results import adjusted_control, adjusted_frames
from solmap.photogrammetry.adjustment.control_tests import ControlTests
from solmap.photogrammetry.adjustment.datum import MAP
from solmap.photogrammetry.adjustment.elimination import EliminatedTies
from solmap.photogrammetry.adjustment.holding import Holding
from solmap.photogrammetry.adjustment.observations import seen_differently
from solmap.photogrammetry.adjustment.problem import Problem
from solmap.photogrammetry.adjustment.records import (
    BLUNDER,
    UNUSED,
    USED,
    AdjustedNetwork,
    AdjustedPair,
    AdjustedStop,
    AdjustedTies,
    AdjustmentReport,
    Consistency,
    Network,
)
from solmap.photogrammetry.adjustment.residuals import (
    Residuals,
    joint_covariances,
    pair_covariances,
    point_covariances,
    single_sightings,
)
from solmap.photogrammetry.adjustment.sightings import Sightings, points_seen
from solmap.photogrammetry.adjustment.solver import Solution
from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import TieKind, TiePoints

KINDS = tuple(TieKind)
"""From ties within a pair to those between stops."""
SIGNIFICANT = 0.999
"""Level of the global test: only a sigma0 that chance does not explain widens the sigmas."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """All that the iteration found."""

    observations: Observations
    problem: Problem
    solution: Solution
    views: Views
    """What is seen from the solution."""
    used: np.ndarray
    residuals: Residuals
    ties: tuple[EliminatedTies, ...]
    """As they were linearised last."""
    inverse: np.ndarray
    """Of the normal equations, on their pattern."""
    placed: ControlTests
    """Tests of control."""

    def with_all_points(self, seen: Sightings) -> Outcome:
        """The same with the places of points that one pair alone sees."""
        points = all_points(self.problem, self.views, self.used, seen)
        state = replace(self.solution.state, points=points)
        views = self.views.at(points.T.copy())
        return replace(self, solution=replace(self.solution, state=state), views=views)


def all_points(
    problem: Problem, views: Views, used: np.ndarray, seen: Sightings
) -> Float64[np.ndarray, "points 3"]:
    """All points, those that are in no adjustment where their sightings have them."""
    observations = problem.observations
    inside = np.zeros(observations.points, dtype=bool)
    inside[problem.points] = True
    points = points_seen(views, observations, seen, used & ~inside[observations.point])
    points[problem.points] = views.points.T[problem.points]
    return points


def assembled(
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
    return AdjustedNetwork(stops, pairs, ties, control=control, frames=frames), report


def _pairs(
    network: Network, outcome: Outcome, joint: np.ndarray, covariances: np.ndarray
) -> tuple[AdjustedPair, ...]:
    """The adjusted pairs, from the covariances (9, 9) behind each and (6, 6) of its pose."""
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
    """The adjusted stops, with what holds each."""
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
                holding.told(network, k) + ("; what earlier stops said of it" if k in past else ""),
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
    covariances[observations.point[rows]] = single_sightings(
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
    """What each point joins, by its used observations, as a number of `KINDS`."""
    point, count = observations.point[used], observations.points
    stops = seen_differently(point, observations.stop[used], count)
    pairs = seen_differently(point, observations.pair[used], count)
    return np.where(stops, 2, pairs.astype(np.int64))


def merged_ties(observations: TiePoints, parts: tuple[AdjustedTies, ...]) -> AdjustedTies:
    """The ties of a whole network, each as the last of the parts that has it left it.

    Tie points are numbered anew in every network, so parts are matched by what was measured: the
    same place in the same pair. A point stays as the part placed it that saw it from most places,
    though a later one may still see it from one of its stops. Observations that no part has are
    marked as unused.
    """
    n, points = len(observations), int(observations.point.max(initial=-1)) + 1
    status = np.full(n, UNUSED, dtype=np.int32)
    residuals, standardised = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    redundancy = np.zeros((n, 3))
    where, covariances = np.full((points, 3), np.nan), np.full((points, 3, 3), np.nan)
    ranks = np.full(points, -1)
    for part in parts:
        rows, at = _same_measurements(part.observations, observations)
        status[at], residuals[at] = part.status[rows], part.residuals_px[rows]
        standardised[at], redundancy[at] = part.standardised[rows], part.redundancy[rows]
        rank = np.array([KINDS.index(kind) for kind in part.kinds], dtype=np.int64)
        old, new = part.observations.point[rows], observations.point[at]
        better = np.isfinite(part.points[old]).all(axis=1) & (rank[old] >= ranks[new])
        old, new = old[better], new[better]
        where[new], covariances[new], ranks[new] = (
            part.points[old],
            part.covariances[old],
            rank[old],
        )
    kinds = tuple(KINDS[max(rank, 0)] for rank in ranks.tolist())
    return AdjustedTies(
        observations, where, covariances, kinds, status, residuals, standardised, redundancy
    )


def _same_measurements(some: TiePoints, others: TiePoints) -> tuple[np.ndarray, np.ndarray]:
    """Rows of both that are one measurement."""
    place = {name: k for k, name in enumerate(others.pair_ids)}
    numbers = np.array([place.get(name, -1) for name in some.pair_ids], dtype=np.int64)
    both = [(numbers[some.pair] if len(some) else some.pair, some.left), (others.pair, others.left)]
    keys = np.vstack([np.column_stack([pair, left]) for pair, left in both])
    _, codes = np.unique(keys, axis=0, return_inverse=True)
    _, rows, at = np.intersect1d(codes[: len(some)], codes[len(some) :], return_indices=True)
    return rows, at
