"""Cost of a state, and the normal equations there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from photogrammetry.adjustment.blocks import Factor, factorise
from photogrammetry.adjustment.collinearity import (
    State,
    misclosures_by_component,
    partials_by_component,
)
from photogrammetry.adjustment.elimination import EliminatedTies, eliminate
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.priors import telemetry_misclosures, telemetry_partials
from photogrammetry.adjustment.problem import Problem

CHI3_MEDIAN = 1.538
"""Median length of a standard normal vector of three coordinates."""
EVERY = slice(None)


def whitened(problem: Problem, state: State) -> np.ndarray:
    """Misclosures of the rows in the adjustment times their weights, (3, m)."""
    return misclosures_by_component(state, problem.seen, EVERY) * problem.seen.weight.T


def lengths(l: np.ndarray) -> np.ndarray:
    """Length of every column of (3, m)."""
    return np.sqrt(l[0] ** 2 + l[1] ** 2 + l[2] ** 2)


def huber_weights(t: np.ndarray, threshold: float | None) -> np.ndarray:
    """Weights of squared residuals that make least squares minimise Huber's loss."""
    if threshold is None:
        return np.ones_like(t)
    return threshold / np.maximum(t, threshold)


def huber_threshold(problem: Problem, state: State, params: AdjustmentParams) -> float:
    """Where the loss turns linear at a state: in units of the spread that residuals have there.

    Far from the minimum every residual is large; were all taken for blunders, telemetry would win
    over the images and the step lead astray.
    """
    t = lengths(whitened(problem, state))
    spread = float(np.median(t)) / CHI3_MEDIAN if len(t) else 1.0
    return params.huber * max(1.0, spread)


def cost_of(problem: Problem, state: State, threshold: float | None) -> float:
    """The sum that is minimised; infinite where a point lies behind a camera."""
    t = lengths(whitened(problem, state))
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
    l = whitened(problem, state)
    root = np.sqrt(huber_weights(lengths(l), threshold))
    A = partials_by_component(state, problem.seen, EVERY).weighted(problem.seen.weight.T * root)
    l *= root
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


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """The problem at a state: factor of the normal equations, and the ties without their points."""

    factor: Factor
    flat: np.ndarray
    """The normal matrix, as a flat array of blocks."""
    right: np.ndarray
    ties: tuple[EliminatedTies, ...]


def linearise(problem: Problem, state: State, threshold: float | None) -> Linearised:
    """The problem at a state, factored."""
    flat, right, ties = normal_equations(problem, state, threshold)
    factor = factorise(problem.pattern, flat)
    return Linearised(factor, flat, right, ties)
