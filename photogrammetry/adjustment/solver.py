"""Gauss-Newton with step halving over the whole network.

Minimised is the sum of the squared weighted residuals of image coordinates and telemetry,

    cost = sum_obs rho(|w l|) + sum |w l|^2 (tilt, azimuth, increments) + sum |m_j / sigma|^2

where rho(t) = t^2, or in the robust phase Huber's: t^2 up to k, 2 k t - k^2 beyond, solved by
iterative reweighting. Steps are not damped: Marquardt's damping holds back the long bending modes
of an open traverse, which are soft but well determined; a step that raises the cost is halved
instead. The step is converged when x' N x, its squared length in its own standard deviations, is
negligible.

A correction turns whole stretches of an open traverse by degrees, and a point 20 m from a stop that
turns by t travels an arc that leaves its tangent by 20 t^2 / 2: many pixels. Corrections are
therefore applied along arcs, equal to first order: with D = c_k - c_(k-1), its linear change dD
and the mean turn m of both stops,

    D <- Exp(m) (D + dD - m x D)           X - c <- Exp(d) (X - c + dX - dc - d x (X - c))

Points move by their inverse depth as seen from the pair that is nearest to them: with the linear
step (da, db, dc) in the frame of that pair and y = (a, b, c),

    1/c <- 1/c - dc/c^2,    a/c <- a/c + (da - a/c dc)/c,   likewise b

which is the same to first order, and far points (parallax of a few pixels) stay in front of the
cameras and nearly linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from photogrammetry.adjustment.blocks import BlockPattern, Factor, factorise
from photogrammetry.adjustment.collinearity import (
    Observations,
    State,
    misclosures,
    pair_orientations,
    partials_by_component,
)
from photogrammetry.adjustment.elimination import EliminatedTies, eliminate, place_points
from photogrammetry.adjustment.layout import TieGroup, Unknowns, tie_groups
from photogrammetry.adjustment.marginal import Marginal
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.priors import (
    Telemetry,
    telemetry_misclosures,
    telemetry_partials,
)
from photogrammetry.adjustment.rotations import along_arcs, rotation_of_vector

CHI3_MEDIAN = 1.538
"""Median length of a standard normal vector of three coordinates."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A network ready to be solved: what is observed, what is free, and how it is laid out."""

    observations: Observations
    telemetry: Telemetry
    held: np.ndarray
    unknowns: Unknowns
    pattern: BlockPattern
    groups: tuple[TieGroup, ...]
    places: np.ndarray
    """Where in the flat normal matrix the normal equations of the groups go, one after another."""
    right_places: np.ndarray
    link_places: np.ndarray
    link_right: np.ndarray
    link_weight: np.ndarray
    """Telemetry weights, zero where all that a row depends on is held."""
    rows: np.ndarray
    """Observations that belong to a group, group by group."""
    anchor: np.ndarray
    """Per point, the pair that is nearest to it (-1: not in the adjustment)."""
    inherited: Marginal | None = None
    """What observations that have left said of these stops."""

    @classmethod
    def of(
        cls,
        observations: Observations,
        telemetry: Telemetry,
        held: np.ndarray,
        used: np.ndarray,
        inherited: Marginal | None = None,
    ) -> Problem:
        """Lay out a network: `held` by stop, `used` by observation."""
        unknowns = Unknowns.of(held, observations.pair_stop)
        groups = tie_groups(observations, used, unknowns)
        before = telemetry.before
        cliques: set[tuple[int, ...]] = {
            (int(b), k) for k, b in enumerate(before) if not (held[k] or held[b])
        }
        for group in groups:
            if group.slots[-1]:
                cliques.update(map(tuple, np.unique(group.stops, axis=0).tolist()))
        if inherited:
            cliques.add(tuple(inherited.stops.tolist()))
        pattern = BlockPattern.of(unknowns.sizes, cliques)
        felt = [(g.blocks[:, : g.felt], g.local[:, : g.felt]) for g in groups]
        none = np.zeros(0, dtype=np.int64)
        places = np.concatenate([none, *(pattern.indices(*f).ravel() for f in felt)])
        right_places = np.concatenate([none, *(unknowns.places(*f).ravel() for f in felt)])
        ends = np.column_stack([before, np.arange(len(before))])
        link = np.repeat(ends, 6, axis=1), unknowns.stop_columns[ends].reshape(len(ends), -1)
        link_places, link_right = pattern.indices(*link), unknowns.places(*link)
        weight = telemetry.weight.copy()
        weight[held, :2] = 0.0
        weight[held & (telemetry.is_fine | held[before]), 2] = 0.0
        weight[held & held[before], 3:] = 0.0
        rows = np.concatenate([none, *(g.rows.ravel() for g in groups)])
        anchor = np.full(observations.points, -1)
        nearest = rows[np.argsort(observations.measured[rows, 2], kind="stable")]
        anchor[observations.point[nearest]] = observations.pair[nearest]
        return cls(
            observations, telemetry, held, unknowns, pattern, groups, places, right_places,
            link_places, link_right, weight, rows, anchor, inherited,
        )  # fmt: skip

    @property
    def inherited_columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Block, and place in it, of the columns of what is inherited."""
        stops = self.inherited.stops if self.inherited else np.zeros(0, dtype=np.int64)
        pairs = self.inherited.pairs if self.inherited else np.zeros(0, dtype=np.int64)
        unknowns = self.unknowns
        blocks = np.concatenate([np.repeat(stops, 6), np.repeat(unknowns.pair_stop[pairs], 3)])
        local = [unknowns.stop_columns[stops].ravel(), unknowns.pair_columns[pairs].ravel()]
        return blocks, np.concatenate(local)

    @property
    def redundancy(self) -> int:
        """Observations minus unknowns."""
        coordinates = int((self.observations.weight[self.rows] > 0).sum())
        telemetry = int((self.link_weight > 0).sum()) + 3 * len(self.observations.pair_stop)
        points = 3 * sum(group.points for group in self.groups)
        known = self.inherited.surplus if self.inherited else 0
        return coordinates + telemetry + known - points - self.unknowns.count


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """The problem at a state: cost, factor of the normal equations, and the ties after QR."""

    cost: float
    factor: Factor
    flat: np.ndarray
    """The normal matrix, as a flat array of blocks."""
    right: np.ndarray
    ties: tuple[EliminatedTies, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where the iteration ended."""

    state: State
    cost: float
    converged: bool
    iterations: int
    message: str = ""


