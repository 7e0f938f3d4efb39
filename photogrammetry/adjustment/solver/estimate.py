"""The estimate: solve, set blunders aside, and solve again until none is found.

First with a robust loss, under which large blunders do not mask each other; observations that fit
later are used again. Then every remaining observation has full weight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import (
    Observations,
    State,
    Views,
)
from solmap.photogrammetry.adjustment.model.control_equations import Control
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.sightings import Sightings, weighted_mean_points
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.adjustment.solver.blunders import (
    ControlTests,
    control_stands_out,
    control_tests,
    reinstate,
    suspects,
)
from solmap.photogrammetry.adjustment.solver.elimination import EliminatedTies
from solmap.photogrammetry.adjustment.solver.gauss_newton import Solution, solve
from solmap.photogrammetry.adjustment.solver.marginal import Marginal
from solmap.photogrammetry.adjustment.solver.normal_equations import (
    HUBER,
    Linearisation,
    LinearisationPoint,
    linearise,
)
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.adjustment.solver.residuals import (
    Residuals,
    residuals,
)
from solmap.photogrammetry.arrays import Bool, Float64


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the estimate."""

    name: str
    robust: bool
    """Whether large residuals count linearly (Huber) rather than squared."""


STEPS = (
    Step("join the stops under a robust loss", robust=True),
    Step("weigh every remaining tie fully", robust=False),
)


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """A network and the initial values of its estimate."""

    observations: Observations
    telemetry: Telemetry
    held: Bool[np.ndarray, " stops"]
    state: State
    views: Views
    """Views from the state."""
    used: Bool[np.ndarray, " rows"]
    inherited: Marginal | None = None
    control: Control | None = None

    def problem(self, used: np.ndarray) -> Problem:
        """The problem with the observations in use."""
        return Problem.of(
            self.observations, self.telemetry, self.held, used, self.inherited, self.control
        )

    def with_control(self, numbers: np.ndarray, *, used: bool = True) -> Start:
        """The same state with some control used again, or set aside."""
        if self.control is None or not len(numbers):
            return self
        return replace(
            self, control=self.control.with_used(_with_rows(self.control.used, numbers, to=used))
        )


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """All results of the iteration."""

    observations: Observations
    problem: Problem
    solution: Solution
    views: Views
    """Views from the solution."""
    used: np.ndarray
    residuals: Residuals
    ties: tuple[EliminatedTies, ...]
    """Ties at the last linearisation."""
    inverse: np.ndarray
    """Inverse of the normal equations, on their pattern."""
    placed: ControlTests
    """Tests of control."""

    def start_with(self, observations: Observations, telemetry: Telemetry) -> Start:
        """Initial values where this ended, with other weights."""
        problem = self.problem
        return Start(
            observations,
            telemetry,
            problem.held,
            self.solution.state,
            self.views,
            self.used,
            problem.inherited,
            problem.control,
        )

    def with_all_points(self, seen: Sightings) -> Outcome:
        """The result with the positions of points that only one pair sees."""
        points = all_points(self.problem, self.views, self.used, seen)
        state = replace(self.solution.state, points=points)
        views = self.views.at(points.T.copy())
        return replace(self, solution=replace(self.solution, state=state), views=views)


@dataclass(frozen=True, slots=True, eq=False)
class _Evaluation:
    """A solution with the tests of its residuals."""

    problem: Problem
    state: State
    views: Views
    now: Linearisation
    inverse: np.ndarray
    found: Residuals
    placed: ControlTests

    @property
    def refuted(self) -> np.ndarray:
        """Numbers of control to set aside: the worst blunder of every frame."""
        return self.placed.worst(self.problem.control) if self.problem.control else np.arange(0)

    @property
    def fitting(self) -> np.ndarray:
        """Numbers of control that was set aside and fits now."""
        return self.placed.fitting(self.problem.control) if self.problem.control else np.arange(0)

    @classmethod
    def of(
        cls,
        problem: Problem,
        solution: Solution,
        params: AdjustmentParams,
        threshold: float | None,
    ) -> _Evaluation:
        state = solution.state
        at = solution.at or LinearisationPoint.of(problem, state)
        now = solution.now or linearise(problem, at, threshold)
        inverse = now.factor.inverse()
        found = residuals(problem, now.ties, inverse)
        placed = control_tests(problem, state, inverse, params, threshold)
        return cls(problem, state, at.views, now, inverse, found, placed)


