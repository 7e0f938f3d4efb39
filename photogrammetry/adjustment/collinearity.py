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
R <- Exp(d) R, a vector in the LSL), dc, dm and dX. With B_j = R_j' Exp(m_j)', F_j = B_j R',

    dy = F_j [X - c] d - F_j dc + B_j [h] J(m_j) dm + F_j dX

Rotation and *centre* are corrected, not rotation and translation of the inverse motion: a turn of a
stop then leaves its place alone, and Gauss-Newton needs few steps on long open traverses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from photogrammetry.adjustment.records import Network
from photogrammetry.adjustment.rotations import left_jacobian, rotation_of_vector
from photogrammetry.arrays import Flags, Float64, Int32

STOP_UNKNOWNS = 6
PAIR_UNKNOWNS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """The observations and the fixed geometry of a network, as arrays."""

    point: Int32[np.ndarray, " n"]
    pair: Int32[np.ndarray, " n"]
    """Index into the pairs of the network."""
    measured: Float64[np.ndarray, "n 3"]
    """(x, y, p) in pixels; p is zero where only the left image was measured."""
    weight: Float64[np.ndarray, "n 3"]
    """1/sigma; zero where not measured."""
    pair_stop: Int32[np.ndarray, " pairs"]
    rover_from_pair: Float64[np.ndarray, "pairs 3 3"]
    origin_in_rover: Float64[np.ndarray, "pairs 3"]
    """As the label has it, before the pointing is corrected."""
    pivot_in_rover: Float64[np.ndarray, "pairs 3"]
    focal_px: Float64[np.ndarray, " pairs"]
    base_m: Float64[np.ndarray, " pairs"]
    centre_px: Float64[np.ndarray, "pairs 2"]
    points: int
    """How many point numbers there are."""

    @classmethod
    def of(cls, network: Network) -> Observations:
        """The arrays of a network."""
        stop_number = {stop: k for k, stop in enumerate(network.stop_ids)}
        pair_number = {pair.pair_id: k for k, pair in enumerate(network.pairs)}
        ties, shapes = network.ties, [pair.geometry for pair in network.pairs]
        numbers = np.array([pair_number[name] for name in ties.pair_ids], dtype=np.int32)
        stereo = np.isfinite(ties.parallax_px)
        per_pair = len(shapes)
        return cls(
            point=ties.point,
            pair=numbers[ties.pair] if len(ties) else np.zeros(0, dtype=np.int32),
            measured=np.column_stack([ties.left, np.where(stereo, ties.parallax_px, 0.0)]),
            weight=np.column_stack(
                [
                    1.0 / ties.sigma_px,
                    1.0 / ties.sigma_px,
                    np.where(stereo, 1.0 / np.where(stereo, ties.sigma_parallax_px, 1.0), 0.0),
                ]
            ),
            pair_stop=np.array([stop_number[p.stop] for p in network.pairs], dtype=np.int32),
            rover_from_pair=np.array([g.rover_from_pair.rotation for g in shapes]).reshape(
                -1, 3, 3
            ),
            origin_in_rover=np.array([g.rover_from_pair.translation_m for g in shapes]).reshape(
                -1, 3
            ),
            pivot_in_rover=np.array([pair.pivot_in_rover for pair in network.pairs]).reshape(-1, 3),
            focal_px=np.array([g.focal_px for g in shapes], dtype=np.float64),
            base_m=np.array([g.base_m for g in shapes], dtype=np.float64),
            centre_px=np.array([g.centre_px for g in shapes], dtype=np.float64).reshape(
                per_pair, 2
            ),
            points=int(ties.point.max()) + 1 if len(ties) else 0,
        )

    def __len__(self) -> int:
        return len(self.point)

    def select(self, rows: np.ndarray) -> Observations:
        """Some of the observations."""
        return replace(
            self,
            point=self.point[rows],
            pair=self.pair[rows],
            measured=self.measured[rows],
            weight=self.weight[rows],
        )

    @property
    def stop(self) -> Int32[np.ndarray, " n"]:
        """Stop of each observation."""
        return self.pair_stop[self.pair]

    def origins_in_rover(
        self, pointings: Float64[np.ndarray, "pairs 3"]
    ) -> Float64[np.ndarray, "pairs 3"]:
        """Origin of every pair after the mast has turned it about its head."""
        lever = self.origin_in_rover - self.pivot_in_rover
        return self.pivot_in_rover + (rotation_of_vector(pointings) @ lever[:, :, None])[:, :, 0]

    @property
    def is_stereo(self) -> Flags:
        """Whether the parallax was measured, and shows a point in front of the cameras."""
        return (self.weight[:, 2] > 0) & (self.measured[:, 2] > 0)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """All unknowns, as they stand."""

    rotations: Float64[np.ndarray, "stops 3 3"]
    centres: Float64[np.ndarray, "stops 3"]
    pointings: Float64[np.ndarray, "pairs 3"]
    points: Float64[np.ndarray, "points 3"]

    def of_stops(self, stops: np.ndarray) -> State:
        """The poses of some stops alone."""
        return State(
            self.rotations[stops], self.centres[stops], self.pointings[:0], self.points[:0]
        )