def whitened(problem: Problem, state: State) -> np.ndarray:
    """Misclosures of the rows in the adjustment times their weights, (m, 3)."""
    rows = problem.rows
    return misclosures(state, problem.observations, rows) * problem.observations.weight[rows]


def huber_weights(lengths: np.ndarray, threshold: float | None) -> np.ndarray:
    """Weights of squared residuals that make least squares minimise Huber's loss."""
    if threshold is None:
        return np.ones_like(lengths)
    return threshold / np.maximum(lengths, threshold)


def huber_threshold(problem: Problem, state: State, params: AdjustmentParams) -> float:
    """Where the loss turns linear at a state: in units of the spread that residuals have there.

    Far from the minimum every residual is large; were all taken for blunders, telemetry would win
    over the images and the step lead astray.
    """
    t = np.linalg.norm(whitened(problem, state), axis=1)
    spread = float(np.median(t)) / CHI3_MEDIAN if len(t) else 1.0
    return params.huber * max(1.0, spread)


def cost_of(problem: Problem, state: State, threshold: float | None) -> float:
    """The sum that is minimised; infinite where a point lies behind a camera."""
    t = np.linalg.norm(np.nan_to_num(whitened(problem, state), nan=np.inf), axis=1)
    if not np.isfinite(t).all():
        return np.inf
    loss = t**2
    if threshold is not None:
        loss = np.where(t <= threshold, loss, 2 * threshold * t - threshold**2)
    links = telemetry_misclosures(state, problem.telemetry) * problem.link_weight
    pointing = state.pointings * problem.telemetry.pointing_weight
    known = problem.inherited.cost(state) if problem.inherited else 0.0
    return float(loss.sum() + (links**2).sum() + (pointing**2).sum()) + known


