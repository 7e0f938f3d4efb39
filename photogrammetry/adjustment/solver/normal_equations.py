"""Cost of a state, and the normal equations there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import State, Views
from solmap.photogrammetry.adjustment.model.control_equations import Control
from solmap.photogrammetry.adjustment.model.telemetry import (
    telemetry_misclosures,
    telemetry_partials,
)
from solmap.photogrammetry.adjustment.solver.block_matrix import Factor, factorise
from solmap.photogrammetry.adjustment.solver.elimination import EliminatedTies, eliminate
from solmap.photogrammetry.adjustment.solver.problem import LINK_TRIANGLE, Problem
from solmap.photogrammetry.arrays import Float64

HUBER = 2.8
"""Threshold at which the robust loss becomes linear, in standard deviations of an observation of
three coordinates: the 95 % point of the chi distribution with three degrees of freedom."""
CHI3_MEDIAN = 1.538
"""Median length of a standard normal vector of three coordinates."""
CACHED = 4096
"""Observations that are evaluated together, so that they fit a processor core's cache."""

FEW = 8
"""Time of adding one value at its index, relative to that of one term of a sum."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearisationPoint:
    """A state, and what is computed from it."""

    state: State
    views: Views
    l: np.ndarray
    """(3, m) misclosures of the rows in the adjustment times their weights."""
    links: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))
    """(stops, 6) misclosures of telemetry times their weights."""
    z: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Coordinates of the marginal, see `marginal`."""

    @classmethod
    def of(cls, problem: Problem, state: State, views: Views | None = None) -> LinearisationPoint:
        """Evaluate a state; `views` if they are known already."""
        views = views or Views.of(state, problem.observations)
        l = np.empty_like(problem.sights.measured)
        for begin in range(0, len(problem.sights), CACHED):
            part = slice(begin, begin + CACHED)
            sights = problem.sights.part(part)
            np.multiply(views.misclosures(sights), sights.weight, out=l[:, part])
        links = telemetry_misclosures(state, problem.telemetry) * problem.link_weight
        known = problem.inherited
        return cls(state, views, l, links, known.chart.coordinates(state) if known else np.zeros(0))


def lengths(l: np.ndarray) -> np.ndarray:
    """Length of every column of (3, m)."""
    return np.sqrt(l[0] ** 2 + l[1] ** 2 + l[2] ** 2)


def huber_weights(t: np.ndarray, threshold: float) -> np.ndarray:
    """Weights of squared residuals that make least squares minimise Huber's loss."""
    return threshold / np.maximum(t, threshold)


