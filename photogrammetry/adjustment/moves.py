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

from solmap.photogrammetry.adjustment.collinearity import State, Views
from solmap.photogrammetry.adjustment.componentwise import by_component, cross, turned
from solmap.photogrammetry.adjustment.elimination import EliminatedTies, place_points
from solmap.photogrammetry.adjustment.normals import Place
from solmap.photogrammetry.adjustment.problem import Problem
from solmap.photogrammetry.adjustment.rotations import along_arcs, rotation_of_vector

CACHED = 4096
"""Points that are moved together, so that they stay in a processor's own cache."""


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

    @classmethod
    def of(
        cls, problem: Problem, at: Place, ties: Iterable[EliminatedTies], x: np.ndarray
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
        return cls(turn_shift, pointing, points, frames)

    def shortened(self, part: float) -> Correction:
        """A part of it."""
        return Correction(
            part * self.turn_shift, part * self.pointing, part * self.points, part * self.frames
        )

    @property
    def turn(self) -> np.ndarray:
        """(stops, 3) rotation vectors."""
        return self.turn_shift[:, :3]

    @property
    def shift(self) -> np.ndarray:
        """(stops, 3) metres."""
        return self.turn_shift[:, 3:]


def moved(problem: Problem, at: Place, correction: Correction) -> State:
    """The state after a correction, along arcs."""
    turns = rotation_of_vector(correction.turn)
    state = at.state
    centres = along_arcs(state.centres, correction.turn, correction.shift, problem.held)
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
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """How stops and pairs move."""

    views: Views
    of_stops: np.ndarray
    """(18, stops) rotation vectors (3), shifts (3), centres after the correction (3), rotations."""

    def of_points(self, X: np.ndarray, dX: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """Points (3, n) after corrections dX, each moved along with the stop of its pair."""
        stop = self.views.stop[pair]
        arm = self.views.arm(X, stop)
        of_stop = np.take(self.of_stops, stop, axis=1)
        turn, shift, centre = of_stop[:9].reshape(3, 3, -1)
        rest = dX - shift - cross(turn, arm)
        arm = self.views.arm(_in_inverse_depth(self.views, X, rest, pair), stop)
        return centre + turned(of_stop[9:].reshape(3, 3, -1), arm)


def _in_inverse_depth(views: Views, X: np.ndarray, dX: np.ndarray, pair: np.ndarray) -> np.ndarray:
    """Points (3, n) after linear corrections, taken in inverse depth from their nearest pair."""
    of_pair = np.take(views.pairs[:12], pair, axis=1)
    F, origin = of_pair[:9].reshape(3, 3, -1), of_pair[9:]
    y, dy = turned(F, X - origin), turned(F, dX)
    c = y[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = c / (1.0 - dy[2] / c)
        ahead = np.isfinite(depth) & (depth > 0)
        direction = (y + dy - y / c * dy[2]) / c
    # A step past infinity has no inverse depth: such a point goes to a thousand times its distance.
    new = direction * np.where(ahead, depth, c * 1e3)
    return origin + turned(F.swapaxes(0, 1), new)
