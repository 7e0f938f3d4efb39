"""Gauss-Newton with step halving over the whole network.

Minimised is the sum of the squared weighted residuals of image coordinates and telemetry,

    cost = sum_obs rho(|w l|) + sum |w l|^2 (tilt, azimuth, increments) + sum |m_j / sigma|^2

where rho(t) = t^2, or in the robust phase Huber's: t^2 up to k, 2 k t - k^2 beyond, solved by
iterative reweighting. Steps are not damped: Marquardt's damping holds back the long bending modes
of an open traverse, which are soft but well determined; a step that raises the cost is halved
instead. The iteration has converged when x' N x, the squared length of the step in its own standard
deviations, is negligible, or when the next step is predicted to be negligible, assuming that it
shrinks as much as the last one did. The robust phase ends as soon as no residual is large enough to
mask others. If the last step was short, residuals and covariances use the linearisation before it,
with the residuals after it.

A correction rotates whole stretches of an open traverse by degrees; a point 20 m from a stop that
rotates by t moves on an arc that departs from its tangent by 20 t^2 / 2: many pixels. Corrections
are therefore applied along arcs, equal to first order: with D = c_k - c_(k-1), its linear change dD
and the mean turn m of both stops,

    D <- Exp(m) (D + dD - m x D)           X - c <- Exp(d) (X - c + dX - dc - d x (X - c))

Points move by their inverse depth as seen from the pair that is nearest to them: with the linear
step (da, db, dc) in the frame of that pair and y = (a, b, c),

    1/c <- 1/c - dc/c^2,    a/c <- a/c + (da - a/c dc)/c,   likewise b

which is the same to first order, and far points (parallax of a few pixels) stay in front of the
cameras and nearly linear.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import MAST_UNKNOWNS, State, Views
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import (
    by_component,
    cross,
    move_along_arcs,
    rotation_of_vector,
    transform,
)
from solmap.photogrammetry.adjustment.solver.elimination import EliminatedTies, place_points
from solmap.photogrammetry.adjustment.solver.normal_equations import (
    Linearisation,
    LinearisationPoint,
    cost_of,
    huber_threshold,
    lengths,
    linearise,
)
from solmap.photogrammetry.adjustment.solver.problem import Problem

ROBUST_TOLERANCE = 1.0
"""Replaces `tolerance` while blunders are searched: all unknowns together move by less than one
standard deviation."""
MAX_HALVINGS = 8
"""Shortest step tried, as a power of 1/2."""
SAME = 10.0
"""Steps of up to this many tolerances leave the normal equations unchanged: with a squared length
of 1e-5, covariances differ by less than 1e-5 of themselves, in networks of 5 stops by 3e-7 and of
500 loosely tied ones by 6e-6."""
SAME_SHARE = 1e-5
"""Steps whose squared length is this fraction of the step before also leave them unchanged. If
normal equations change by a over one step, steps shrink by at least the factor a; the last one then
changes them by no more than this fraction; covariances of 60 stops added one by one, by 1.3e-6."""
PREDICTED = 1e-2
"""Bound of a predicted step, in tolerances: lower, because a prediction is less certain."""
SHRINKING = 1e-4
"""Factor by which the squared length of the last steps shrinks at least, whatever those before
did."""


CACHED = 4096
"""Points that are moved together, so that they fit a processor core's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where the iteration ended."""

    state: State
    cost: float
    converged: bool
    iterations: int
    message: str = ""
    at: LinearisationPoint | None = None
    """Views from the state."""
    now: Linearisation | None = None
    """The normal equations there; None where weights are robust or the last step changed them."""

    def stands_out(self, problem: Problem, params: AdjustmentParams) -> bool:
        """Whether an observation is far enough off to mask others."""
        at = self.at or LinearisationPoint.of(problem, self.state)
        return _stands_out(at, params)


def solve(
    problem: Problem,
    start: State | LinearisationPoint,
    params: AdjustmentParams,
    *,
    robust: bool,
    to_the_end: bool = True,
) -> Solution:
    """Iterate to the minimum, or, if robust and not `to_the_end`, until no residual stands out."""
    tolerance = ROBUST_TOLERANCE if robust else params.tolerance
    at = start if isinstance(start, LinearisationPoint) else LinearisationPoint.of(problem, start)
    threshold = huber_threshold(problem, at) if robust else None
    cost = cost_of(problem, at, threshold)
    if not np.isfinite(cost):
        return Solution(at.state, cost, converged=False, iterations=0,
                        message="a tie point starts behind a camera")  # fmt: skip
    before = 0.0
    for iteration in range(1, params.max_iterations + 1):
        if iteration > 1 and threshold is not None:
            closer = min(threshold, huber_threshold(problem, at))
            threshold, cost = closer, cost_of(problem, at, closer)
        now = linearise(problem, at, threshold)
        x = now.factor.solve(now.right[:-1], problem.unknowns.offsets)
        length2 = float(x @ now.right[:-1])
        correction = Correction.of(problem, at, now.ties, x)
        at, cost, shortened = _step(problem, at, cost, correction, threshold)
        is_converging = not shortened and _is_converging(length2, before, tolerance, robust=robust)
        if length2 < tolerance or is_converging:
            same = length2 < max(SAME * tolerance, SAME_SHARE * before)
            kept = now.with_misclosures_at(at) if same and not robust else None
            return Solution(at.state, cost, converged=True, iterations=iteration, at=at, now=kept)
        if robust and not (to_the_end or shortened or _stands_out(at, params)):
            return Solution(at.state, cost, converged=True, iterations=iteration, at=at)
        before = 0.0 if shortened else length2
        if shortened > MAX_HALVINGS:
            # rounding of the cost masks smaller changes
            flat = length2 < max(tolerance, 1e-9 * cost)
            return Solution(at.state, cost, converged=flat, iterations=iteration,
                            message="" if flat else "no step lowers the cost")  # fmt: skip
    return Solution(at.state, cost, converged=False, iterations=params.max_iterations,
                    message="iterations used up")  # fmt: skip


