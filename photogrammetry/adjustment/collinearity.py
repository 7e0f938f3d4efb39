"""Collinearity of stereo observations, and its partial derivatives.

A stop has rotation R and centre c in the LSL (of the rover frame). Pair j of that stop is a rigid
body: the label gives rover_from_pair = (R_j, t_j), the mast turns it by a small unknown rotation
m_j about the mast head v_j. (The lever is short, 0.1 degrees move a camera by 0.3 mm; but hundreds
of near ties feel that, and with another pivot they would tilt a whole panorama by 0.06 degrees.)
A point X of the LSL is

    g = R' (X - c)                            in the rover frame
    h = g - v_j                               from the mast head
    y = R_j' (Exp(m_j)' h - (t_j - v_j))      in the pair's frame

and is seen at (x, y) in the left image with parallax p,

    x = c_x + f y_1/y_3       y = c_y + f y_2/y_3       p = f B / y_3

so that both cameras hang on one fixed bar by construction. Corrections are d (rotation of the stop,
R <- Exp(d) R, a vector in the LSL), dc, dm and dX. With B_j = R_j' Exp(m_j)', F_j = B_j R' and the
lever q_j = R_j' (t_j - v_j) from the mast head to the pair, in the pair's frame,

    dy = F_j [X - c] d - F_j dc + [y + q_j] B_j J(m_j) dm + F_j dX

Rotation and *centre* are corrected, not rotation and translation of the inverse motion: a turn of a
stop then leaves its place alone, and Gauss-Newton needs few steps on long open traverses.

Arrays are kept component by component, observations along their last axis (see `componentwise`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.adjustment.componentwise import (
    Matrices,
    Vectors,
    by_component,
    crossed_rows,
    product,
    turned,
)
from solmap.photogrammetry.adjustment.observations import (
    PAIR_UNKNOWNS,
    STOP_UNKNOWNS,
    Observations,
    PairBodies,
    Sights,
    State,
)
from solmap.photogrammetry.adjustment.rotations import left_jacobian, rotation_of_vector
from solmap.photogrammetry.arrays import Bool, Float64, Int32


def pair_orientations(
    state: State, observations: Observations
) -> tuple[Float64[np.ndarray, "pairs 3 3"], Float64[np.ndarray, "pairs 3"]]:
    """Rotation lsl_from_pair and origin in the LSL of every pair."""
    of_stop = state.rotations[observations.pair_stop]
    rotations, origins = observations.in_rover(state.pointings)
    moved = (of_stop @ origins[:, :, None])[:, :, 0]
    return of_stop @ rotations, state.centres[observations.pair_stop] + moved


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """What is needed of every pair and point at a state, component by component."""

    pairs: Float64[np.ndarray, "16 pairs"]
    """F (9), origin in the LSL (3), f, B, c_x, c_y."""
    stop: Int32[np.ndarray, " pairs"]
    centres: Float64[np.ndarray, "3 stops"]
    points: Float64[np.ndarray, "3 points"]
    bodies: PairBodies
    pointings: Float64[np.ndarray, "pairs 3"]

    @classmethod
    def of(cls, state: State, observations: Observations) -> Views:
        """At a state."""
        bodies, stop = observations.bodies, observations.pair_stop
        of_stop = np.take(by_component(state.rotations), stop, axis=2)
        by_mast = product(of_stop, by_component(rotation_of_vector(state.pointings)))
        table = np.empty((16, len(stop)))
        table[:9] = product(by_mast, bodies.rover_from_pair).swapaxes(0, 1).reshape(9, -1)
        table[9:12] = turned(of_stop, bodies.pivot)
        table[9:12] += turned(by_mast, bodies.lever)
        table[9:12] += np.take(state.centres.T, stop, axis=1)
        table[12:] = bodies.optics
        points = state.points.T.copy()
        return cls(table, stop, state.centres.T, points, bodies, state.pointings)

    @property
    def orientations(
        self,
    ) -> tuple[Float64[np.ndarray, "pairs 3 3"], Float64[np.ndarray, "pairs 3"]]:
        """Rotation lsl_from_pair and origin in the LSL of every pair."""
        return self.pairs[:9].reshape(3, 3, -1).transpose(2, 1, 0), self.pairs[9:12].T

    def at(self, points: Float64[np.ndarray, "3 points"]) -> Views:
        """The same with the points elsewhere."""
        return replace(self, points=points)

    def are_in_front(self, sights: Sights) -> Bool[np.ndarray, " m"]:
        """Which points are before the camera, so that there are misclosures."""
        axis, origin = np.take(self.pairs[6:12], sights.pair, axis=1).reshape(2, 3, -1)
        arm = np.take(self.points, sights.point, axis=1) - origin
        return np.einsum("im,im->m", axis, arm) > 0

    def misclosures(self, sights: Sights) -> Vectors:
        """Observed minus computed (x, y, p), pixels; NaN behind the camera."""
        of_pair = np.take(self.pairs, sights.pair, axis=1)
        e = np.take(self.points, sights.point, axis=1)
        e -= of_pair[9:12]
        y = turned(of_pair[:9].reshape(3, 3, -1), e)
        scale = of_pair[12] / np.where(y[2] > 0, y[2], np.nan)
        y[2] = of_pair[13]
        y *= scale
        y[:2] += of_pair[14:16]
        return np.subtract(sights.measured, y, out=y)

    def masts(self) -> Float64[np.ndarray, "12 pairs"]:
        """What turning masts takes: q (3) and B J (9)."""
        jacobian = by_component(left_jacobian(-self.pointings))  # J(-m) = Exp(m)' J(m)
        turning = product(self.bodies.to_pair, jacobian).reshape(9, -1)
        return np.concatenate([self.bodies.lever_in_pair, turning])

    def partials(
        self, sights: Sights, masts: Float64[np.ndarray, "12 pairs"] | None = None
    ) -> Partials:
        """Derivatives of (x, y, p), times the weights; `masts` where they are known already."""
        of_pair = np.take(self.pairs[:14], sights.pair, axis=1)
        of_mast = np.take(self.masts() if masts is None else masts, sights.pair, axis=1)
        X = np.take(self.points, sights.point, axis=1)
        F, q, K = of_pair[:9].reshape(3, 3, -1), of_mast[:3], of_mast[3:].reshape(3, 3, -1)
        y = turned(F, X - of_pair[9:12])
        scale = of_pair[12] / y[2] * sights.weight  # of one pixel a metre, across and along
        scale[2] *= of_pair[13] / y[2]
        u, v = y[:2] / y[2]
        by_point = np.empty_like(F)
        by_point[0] = scale[0] * (F[0] - u * F[2])
        by_point[1] = scale[1] * (F[1] - v * F[2])
        by_point[2] = -scale[2] * F[2]
        # with a row a of the derivative by y, that by the pointing is a'[w] K = (a x w)' K
        a, b, c = y + q
        crossed = np.empty_like(F)
        crossed[0, 0], crossed[0, 1], crossed[0, 2] = u * b, -u * a - c, b
        crossed[1, 0], crossed[1, 1], crossed[1, 2] = v * b + c, -v * a, -a
        crossed[2, 0], crossed[2, 1], crossed[2, 2] = b, -a, 0.0
        crossed *= scale[:, None]
        return Partials(by_point, product(crossed, K), X)

    def arm(self, X: Vectors, stop: np.ndarray) -> Vectors:
        """From stops to points, in the LSL."""
        return X - np.take(self.centres, stop, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Partials:
    """Derivatives of (x, y, p), component by component: (coordinate, unknown, observation)."""

    by_point: Matrices
    by_pointing: Matrices
    X: Vectors
    """The points, in the LSL."""

    def of(self, part: slice) -> Partials:
        """Those of some consecutive observations."""
        return Partials(self.by_point[..., part], self.by_pointing[..., part], self.X[:, part])

    def weighted(self, weight: Float64[np.ndarray, " m"]) -> Partials:
        """All of an observation times a weight."""
        return Partials(self.by_point * weight, self.by_pointing * weight, self.X)

    def by_stop(self, arm: Vectors) -> Float64[np.ndarray, "3 6 m"]:
        """By (d, dc) of a stop `arm` away: a' [arm] = (a x arm)', a a row of `by_point`."""
        return np.concatenate([crossed_rows(self.by_point, arm), -self.by_point], axis=1)

    def by_row(
        self, views: Views, stop: np.ndarray
    ) -> tuple[Float64[np.ndarray, "m 3 9"], Float64[np.ndarray, "m 3 3"]]:
        """By (d, dc, dm) and by dX, observation by observation; `stop` is that of each."""
        by_stop = self.by_stop(views.arm(self.X, stop))
        by_orientation = np.concatenate([by_stop, self.by_pointing], axis=1)
        return by_orientation.transpose(2, 0, 1).copy(), self.by_point.transpose(2, 0, 1).copy()


def misclosures(
    state: State, observations: Observations, rows: np.ndarray
) -> Float64[np.ndarray, "m 3"]:
    """Observed minus computed (x, y, p) of some observations, pixels; NaN behind the camera."""
    sights = observations.sights.at(rows)
    return Views.of(state, observations).misclosures(sights).T.copy()


def partials(
    state: State, observations: Observations, rows: np.ndarray
) -> tuple[Float64[np.ndarray, "m 3 9"], Float64[np.ndarray, "m 3 3"]]:
    """Derivatives of (x, y, p) by (d, dc, dm) of the observation's stop and pair, and by dX."""
    sights, views = observations.sights.at(rows), Views.of(state, observations)
    return views.partials(replace(sights, weight=np.ones_like(sights.weight))).by_row(
        views, observations.stop_of(rows)
    )


__all__ = [
    "PAIR_UNKNOWNS",
    "STOP_UNKNOWNS",
    "Observations",
    "Partials",
    "Sights",
    "State",
    "Views",
    "misclosures",
    "pair_orientations",
    "partials",
]