def normal_equations(
    problem: Problem, state: State, threshold: float | None
) -> tuple[np.ndarray, np.ndarray, tuple[EliminatedTies, ...]]:
    """Reduced normal matrix (flat), right-hand side (with a bin at the end), eliminated ties."""
    observations, rows = problem.observations, problem.rows
    l = whitened(problem, state)
    root = np.sqrt(huber_weights(np.linalg.norm(l, axis=1), threshold))[:, None]
    A = partials_by_component(state, observations, rows)
    A, l = A.weighted((observations.weight[rows] * root).T), (l * root).T
    ties, end = [], 0
    for group in problem.groups:
        part = slice(end, end := end + group.rows.size)
        ties.append(eliminate(group, l[:, part], A.of(part), state.centres))
    N, n = zip(*(tie.normals() for tie in ties), strict=True) if ties else ((), ())
    flat = _summed(problem.places, N, problem.pattern.length + 1)
    right = _summed(problem.right_places, n, problem.unknowns.count + 1)
    _add_telemetry(problem, state, flat, right)
    _add_inherited(problem, state, flat, right)
    flat[-1] = right[-1] = 0.0
    return flat, right, tuple(ties)


def _summed(places: np.ndarray, parts: Sequence[np.ndarray], length: int) -> np.ndarray:
    """A flat array of some length, with the parts, one after the other, added at their places."""
    if not parts:
        return np.zeros(length)
    return np.bincount(places, np.concatenate([part.ravel() for part in parts]), minlength=length)


def _add_telemetry(problem: Problem, state: State, flat: np.ndarray, right: np.ndarray) -> None:
    """Add tilt, azimuth, increments and mast pointing."""
    weight = problem.link_weight
    l = telemetry_misclosures(state, problem.telemetry) * weight
    A = telemetry_partials(state, problem.telemetry) * weight[:, :, None]
    flat += np.bincount(
        problem.link_places.ravel(), (A.swapaxes(1, 2) @ A).ravel(), minlength=len(flat)
    )
    n = (l[:, None, :] @ A)[:, 0]
    right += np.bincount(problem.link_right.ravel(), n.ravel(), minlength=len(right))
    unknowns, w2 = problem.unknowns, problem.telemetry.pointing_weight**2
    stop = unknowns.pair_stop
    own = problem.pattern.start(stop, stop)[:, None]
    flat[own + unknowns.pair_columns * (unknowns.sizes[stop][:, None] + 1)] += w2
    right[unknowns.offsets[stop][:, None] + unknowns.pair_columns] -= w2 * state.pointings


def _add_inherited(problem: Problem, state: State, flat: np.ndarray, right: np.ndarray) -> None:
    """Add what observations that have left said."""
    if problem.inherited is None:
        return
    N, n = problem.inherited.normals(state)
    blocks, local = problem.inherited_columns
    at = np.where(local >= 0, problem.unknowns.offsets[blocks] + local, len(right) - 1)
    np.add.at(flat, problem.pattern.indices(blocks[None], local[None])[0], N)
    np.add.at(right, at, n)


def linearise(problem: Problem, state: State, threshold: float | None) -> Linearised:
    """The problem at a state, factored."""
    flat, right, ties = normal_equations(problem, state, threshold)
    factor = factorise(problem.pattern, flat)
    return Linearised(cost_of(problem, state, threshold), factor, flat, right, ties)


def solve(problem: Problem, start: State, params: AdjustmentParams, *, robust: bool) -> Solution:
    """Iterate to the minimum."""
    tolerance = params.robust_tolerance if robust else params.tolerance
    threshold = huber_threshold(problem, start, params) if robust else None
    state, cost = start, cost_of(problem, start, threshold)
    if not np.isfinite(cost):
        return Solution(state, cost, converged=False, iterations=0,
                        message="a tie point starts behind a camera")  # fmt: skip
    for iteration in range(1, params.max_iterations + 1):
        now = linearise(problem, state, threshold)
        x = now.factor.solve(now.right[:-1], problem.unknowns.offsets)
        length2 = float(x @ now.right[:-1])
        state, cost, shortened = _step(problem, state, cost, now, x, params, threshold)
        if threshold is not None:
            threshold = min(threshold, huber_threshold(problem, state, params))
            cost = cost_of(problem, state, threshold)
        if length2 < tolerance:
            return Solution(state, cost, converged=True, iterations=iteration)
        if shortened > params.max_halvings:
            flat = length2 < max(tolerance, 1e-9 * cost)  # rounding of the cost hides the rest
            return Solution(state, cost, converged=flat, iterations=iteration,
                            message="" if flat else "no step lowers the cost")  # fmt: skip
    return Solution(state, cost, converged=False, iterations=params.max_iterations,
                    message="iterations used up")  # fmt: skip


