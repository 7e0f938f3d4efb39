"""How a state moves by a linear correction: along arcs.

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

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from photogrammetry.adjustment.collinearity import State, pair_orientations
from photogrammetry.adjustment.elimination import EliminatedTies, place_points
from photogrammetry.adjustment.problem import Problem
from photogrammetry.adjustment.rotations import along_arcs, rotation_of_vector


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Linear corrections of all unknowns."""

    turn_shift: np.ndarray
    """(stops, 6) rotation and shift in the LSL."""
    pointing: np.ndarray
    points: np.ndarray

    @classmethod
    def of(
        cls, problem: Problem, state: State, ties: Iterable[EliminatedTies], x: np.ndarray
    ) -> Correction:
        """All corrections, those of points too, from those of the orientations `x`."""
        turn_shift, pointing = problem.unknowns.unpack(x)
        points = np.zeros_like(state.points)
        for tie in ties:
            base = tie.group.stops[tie.group.signature, 0]
            numbers = problem.observations.point[tie.group.rows[0]]
            pairs = problem.observations.pair[tie.group.rows]
            turn, shift = np.split(turn_shift[base], 2, axis=1)
            carried = shift + np.cross(turn, state.points[numbers] - state.centres[base])
            points[numbers] = carried + place_points(tie, turn_shift, pointing, pairs)
        return cls(turn_shift, pointing, points)

    def shortened(self, part: float) -> Correction:
        """A part of it."""
        return Correction(part * self.turn_shift, part * self.pointing, part * self.points)

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
    points[placed] = centres[stop] + np.einsum("nij,nj->ni", turned[stop], arm)
    return State(turned @ state.rotations, centres, state.pointings + correction.pointing, points)


def _moved_points(
    problem: Problem, state: State, placed: np.ndarray, d_points: np.ndarray
) -> np.ndarray:
    """Points after linear corrections, taken in inverse depth from their nearest pair."""
    rotations, origins = pair_orientations(state, problem.observations)
    pair = problem.anchor[placed]
    R = rotations[pair]
    y = np.einsum("ni,nij->nj", state.points[placed] - origins[pair], R)
    dy = np.einsum("ni,nij->nj", d_points, R)
    c = y[:, 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = c / (1.0 - dy[:, 2:] / c)
        ahead = np.isfinite(depth) & (depth > 0)
        direction = (y + dy - y / c * dy[:, 2:]) / c
    # A step past infinity has no inverse depth: such a point goes to a thousand times its distance.
    new = np.where(ahead, direction * depth, direction * c * 1e3)
    return origins[pair] + np.einsum("nij,nj->ni", R, new)
