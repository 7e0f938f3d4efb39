"""Gauss-Newton with step halving over the whole network.

Minimised is the sum of the squared weighted residuals of image coordinates and telemetry,

    cost = sum_obs rho(|w l|) + sum |w l|^2 (tilt, azimuth, increments) + sum |m_j / sigma|^2

where rho(t) = t^2, or in the robust phase Huber's: t^2 up to k, 2 k t - k^2 beyond, solved by
iterative reweighting. Steps are not damped: Marquardt's damping holds back the long bending modes
of an open traverse, which are soft but well determined; a step that raises the cost is halved
instead. The step is converged when x' N x, its squared length in its own standard deviations, is
negligible, or when the next is foretold to be negligible, as much shorter than the last as that was
than the one before. The robust phase is over as soon as nothing stands out that
others could hide behind. What residuals and covariances need is kept from the last linearisation if
the step from there was short; residuals are those where it led.

Corrections are applied along arcs, and to the inverse depth of points: see `moves`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.collinearity import State
from solmap.photogrammetry.adjustment.moves import Correction, moved
from solmap.photogrammetry.adjustment.normals import (
    Linearised,
    Place,
    cost_of,
    huber_threshold,
    lengths,
    linearise,
    linearise_at,
    normal_equations,
)
from solmap.photogrammetry.adjustment.params import AdjustmentParams
from solmap.photogrammetry.adjustment.problem import Problem

SAME = 10.0
"""A step of so many times the tolerance leaves the normal equations as they are: with a squared
length of 1e-5, covariances differ by less than 1e-5 of themselves, in networks of 5 stops by 3e-7
and of 500 loosely tied ones by 6e-6."""
SAME_SHARE = 1e-5
"""So does one whose squared length is this share of that of the step before. Steps shrink by what
bends along them: by at least a times their length, if over it normal equations change by a. So the
last one, as much shorter again, changes these by no more than the share; covariances of 60 stops
taken one by one by 1.3e-6."""
FORETOLD = 1e-2
"""What a foretold step must be below, in tolerances: foretelling is no measurement."""
SHRINKING = 1e-4
"""By what the last steps shrink in the square whatever those before did."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where the iteration ended."""

    state: State
    cost: float
    converged: bool
    iterations: int
    message: str = ""
    at: Place | None = None
    """The state, looked from."""
    now: Linearised | None = None
    """The normal equations there; None where weights are robust or the last step changed them."""

    def stands_out(self, problem: Problem, params: AdjustmentParams) -> bool:
        """Whether any observation is so far off that others could hide behind it."""
        at = self.at or Place.of(problem, self.state)
        return _stands_out(at, params)


def solve(
    problem: Problem,
    start: State | Place,
    params: AdjustmentParams,
    *,
    robust: bool,
    to_the_end: bool = True,
) -> Solution:
    """Iterate to the minimum, or where robust not `to_the_end` until nothing stands out."""
    tolerance = params.robust_tolerance if robust else params.tolerance
    at = start if isinstance(start, Place) else Place.of(problem, start)
    threshold = huber_threshold(problem, at, params) if robust else None
    cost = cost_of(problem, at, threshold)
    if not np.isfinite(cost):
        return Solution(at.state, cost, converged=False, iterations=0,
                        message="a tie point starts behind a camera")  # fmt: skip
    before = 0.0
    for iteration in range(1, params.max_iterations + 1):
        if iteration > 1 and threshold is not None:
            closer = min(threshold, huber_threshold(problem, at, params))
            threshold, cost = closer, cost_of(problem, at, closer)
        now = linearise_at(problem, at, threshold)
        x = now.factor.solve(now.right[:-1], problem.unknowns.offsets)
        length2 = float(x @ now.right[:-1])
        correction = Correction.of(problem, at, now.ties, x)
        at, cost, shortened = _step(problem, at, cost, correction, params, threshold)
        foretold = not shortened and _is_foretold(length2, before, tolerance, robust=robust)
        if length2 < tolerance or foretold:
            same = length2 < max(SAME * tolerance, SAME_SHARE * before)
            kept = now.seen_from(at) if same and not robust else None
            return Solution(at.state, cost, converged=True, iterations=iteration, at=at, now=kept)
        if robust and not (to_the_end or shortened or _stands_out(at, params)):
            return Solution(at.state, cost, converged=True, iterations=iteration, at=at)
        before = 0.0 if shortened else length2
        if shortened > params.max_halvings:
            flat = length2 < max(tolerance, 1e-9 * cost)  # rounding of the cost hides the rest
            return Solution(at.state, cost, converged=flat, iterations=iteration,
                            message="" if flat else "no step lowers the cost")  # fmt: skip
    return Solution(at.state, cost, converged=False, iterations=params.max_iterations,
                    message="iterations used up")  # fmt: skip


def _is_foretold(length2: float, before: float, tolerance: float, *, robust: bool) -> bool:
    """Whether the step after one of squared length `length2` must be negligible."""
    if robust:
        return length2 * length2 < tolerance * before
    return length2 * max(length2, SHRINKING * before) < FORETOLD * tolerance * before


def _stands_out(at: Place, params: AdjustmentParams) -> bool:
    return bool((lengths(at.l) > params.critical_value).any())


def _step(
    problem: Problem,
    at: Place,
    cost: float,
    whole: Correction,
    params: AdjustmentParams,
    threshold: float | None,
) -> tuple[Place, float, int]:
    """The place after the longest of the halved steps that does not raise the cost."""
    slack = 1e-12 * (1.0 + abs(cost))
    for halvings in range(params.max_halvings + 1):
        part = whole.shortened(0.5**halvings) if halvings else whole
        trial = Place.of(problem, moved(problem, at, part))
        trial_cost = cost_of(problem, trial, threshold)
        if trial_cost <= cost + slack:
            return trial, trial_cost, halvings
    return at, cost, params.max_halvings + 1


__all__ = ["Linearised", "Problem", "Solution", "linearise", "normal_equations", "solve"]