def _step(  # noqa: PLR0913, PLR0917 - all that the loop has in hand
    problem: Problem,
    state: State,
    cost: float,
    now: Linearised,
    x: np.ndarray,
    params: AdjustmentParams,
    threshold: float | None,
) -> tuple[State, float, int]:
    """The state after the longest of the halved steps that does not raise the cost."""
    turn_shift, pointing = problem.unknowns.unpack(x)
    d_points = np.zeros_like(state.points)
    for ties in now.ties:
        rows, base = ties.group.rows, ties.group.stops[ties.group.signature, 0]
        numbers = problem.observations.point[rows[0]]
        arm = state.points[numbers] - state.centres[base]
        d_points[numbers] = place_points(
            ties, turn_shift, pointing, problem.observations.pair[rows]
        )
        d_points[numbers] += turn_shift[base, 3:] + np.cross(turn_shift[base, :3], arm)
    slack = 1e-12 * (1.0 + abs(cost))
    for halvings in range(params.max_halvings + 1):
        part = 0.5**halvings
        trial = moved(
            problem, state, Correction(part * turn_shift, part * pointing, part * d_points)
        )
        trial_cost = cost_of(problem, trial, threshold)
        if trial_cost <= cost + slack:
            return trial, trial_cost, halvings
    return state, cost, params.max_halvings + 1


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Linear corrections of all unknowns."""

    turn_shift: np.ndarray
    """(stops, 6) rotation and shift in the LSL."""
    pointing: np.ndarray
    points: np.ndarray

    @property
    def turn(self) -> np.ndarray:
        """(stops, 3) rotation vectors."""
        return self.turn_shift[:, :3]

    @property
    def shift(self) -> np.ndarray:
        """(stops, 3) metres."""
        return self.turn_shift[:, 3:]


def moved(problem: Problem, state: State, correction: Correction) -> State:
    """The state after a correction, along arcs."""
    turned = rotation_of_vector(correction.turn)
    centres = along_arcs(state.centres, correction.turn, correction.shift, problem.held)
    points = state.points.copy()
    placed = np.flatnonzero(problem.anchor >= 0)
    stop = problem.observations.pair_stop[problem.anchor[placed]]
    arm = state.points[placed] - state.centres[stop]
    rest = correction.points[placed] - correction.shift[stop]
    rest -= np.cross(correction.turn[stop], arm)
    arm = _moved_points(problem, state, placed, rest) - state.centres[stop]
    points[placed] = centres[stop] + (turned[stop] @ arm[:, :, None])[:, :, 0]
    return State(turned @ state.rotations, centres, state.pointings + correction.pointing, points)


def _moved_points(
    problem: Problem, state: State, placed: np.ndarray, d_points: np.ndarray
) -> np.ndarray:
    """Points after linear corrections, taken in inverse depth from their nearest pair."""
    rotations, origins = pair_orientations(state, problem.observations)
    pair = problem.anchor[placed]
    y = ((state.points[placed] - origins[pair])[:, None, :] @ rotations[pair])[:, 0]
    dy = (d_points[:, None, :] @ rotations[pair])[:, 0]
    c = y[:, 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = c / (1.0 - dy[:, 2:] / c)
        ahead = np.isfinite(depth) & (depth > 0)
        direction = (y + dy - y / c * dy[:, 2:]) / c
    # A step past infinity has no inverse depth: such a point goes to a thousand times its distance.
    new = np.where(ahead, direction * depth, direction * c * 1e3)
    return origins[pair] + (rotations[pair] @ new[:, :, None])[:, :, 0]
