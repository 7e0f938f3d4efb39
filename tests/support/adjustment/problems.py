"""Adjustment problems in the form that every solver can be given: rigid rigs, images, no priors.

GTSAM can be given the whole problem (`aligned`, see `gtsam_full`). In bare ones masts point as
their labels state and telemetry has no weight, because the bundle adjustment of COLMAP has neither.
Its residuals are those of left and right images, each coordinate with the same weight; with
x = (x_l + x_r) / 2, seen from the middle of the bar, and p = x_l - x_r,

    (x_l - x_l°)^2 + (x_r - x_r°)^2 + 2 (y - y°)^2 = 2 (x - x°)^2 + 2 (y - y°)^2 + (p - p°)^2 / 2

so the sums of squares are the same number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.adjustment.initial.values import initialise
from solmap.photogrammetry.adjustment.model.collinearity import (
    Observations,
    State,
    misclosures,
)
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import (
    move_along_arcs,
    rotation_of_vector,
)
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.adjustment.modes.overall import _known_state
from solmap.photogrammetry.adjustment.solver.gauss_newton import solve
from solmap.photogrammetry.adjustment.solver.normal_equations import LinearisationPoint, linearise
from solmap.photogrammetry.adjustment.solver.problem import Problem

PARAMS = AdjustmentParams(tolerance=1e-6)
"""Converged when all unknowns together move by less than a thousandth of a standard deviation."""
FIXED = np.inf
"""Weight of a mast pointing that is known."""


@dataclass(frozen=True, slots=True)
class Peer:
    """What a peer found."""

    cost: float
    """Sum of squares."""
    seconds: float
    """Of processor time."""
    report: str


@dataclass(frozen=True, slots=True, eq=False)
class RigProblem:
    """Stops that carry rigid stereo pairs, the first one held, and where they start."""

    observations: Observations
    telemetry: Telemetry
    start: State

    @property
    def held(self):
        return np.arange(len(self.start.centres)) == 0

    def laid_out(self):
        """The problem for our solver, ties of single pairs left out."""
        every = np.arange(len(self.observations))
        used = np.isfinite(misclosures(self.start, self.observations, every)).all(axis=1)
        return Problem.of(self.observations, self.telemetry, self.held, used)

    def from_state(self, state):
        return replace(self, start=state)


def shared_rows(observations):
    """Observations of points that more than one pair saw: of others no pose depends."""
    counts = np.bincount(observations.point, minlength=observations.points)
    return np.flatnonzero(counts[observations.point] > 1)


def simulated(network):
    """A simulated network as a bare problem of rigs, from the alignment (cold)."""
    whole = aligned(network)
    return bare(whole.observations, whole.telemetry, whole.start)


def aligned(network):
    """A simulated network with mast pointings and telemetry, from the alignment (cold)."""
    observations, telemetry = Observations.of(network), Telemetry.of(network, PARAMS)
    telemetry = replace(telemetry, mast=np.zeros((0, 3, 0)))  # peers model no systematic errors
    held = np.arange(len(network.stops)) == 0
    known, is_known = _known_state(network, telemetry, observations, None)
    start, *_ = initialise(observations, telemetry, held, PARAMS, known, is_known)
    return RigProblem(observations, telemetry, start)


def bare(observations, telemetry, start):
    """Without priors, and with equal weights for left and right image coordinates."""
    along = observations.rover_from_pair[:, :, 0] * observations.base_m[:, None] / 2
    measured = observations.measured.copy()
    measured[:, 0] -= measured[:, 2] / 2
    weight = np.tile(np.sqrt([2.0, 2.0, 0.5]), (len(observations), 1))
    return RigProblem(
        replace(
            observations, measured=measured, weight=weight,
            origin_in_rover=observations.origin_in_rover + along,
        ),
        replace(telemetry, weight=np.zeros_like(telemetry.weight), pointing_weight=FIXED),
        start,
    )  # fmt: skip


def warm(problem, rng):
    """Start near the minimum, as after a sequential adjustment: drives off by 2 cm and 0.01 deg."""
    best = solve(problem.laid_out(), problem.start, PARAMS, robust=False).state
    stops = len(best.centres)
    turn = np.cumsum(rng.normal(0, np.radians(0.01), (stops, 3)), axis=0)
    shift = np.cumsum(rng.normal(0, 0.02, (stops, 3)), axis=0)
    turn[0] = shift[0] = 0.0
    turned = rotation_of_vector(turn)
    centres = move_along_arcs(best.centres, turn, shift, problem.held)
    nearest = np.zeros(len(best.points), dtype=np.int64)
    nearest[problem.observations.point] = problem.observations.stop
    arm = best.points - best.centres[nearest]
    points = centres[nearest] + np.einsum("nij,nj->ni", turned[nearest], arm)
    return problem.from_state(State(turned @ best.rotations, centres, best.pointings, points))


def ours(problem):
    """Our solution: layout and iteration."""
    return solve(problem.laid_out(), problem.start, PARAMS, robust=False)


def covariances(problem, state):
    """Covariances (stops, 6, 6) of rotation vector and position, in the LSL; zero where held."""
    laid_out = problem.laid_out()
    inverse = linearise(laid_out, LinearisationPoint.of(laid_out, state), None).factor.inverse()
    stops = np.arange(len(state.centres))
    blocks = np.repeat(stops[:, None], 6, axis=1)
    return inverse[laid_out.pattern.indices(blocks, laid_out.unknowns.stop_columns)]