def _is_converging(length2: float, before: float, tolerance: float, *, robust: bool) -> bool:
    """Whether the step after one of squared length `length2` is predicted to be negligible."""
    if robust:
        return length2 * length2 < tolerance * before
    return length2 * max(length2, SHRINKING * before) < PREDICTED * tolerance * before


def _stands_out(at: LinearisationPoint, params: AdjustmentParams) -> bool:
    return bool((lengths(at.l) > params.critical_value).any())


def _step(
    problem: Problem,
    at: LinearisationPoint,
    cost: float,
    whole: Correction,
    threshold: float | None,
) -> tuple[LinearisationPoint, float, int]:
    """The linearisation point after the longest halved step that does not raise the cost."""
    slack = 1e-12 * (1.0 + abs(cost))
    for halvings in range(MAX_HALVINGS + 1):
        part = whole.scale(0.5**halvings) if halvings else whole
        trial = LinearisationPoint.of(problem, move(problem, at, part))
        trial_cost = cost_of(problem, trial, threshold)
        if trial_cost <= cost + slack:
            return trial, trial_cost, halvings
    return at, cost, MAX_HALVINGS + 1


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Linear corrections of all unknowns."""

    turn_shift: np.ndarray
    """(stops, 6) rotation and shift in the LSL."""
    pointing: np.ndarray
    points: np.ndarray
    """(3, points in the adjustment), group by group."""
    frames: np.ndarray
    """(frames, 5)."""
    mast: np.ndarray
    """(4,)"""

    @classmethod
    def of(
        cls, problem: Problem, at: LinearisationPoint, ties: Iterable[EliminatedTies], x: np.ndarray
    ) -> Correction:
        """All corrections, those of points too, from those of the orientations `x`."""
        turn_shift, pointing, frames = problem.unknowns.unpack(x)
        padded, points = np.append(x, 0.0), np.empty((3, len(problem.points)))
        end = 0
        for tie, columns in zip(ties, problem.right_places, strict=True):
            points[:, end : (end := end + tie.group.points)] = place_points(tie, padded[columns])
        arm = at.views.arm(np.take(at.views.points, problem.points, axis=1), problem.bases)
        of_base = np.take(turn_shift.T, problem.bases, axis=1)
        points += of_base[3:]
        points += cross(of_base[:3], arm)
        k = problem.unknowns.mast
        mast = x[len(x) - k :] if k else np.zeros(MAST_UNKNOWNS)
        return cls(turn_shift, pointing, points, frames, mast)

    def scale(self, part: float) -> Correction:
        """The corrections times a factor."""
        return Correction(
            part * self.turn_shift,
            part * self.pointing,
            part * self.points,
            part * self.frames,
            part * self.mast,
        )

    @property
    def turn(self) -> np.ndarray:
        """(stops, 3) rotation vectors."""
        return self.turn_shift[:, :3]

    @property
    def shift(self) -> np.ndarray:
        """(stops, 3) metres."""
        return self.turn_shift[:, 3:]


def move(problem: Problem, at: LinearisationPoint, correction: Correction) -> State:
    """The state after a correction, along arcs."""
    turns = rotation_of_vector(correction.turn)
    state = at.state
    centres = move_along_arcs(state.centres, correction.turn, correction.shift, problem.held)
    points = at.views.points.copy()
    of_stops = [correction.turn_shift.T, centres.T, by_component(turns).reshape(9, -1)]
    motion = _Motion(at.views, np.concatenate(of_stops))
    for begin in range(0, len(problem.points), CACHED):
        part = slice(begin, begin + CACHED)
        placed = problem.points[part]
        points[:, placed] = motion.of_points(
            np.take(points, placed, axis=1), correction.points[:, part], problem.anchors[part]
        )
    return State(
        turns @ state.rotations,
        centres,
        state.pointings + correction.pointing,
        points.T.copy(),
        state.frames + correction.frames,
        state.mast + correction.mast,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """Motions of stops and pairs."""

    views: Views
    of_stops: np.ndarray
    """(18, stops) rotation vectors (3), shifts (3), centres after the correction (3), rotations."""

    def of_points(self, X: np.ndarray, dX: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """Points (3, n) after corrections dX, each moved with the stop of its pair."""
        stop = self.views.stop[pair]
        arm = self.views.arm(X, stop)
        of_stop = np.take(self.of_stops, stop, axis=1)
        turn, shift, centre = of_stop[:9].reshape(3, 3, -1)
        rest = dX - shift - cross(turn, arm)
        arm = self.views.arm(_in_inverse_depth(self.views, X, rest, pair), stop)
        return centre + transform(of_stop[9:].reshape(3, 3, -1), arm)


def _in_inverse_depth(views: Views, X: np.ndarray, dX: np.ndarray, pair: np.ndarray) -> np.ndarray:
    """Points (3, n) after linear corrections, taken in inverse depth from their nearest pair."""
    of_pair = np.take(views.pairs[:12], pair, axis=1)
    F, origin = of_pair[:9].reshape(3, 3, -1), of_pair[9:]
    y, dy = transform(F, X - origin), transform(F, dX)
    c = y[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = c / (1.0 - dy[2] / c)
        ahead = np.isfinite(depth) & (depth > 0)
        direction = (y + dy - y / c * dy[2]) / c
    # A step past infinity has no inverse depth: such a point is set to a thousand times its
    # distance.
    new = direction * np.where(ahead, depth, c * 1e3)
    return origin + transform(F.swapaxes(0, 1), new)
