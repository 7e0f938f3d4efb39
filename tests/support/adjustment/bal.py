"""Problems of "Bundle Adjustment in the Large" (Agarwal et al. 2010), ours and Ceres' statement.

A camera has nine unknowns: rotation vector and translation of camera_from_world, focal length f and
two radial terms. It looks along -z, and with P = R X + t, p = -(P_x, P_y) / P_z an image point is

    f (1 + k1 |p|^2 + k2 |p|^4) p

All nine are adjusted, in both solvers. Our cameras are exactly linearised pairs on rovers, so the
collinearity and its derivatives stand here; layout, elimination of the points, normal equations,
block Cholesky, back substitution are those of the adjustment, f, k1 and k2 in the three columns
that a mast pointing has there. Such problems have no datum and start far off, so steps are damped
(Marquardt).

Ceres is called through COLMAP (`ceres_peer`), whose camera RADIAL is the same polynomial, y and z
turned round.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import (
    Observations,
    Partials,
    State,
    Views,
)
from solmap.photogrammetry.adjustment.model.small_matrices import (
    by_component,
    rotation_of_vector,
    transform,
)
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.adjustment.solver.block_matrix import factorise
from solmap.photogrammetry.adjustment.solver.elimination import eliminate
from solmap.photogrammetry.adjustment.solver.gauss_newton import Correction
from solmap.photogrammetry.adjustment.solver.normal_equations import LinearisationPoint, sum_normals
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.errors import AdjustmentError
from tests.support.adjustment.problems import Peer

EASED, STIFFENED = 0.2, 5.0
"""Factors of the damping after a step that lowers the cost, and after one that does not."""


@dataclass(frozen=True, slots=True, eq=False)
class BalProblem:
    """What a file holds; pointings of the start are (f, k1, k2)."""

    observations: Observations
    start: State


def read_bal(path):
    """A problem in BAL's format: counts, observations, nine numbers a camera, three a point."""
    numbers = np.array(path.read_text().split(), dtype=np.float64)
    cameras, points, count = numbers[:3].astype(int).tolist()
    seen, rest = numbers[3 : 3 + 4 * count].reshape(-1, 4), numbers[3 + 4 * count :]
    if len(rest) != 9 * cameras + 3 * points:
        raise ValueError(
            f"{path.name} announces {cameras} cameras and {points} points, {9 * cameras} and "
            f"{3 * points} numbers, and holds {len(rest)} after its observations"
        )
    of_camera, X = rest[: 9 * cameras].reshape(-1, 9), rest[9 * cameras :].reshape(-1, 3)
    R = rotation_of_vector(of_camera[:, :3])
    centres = -np.einsum("nji,nj->ni", R, of_camera[:, 3:6])
    observations = Observations(
        point=seen[:, 1].astype(np.int32),
        pair=seen[:, 0].astype(np.int32),
        measured=np.column_stack([seen[:, 2:], np.zeros(count)]),
        weight=np.tile([1.0, 1.0, 0.0], (count, 1)),
        pair_stop=np.arange(cameras, dtype=np.int32),
        rover_from_pair=np.tile(np.eye(3), (cameras, 1, 1)),
        origin_in_rover=np.zeros((cameras, 3)),
        pivot_in_rover=np.zeros((cameras, 3)),
        focal_px=of_camera[:, 6].copy(),
        base_m=np.zeros(cameras),
        centre_px=np.zeros((cameras, 2)),
        points=points,
    )
    start = State(R.swapaxes(1, 2), centres, of_camera[:, 6:].copy(), X.copy())
    return BalProblem(observations, start)


def laid_out(problem):
    """Nothing held, no telemetry."""
    n = len(problem.start.centres)
    telemetry = Telemetry(
        problem.start.rotations, problem.start.centres, np.zeros(n, dtype=bool), np.zeros((n, 6)),
        pointing_weight=1.0,
    )  # fmt: skip
    used = np.ones(len(problem.observations), dtype=bool)
    return Problem.of(problem.observations, telemetry, np.zeros(n, dtype=bool), used)