def pair_orientations(
    state: State, observations: Observations
) -> tuple[Float64[np.ndarray, "pairs 3 3"], Float64[np.ndarray, "pairs 3"]]:
    """Rotation lsl_from_pair and origin in the LSL of every pair."""
    of_stop = state.rotations[observations.pair_stop]
    rotations = of_stop @ rotation_of_vector(state.pointings) @ observations.rover_from_pair
    origins = (
        state.centres[observations.pair_stop]
        + (of_stop @ observations.origins_in_rover(state.pointings)[:, :, None])[:, :, 0]
    )
    return rotations, origins


def triangulated_in_pair(observations: Observations) -> Float64[np.ndarray, "n 3"]:
    """Each observation's own point in its pair's frame; NaN without parallax."""
    j = observations.pair
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(
            observations.is_stereo,
            observations.focal_px[j] * observations.base_m[j] / observations.measured[:, 2],
            np.nan,
        )
    xy = (observations.measured[:, :2] - observations.centre_px[j]) / observations.focal_px[j, None]
    return np.column_stack([xy * z[:, None], z])


def triangulated(state: State, observations: Observations) -> Float64[np.ndarray, "n 3"]:
    """Each observation's own point in the LSL; NaN without parallax."""
    rotations, origins = pair_orientations(state, observations)
    in_pair = triangulated_in_pair(observations)
    j = observations.pair
    return origins[j] + (rotations[j] @ in_pair[:, :, None])[:, :, 0]


def misclosures(
    state: State, observations: Observations, rows: np.ndarray
) -> Float64[np.ndarray, "m 3"]:
    """Observed minus computed (x, y, p) of some observations, pixels; NaN behind the camera."""
    return misclosures_by_component(state, observations, rows).T.copy()


def misclosures_by_component(
    state: State, observations: Observations, rows: np.ndarray | slice
) -> Float64[np.ndarray, "3 m"]:
    """The same, component by component."""
    rotations, origins = pair_orientations(state, observations)
    j = observations.pair[rows]
    F = _gathered(rotations.swapaxes(1, 2), j)
    e = (state.points[observations.point[rows]] - origins[j]).T
    y = F[:, 0] * e[0] + F[:, 1] * e[1] + F[:, 2] * e[2]
    scale = observations.focal_px[j] / np.where(y[2] > 0, y[2], np.nan)
    y[2] = observations.base_m[j]
    l = observations.measured[rows].T - scale * y
    l[:2] -= observations.centre_px.T[:, j]
    return l