def estimate(start: Start, params: AdjustmentParams) -> Outcome:
    """Estimate all unknowns, and which observations are blunders."""
    problem, used, iterations = start.problem(start.used), start.used, 0
    at: State | LinearisationPoint = LinearisationPoint.of(problem, start.state, start.views)
    for step in STEPS:
        for further in reversed(range(params.max_rounds)):
            aside = bool((~used & start.observations.is_stereo).any())
            to_the_end = aside or start.control is not None
            solution = solve(problem, at, params, robust=step.robust, to_the_end=to_the_end)
            at, iterations = solution.at or solution.state, iterations + solution.iterations
            if step.robust and not (aside or _stand_out(problem, solution, params)):
                break
            threshold = HUBER if step.robust else None
            evaluation = _Evaluation.of(problem, solution, params, threshold)
            wrong, refuted = suspects(problem, evaluation.found, used, params), evaluation.refuted
            if not ((len(wrong) or len(refuted)) and further):
                start = start.with_control(evaluation.fitting if step.robust else refuted[:0])
                used, problem, state = _with_fitting(start, evaluation, used, params, step)
                at = at if problem is evaluation.problem else state
                break
            start = start.with_control(refuted, used=False)
            used = _with_rows(used, wrong, to=False)
            problem, at = start.problem(used), solution.state
    return Outcome(
        start.observations,
        evaluation.problem,
        replace(solution, iterations=iterations, at=None, now=None),
        evaluation.views,
        used,
        evaluation.found,
        evaluation.now.ties,
        evaluation.inverse,
        evaluation.placed,
    )


def _stand_out(problem: Problem, solution: Solution, params: AdjustmentParams) -> bool:
    """Whether an observation is far enough off to mask others."""
    if problem.control and control_stands_out(problem.control, solution.state, params):
        return True
    return solution.stands_out(problem, params)


def _with_fitting(
    start: Start, evaluation: _Evaluation, used: np.ndarray, params: AdjustmentParams, step: Step
) -> tuple[np.ndarray, Problem, State]:
    """The state after using again set-aside observations that now fit, in the robust search.

    Their points took part in no adjustment while stops moved, and are placed again.
    """
    before = start.problem(used) if len(evaluation.fitting) and step.robust else evaluation.problem
    if not step.robust or used.all():
        return used, before, evaluation.state
    seen = Sightings.of(start.observations, params)
    points = all_points(evaluation.problem, evaluation.views, used, seen)
    state = replace(evaluation.state, points=points)
    back = reinstate(
        evaluation.problem,
        state,
        evaluation.now.ties,
        evaluation.found,
        used,
        evaluation.inverse,
        params,
    )
    if not len(back):
        return used, before, evaluation.state
    used = _with_rows(used, back, to=True)
    return used, start.problem(used), state


def _with_rows(used: np.ndarray, rows: np.ndarray, *, to: bool) -> np.ndarray:
    used = used.copy()
    used[rows] = to
    return used


def all_points(
    problem: Problem, views: Views, used: np.ndarray, seen: Sightings
) -> Float64[np.ndarray, "points 3"]:
    """All points; those in no adjustment at the positions of their sightings."""
    observations = problem.observations
    inside = np.zeros(observations.points, dtype=bool)
    inside[problem.points] = True
    points = weighted_mean_points(views, observations, seen, used & ~inside[observations.point])
    points[problem.points] = views.points.T[problem.points]
    return points