def ours(problem, most_iterations=200, tolerance=1e-9):
    """Cost, seconds and iterations of our kernel under Marquardt's damping."""
    begin = time.process_time()
    layout = laid_out(problem)
    at, damping = placed(layout, problem.start), 1e-4
    cost = float(np.vdot(at.l, at.l))
    iteration, decrease = 0, np.inf
    while iteration < most_iterations and decrease > tolerance * cost:
        iteration += 1
        flat, right, ties = sum_normals(layout, eliminated(layout, at))
        trial, damping = damped_step(layout, at, cost, (flat, right, ties), damping)
        lower = float(np.vdot(trial.l, trial.l))
        at, decrease, cost = trial, cost - lower, lower
    return Peer(cost, time.process_time() - begin, f"{iteration} iterations")


def damped_step(layout, at, cost, equations, damping):
    """The place after the first step that lowers the cost, and the damping for the next one."""
    flat, right, ties = equations
    stops = np.arange(len(layout.unknowns.sizes))
    sizes = layout.unknowns.sizes
    diagonal = layout.pattern.start(stops, stops)[:, None] + np.arange(9) * (sizes[:, None] + 1)
    while damping < 1e12:
        stiff = flat.copy()
        stiff[diagonal] *= 1.0 + damping
        try:
            x = factorise(layout.pattern, stiff).solve(right[:-1], layout.unknowns.offsets)
        except AdjustmentError:
            damping *= STIFFENED
            continue
        trial = placed(layout, moved(layout, at.state, Correction.of(layout, at, ties, x)))
        if np.vdot(trial.l, trial.l) <= cost:
            return trial, damping * EASED
        damping *= STIFFENED
    return at, damping


def moved(layout, state, correction):
    points = state.points.copy()
    points[layout.points] += correction.points.T
    return State(
        rotation_of_vector(correction.turn) @ state.rotations,
        state.centres + correction.shift,
        state.pointings + correction.pointing,
        points,
    )


def placed(layout, state):
    """A state with the misclosures there."""
    views = views_of(state, layout.observations)
    y, _, inner = in_cameras(views, state, layout.sights)
    p = -y[:2] / y[2]
    r2 = p[0] ** 2 + p[1] ** 2
    f, k1, k2 = inner
    l = layout.sights.measured.copy()
    l[:2] -= f * (1 + k1 * r2 + k2 * r2**2) * p
    return LinearisationPoint(state, views, l)


def views_of(state, observations):
    """Places of cameras and points; what else views of rovers have is not looked at."""
    table = np.zeros((16, len(state.centres)))
    table[:9] = by_component(state.rotations.swapaxes(1, 2)).reshape(9, -1)
    stops = np.arange(len(state.centres), dtype=np.int32)
    return Views(
        table, stops, state.centres.T, state.points.T.copy(), observations.bodies, state.pointings
    )


def in_cameras(views, state, sights):
    """Points in the frames of their cameras, points, and (f, k1, k2), by observation."""
    X = np.take(views.points, sights.point, axis=1)
    F = np.take(views.pairs[:9], sights.pair, axis=1).reshape(3, 3, -1)
    inner = np.take(state.pointings.T, sights.pair, axis=1)
    return transform(F, views.arm(X, sights.pair)), X, inner


def partials(at, sights):
    """Derivatives of image points by point, pose and (f, k1, k2)."""
    y, X, (f, k1, k2) = in_cameras(at.views, at.state, sights)
    F = np.take(at.views.pairs[:9], sights.pair, axis=1).reshape(3, 3, -1)
    p = -y[:2] / y[2]
    r2 = p[0] ** 2 + p[1] ** 2
    radial = 1 + k1 * r2 + k2 * r2**2
    by_p = f * ((2 * k1 + 4 * k2 * r2) * p[:, None] * p[None])
    by_p[0, 0] += f * radial
    by_p[1, 1] += f * radial
    p_by_y = -np.stack([F[0] + p[0] * F[2], F[1] + p[1] * F[2]]) / y[2]  # dp = -(dy + p dy_z)/y_z
    by_point, by_inner = np.zeros_like(F), np.zeros_like(F)
    by_point[:2] = np.einsum("ijm,jcm->icm", by_p, p_by_y)
    by_inner[:2] = np.stack([radial * p, f * r2 * p, f * r2**2 * p], axis=1)
    return Partials(by_point, by_inner, X)


def eliminated(layout, at):
    end = 0
    for group in layout.groups:
        part = slice(end, end := end + group.rows.size)
        A = partials(at, layout.sights.part(part))
        yield eliminate(group, at.l[:, part], A, at.views)