@dataclass(frozen=True, slots=True, eq=False)
class Partials:
    """Derivatives of (x, y, p), component by component: (coordinate, unknown, observation)."""

    by_point: Float64[np.ndarray, "3 3 m"]
    by_pointing: Float64[np.ndarray, "3 3 m"]
    arm: Float64[np.ndarray, "3 m"]
    """From the stop to the point, in the LSL."""

    @property
    def by_stop(self) -> Float64[np.ndarray, "3 6 m"]:
        """By (d, dc) of the observation's stop: a' [arm] = (a x arm)', a a row of `by_point`."""
        return np.concatenate([_cross(self.by_point, self.arm), -self.by_point], axis=1)

    def of(self, part: slice) -> Partials:
        """Those of some consecutive observations."""
        return Partials(self.by_point[..., part], self.by_pointing[..., part], self.arm[:, part])

    def weighted(self, weight: Float64[np.ndarray, "3 m"]) -> Partials:
        """Every coordinate times its weight."""
        by = weight[:, None]
        return Partials(self.by_point * by, self.by_pointing * by, self.arm)


def partials_by_component(
    state: State, observations: Observations, rows: np.ndarray | slice
) -> Partials:
    """Derivatives of some observations."""
    j = observations.pair[rows]
    s = observations.pair_stop[j]
    rotations, origins = pair_orientations(state, observations)
    F = _gathered(rotations.swapaxes(1, 2), j)
    X = state.points[observations.point[rows]].T
    arm = X - state.centres.T[:, s]
    e = X - origins.T[:, j]
    y = F[:, 0] * e[0] + F[:, 1] * e[1] + F[:, 2] * e[2]
    scale = observations.focal_px[j] / y[2]
    by_point = np.empty_like(F)
    by_point[:2] = scale * (F[:2] - (y[:2] / y[2])[:, None] * F[2])
    by_point[2] = (-scale * observations.base_m[j] / y[2]) * F[2]
    # the pointing turns about the mast head: with a row b of by_point seen from the rover, its
    # derivative is b' [h] J = (b x h)' J
    R = _gathered(state.rotations, s)
    in_rover = _product(by_point, R)
    h = (arm[:, None] * R).sum(axis=0) - observations.pivot_in_rover.T[:, j]
    J = _gathered(left_jacobian(state.pointings), j)
    return Partials(by_point, _product(_cross(in_rover, h), J), arm)


def partials(
    state: State, observations: Observations, rows: np.ndarray
) -> tuple[Float64[np.ndarray, "m 3 9"], Float64[np.ndarray, "m 3 3"]]:
    """Derivatives of (x, y, p) by (d, dc, dm) of the observation's stop and pair, and by dX."""
    A = partials_by_component(state, observations, rows)
    by_orientation = np.concatenate([A.by_stop, A.by_pointing], axis=1)
    return by_orientation.transpose(2, 0, 1).copy(), A.by_point.transpose(2, 0, 1).copy()


def _gathered(
    matrices: Float64[np.ndarray, "k 3 3"], which: np.ndarray
) -> Float64[np.ndarray, "3 3 m"]:
    """Some of many matrices, component by component."""
    return np.take(matrices.reshape(-1, 9).T.copy(), which, axis=1).reshape(3, 3, -1)


def _product(
    A: Float64[np.ndarray, "3 3 m"], B: Float64[np.ndarray, "3 3 m"]
) -> Float64[np.ndarray, "3 3 m"]:
    """A B of many matrices; component by component this is several times faster than `@`."""
    product = A[:, 0, None] * B[0]
    product += A[:, 1, None] * B[1]
    product += A[:, 2, None] * B[2]
    return product


def _cross(
    rows: Float64[np.ndarray, "3 3 m"], v: Float64[np.ndarray, "3 m"]
) -> Float64[np.ndarray, "3 3 m"]:
    """Every row of many matrices times v, as vectors."""
    crossed = np.empty_like(rows)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        crossed[:, i] = rows[:, j] * v[k] - rows[:, k] * v[j]
    return crossed