def huber_threshold(problem: Problem, at: LinearisationPoint) -> float:
    """Where the loss becomes linear at a state: in units of the spread of its residuals.

    Far from the minimum every residual is large. If all counted as blunders, telemetry would
    outweigh the images and the step would go in a wrong direction.
    """
    t = lengths(at.l)
    t = t[t > 0]  # repeated observations have no weight
    spread = float(np.median(t)) / CHI3_MEDIAN if len(t) else 1.0
    if problem.control and problem.control.used.any():
        off = np.sort(control_lengths(problem.control, at.state)[problem.control.used])
        spread = max(spread, float(off[(len(off) - 1) // 2]) / CHI3_MEDIAN)
    return HUBER * max(1.0, spread)


def control_lengths(control: Control, state: State) -> np.ndarray:
    """Distance of every stop from its control, in standard deviations."""
    return np.linalg.norm(control.whitened_misclosures(state), axis=1)


def control_weights(
    control: Control, l: np.ndarray, threshold: float | None
) -> Float64[np.ndarray, " n"]:
    """Weight of the squared misclosures of control: none if set aside, less under Huber's loss."""
    weight = control.used.astype(float)
    if threshold is None:
        return weight
    less = huber_weights(np.linalg.norm(l, axis=1), threshold)
    return np.where(control.is_datum, weight, weight * less)


def cost_of(problem: Problem, at: LinearisationPoint, threshold: float | None) -> float:
    """The minimised sum; infinite where a point lies behind a camera."""
    state = at.state
    images = float(np.vdot(at.l, at.l)) if threshold is None else _loss(lengths(at.l), threshold)
    if not np.isfinite(images):
        return np.inf
    telemetry = problem.telemetry
    turning = telemetry.masts_turn
    pointing = telemetry.misses(state) * telemetry.pointing_weight if turning else np.zeros(0)
    known = problem.inherited.cost_at(at.z) if problem.inherited else 0.0
    if problem.unknowns.mast:
        known += float(np.vdot(state.mast, state.mast)) * telemetry.mast_weight**2
    if problem.control:
        control = problem.control
        off, doubtful = control_lengths(control, state), control.used & ~control.is_datum
        known += _loss(off[doubtful], threshold) + _loss(off[control.is_datum], None)
        known += float((control.prior_misclosures(state) ** 2).sum())
    return images + float(np.vdot(at.links, at.links) + np.vdot(pointing, pointing)) + known


def _loss(t: np.ndarray, threshold: float | None) -> float:
    """Sum of squares, or of Huber's loss."""
    if threshold is None:
        return float((t**2).sum())
    return float(np.where(t <= threshold, t**2, 2 * threshold * t - threshold**2).sum())


def normal_equations(
    problem: Problem, state: State, threshold: float | None
) -> tuple[np.ndarray, np.ndarray, tuple[EliminatedTies, ...]]:
    """Reduced normal matrix (flat), right-hand side (with a bin at the end), eliminated ties."""
    flat, right, ties = _reduced_normals(problem, LinearisationPoint.of(problem, state), threshold)
    return problem.pattern.symmetric(flat), right, ties


def _reduced_normals(
    problem: Problem, at: LinearisationPoint, threshold: float | None
) -> tuple[np.ndarray, np.ndarray, tuple[EliminatedTies, ...]]:
    """The reduced normal equations, with only the lower triangle of the matrix."""
    flat, right, ties = sum_normals(problem, _eliminate_groups(problem, at, threshold))
    _add_telemetry(problem, at, flat, right)
    _add_inherited(problem, at, flat, right)
    _add_control(problem, at.state, flat, right, threshold)
    flat[-1] = right[-1] = 0.0
    return flat, right, ties


def _eliminate_groups(
    problem: Problem, at: LinearisationPoint, threshold: float | None
) -> Iterator[EliminatedTies]:
    """The groups of a problem with their points eliminated."""
    end, small = 0, len(problem.sights) <= CACHED
    masts = at.views.masts()
    together = at.views.partials(problem.sights, masts) if small else None
    for group in problem.groups:
        part = slice(end, end := end + group.rows.size)
        l = at.l[:, part]
        A = together.of(part) if together else at.views.partials(problem.sights.part(part), masts)
        if threshold is not None:
            root = np.sqrt(huber_weights(lengths(l), threshold))
            l, A = l * root, A.apply_weight(root)
        yield eliminate(group, l, A, at.views)


def sum_normals(
    problem: Problem, groups: Iterable[EliminatedTies]
) -> tuple[np.ndarray, np.ndarray, tuple[EliminatedTies, ...]]:
    """Normal equations of ties: lower triangle, right-hand side (unused last entries), ties."""
    flat, right = np.zeros(problem.pattern.length + 1), np.zeros(problem.unknowns.count + 1)
    ties = []
    for tie, place, right_place in zip(groups, problem.places, problem.right_places, strict=True):
        N, n = tie.normals()
        _add(flat, place, N)
        _add(right, right_place, n)
        ties.append(tie)
    return flat, right, tuple(ties)


def _add_telemetry(
    problem: Problem, at: LinearisationPoint, flat: np.ndarray, right: np.ndarray
) -> None:
    """Add tilt, azimuth, increments and mast pointing."""
    A = telemetry_partials(at.state, problem.telemetry) * problem.link_weight[:, :, None]
    _add(flat, problem.link_places, (A.swapaxes(1, 2) @ A)[:, *LINK_TRIANGLE])
    _add(right, problem.link_right, (at.links[:, None, :] @ A)[:, 0])
    if not problem.telemetry.masts_turn:
        return
    w2, (_, pointings, _) = problem.telemetry.pointing_weight**2, problem.unknowns.unpacked
    flat[problem.pointing_places] += w2
    misses, B = problem.telemetry.misses(at.state), problem.telemetry.mast
    right[pointings] -= w2 * misses
    if k := problem.unknowns.mast:
        flat[problem.mast_places] -= w2 * B
        flat[problem.mast_own] += w2 * np.einsum("nij,nik->jk", B, B)
        flat[problem.mast_own.diagonal()] += problem.telemetry.mast_weight**2
        right[-1 - k : -1] += w2 * np.einsum("nij,ni->j", B, misses)
        right[-1 - k : -1] -= problem.telemetry.mast_weight**2 * at.state.mast


def _add_inherited(
    problem: Problem, at: LinearisationPoint, flat: np.ndarray, right: np.ndarray
) -> None:
    """Add the marginal of earlier observations."""
    if problem.inherited is None:
        return
    places, right_places = problem.inherited_places
    N, n = problem.inherited.normals_at(at.state, at.z)
    _add(flat, places, N)
    _add(right, right_places, n)


def _add_control(
    problem: Problem, state: State, flat: np.ndarray, right: np.ndarray, threshold: float | None
) -> None:
    """Add control of stops, and the priors of control frames."""
    control, unknowns = problem.control, problem.unknowns
    if control is None or problem.control_places is None or problem.frame_places is None:
        return
    l, (of_stop, of_frame) = control.whitened_misclosures(state), control.partials(state)
    weight = control_weights(control, l, threshold)
    A = np.concatenate([of_frame, of_stop], axis=2) * np.sqrt(weight)[:, None, None]
    l = l * np.sqrt(weight)[:, None]
    _add(flat, problem.control_places, A.mT @ A)
    places = [
        unknowns.places(unknowns.frame_blocks[control.frame][:, None],
                        unknowns.frame_columns[control.frame]),
        unknowns.places(control.stop[:, None].astype(np.int64),
                        unknowns.stop_columns[control.stop]),
    ]  # fmt: skip
    _add(right, np.hstack(places), (l[:, None, :] @ A)[:, 0])
    W = control.prior
    _add(flat, problem.frame_places, W.mT @ W)
    own = unknowns.places(unknowns.frame_blocks[:, None], unknowns.frame_columns)
    _add(right, own, (control.prior_misclosures(state)[:, None, :] @ W)[:, 0])


def _add(total: np.ndarray, places: np.ndarray, values: np.ndarray) -> None:
    """Add values at indices of a flat array: in one pass if they are many and the array small."""
    if FEW * places.size > len(total):
        total += np.bincount(places.ravel(), values.ravel(), minlength=len(total))
    else:
        np.add.at(total, places.ravel(), values.ravel())


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """The problem at a state: factor of the normal equations, and the eliminated ties."""

    factor: Factor
    right: np.ndarray
    ties: tuple[EliminatedTies, ...]

    def with_misclosures_at(self, at: LinearisationPoint) -> Linearisation:
        """These equations with the misclosures of a nearby linearisation point."""
        ties, end = [], 0
        for tie in self.ties:
            part = slice(end, end := end + tie.group.rows.size)
            ties.append(tie.with_misclosures(at.l[:, part]))
        return replace(self, ties=tuple(ties))


def linearise(problem: Problem, at: LinearisationPoint, threshold: float | None) -> Linearisation:
    """The problem at a linearisation point, factored; `threshold` is that of the robust loss."""
    flat, right, ties = _reduced_normals(problem, at, threshold)
    return Linearisation(factorise(problem.pattern, flat), right, ties)
