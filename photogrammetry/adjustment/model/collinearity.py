"""The observations and unknowns of a network as arrays, and collinearity with its derivatives.

A stop has rotation R and centre c in the LSL (of the rover frame). Pair j of that stop is a rigid
body: the label gives rover_from_pair = (R_j, t_j), the mast turns it by a small unknown rotation
m_j about the mast head v_j. (The lever is short: 0.1 degrees move a camera by 0.3 mm. It matters
nevertheless: with another pivot, hundreds of ties on near ground would tilt a whole panorama by
0.06 degrees.) A point X of the LSL is

    g = R' (X - c)                            in the rover frame
    h = g - v_j                               from the mast head
    y = R_j' (Exp(m_j)' h - (t_j - v_j))      in the pair's frame

and is seen at (x, y) in the left image with parallax p,

    x = c_x + f y_1/y_3       y = c_y + f y_2/y_3       p = f B / y_3

so that both cameras are one rigid stereo rig by construction. Corrections are d (rotation of the
stop, R <- Exp(d) R, a vector in the LSL), dc, dm and dX. With B_j = R_j' Exp(m_j)', F_j = B_j R'
and the lever q_j = R_j' (t_j - v_j) from the mast head to the pair, in the pair's frame,

    dy = F_j [X - c] d - F_j dc + [y + q_j] B_j J(m_j) dm + F_j dX

Rotation and *centre* are corrected, not rotation and translation of the inverse motion: a rotation
of a stop then leaves its position unchanged, and Gauss-Newton needs few steps on long open
traverses.

Arrays are kept component by component, observations along their last axis (see `small_matrices`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.adjustment.model.network import Network
from solmap.photogrammetry.adjustment.model.small_matrices import (
    Matrices,
    Vectors,
    by_component,
    cross_rows,
    left_jacobian,
    product,
    rotation_of_vector,
    transform,
)
from solmap.photogrammetry.arrays import Bool, Flags, Float64, Int32

STOP_UNKNOWNS = 6
MAST_UNKNOWNS = 4
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
    """Projection centre by the label, before the pointing is corrected."""
    pivot_in_rover: Float64[np.ndarray, "pairs 3"]
    focal_px: Float64[np.ndarray, " pairs"]
    base_m: Float64[np.ndarray, " pairs"]
    centre_px: Float64[np.ndarray, "pairs 2"]
    points: int
    """Number of points."""
    surface_matched: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Whether surface-matched; if not given, none is."""
    bodies: PairBodies = field(init=False)
    """The geometry of the pairs, component by component."""
    sights: Sights = field(init=False)
    """The observations, component by component."""
    stop: Int32[np.ndarray, " n"] = field(init=False)
    """Stop of each observation."""
    is_stereo: Flags = field(init=False)
    """Whether the parallax was measured and is that of a point in front of the cameras."""
    kind: Int32[np.ndarray, " n"] = field(init=False)
    """0 within a stop, 1 between stops image-matched, 2 between stops surface-matched."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "bodies", PairBodies.of(self))
        measured, weight = self.measured.T.copy(), self.weight.T.copy()
        object.__setattr__(self, "sights", Sights(self.point, self.pair, measured, weight))
        object.__setattr__(self, "stop", self.pair_stop[self.pair])
        in_front = (self.weight[:, 2] > 0) & (self.measured[:, 2] > 0)
        object.__setattr__(self, "is_stereo", in_front)
        joins = seen_from_several(self.point, self.stop, self.points)[self.point]
        surface_matched = (
            self.surface_matched if len(self.surface_matched) else np.zeros(len(self), dtype=bool)
        )
        object.__setattr__(self, "kind", (joins * (1 + surface_matched)).astype(np.int32))

    @classmethod
    def of(cls, network: Network) -> Observations:
        """The arrays of a network."""
        stop_number = {stop: k for k, stop in enumerate(network.stop_ids)}
        pair_number = {pair.pair_id: k for k, pair in enumerate(network.pairs)}
        ties, shapes = network.ties, [pair.geometry for pair in network.pairs]
        distinct = np.array([pair_number[name] for name in ties.pair_ids], dtype=np.int32)
        stereo = np.isfinite(ties.parallax_px)
        per_pair = len(shapes)
        return cls(
            point=ties.point,
            pair=distinct[ties.pair] if len(ties) else np.zeros(0, dtype=np.int32),
            measured=np.column_stack([ties.left, np.where(stereo, ties.parallax_px, 0.0)]),
            weight=np.column_stack(
                [
                    1.0 / ties.sigma_px,
                    1.0 / ties.sigma_line_px,
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
            pivot_in_rover=np.array([g.pivot_in_rover for g in shapes]).reshape(-1, 3),
            focal_px=np.array([g.focal_px for g in shapes], dtype=np.float64),
            base_m=np.array([g.base_m for g in shapes], dtype=np.float64),
            centre_px=np.array([g.centre_px for g in shapes], dtype=np.float64).reshape(
                per_pair, 2
            ),
            points=int(ties.point.max()) + 1 if len(ties) else 0,
            surface_matched=ties.surface_matched,
        )

    def __len__(self) -> int:
        return len(self.point)

    def select(self, rows: np.ndarray) -> Observations:
        """A selection of the observations."""
        return replace(
            self,
            point=self.point[rows],
            pair=self.pair[rows],
            measured=self.measured[rows],
            weight=self.weight[rows],
            surface_matched=self.surface_matched[rows]
            if len(self.surface_matched)
            else self.surface_matched,
        )

    def stop_of(self, rows: np.ndarray) -> Int32[np.ndarray, " m"]:
        """Stop of some of the observations."""
        return self.stop[rows]

    def in_rover(
        self, pointings: Float64[np.ndarray, "pairs 3"]
    ) -> tuple[Float64[np.ndarray, "pairs 3 3"], Float64[np.ndarray, "pairs 3"]]:
        """Rotation rover_from_pair and origin of every pair, rotated by the mast about its head."""
        turn, lever = rotation_of_vector(pointings), self.origin_in_rover - self.pivot_in_rover
        origins = self.pivot_in_rover + (turn @ lever[:, :, None])[:, :, 0]
        return turn @ self.rover_from_pair, origins


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """Observations of image coordinates, component by component."""

    point: Int32[np.ndarray, " m"]
    pair: Int32[np.ndarray, " m"]
    measured: Vectors
    weight: Vectors

    def __len__(self) -> int:
        return len(self.point)

    def at(self, rows: np.ndarray) -> Sights:
        """Some of them."""
        return Sights(
            self.point[rows],
            self.pair[rows],
            np.take(self.measured, rows, axis=1),
            np.take(self.weight, rows, axis=1),
        )

    def mask(self, counts: Bool[np.ndarray, " m"]) -> Sights:
        """The same with zero weight where they are not used."""
        return replace(self, weight=self.weight * counts)

    def part(self, part: slice) -> Sights:
        """Some consecutive ones."""
        measured, weight = self.measured[:, part], self.weight[:, part]
        return Sights(self.point[part], self.pair[part], measured, weight)


@dataclass(frozen=True, slots=True, eq=False)
class PairBodies:
    """Quantities of the pairs that do not depend on stops and masts, component by component."""

    to_pair: Matrices
    """pair_from_rover."""
    rover_from_pair: Matrices
    pivot: Vectors
    lever: Vectors
    """Vector from the mast head to the pair, in the rover frame."""
    lever_in_pair: Vectors
    optics: Float64[np.ndarray, "4 pairs"]
    """f, B, c_x, c_y."""

    @classmethod
    def of(cls, observations: Observations) -> PairBodies:
        """The quantities of all pairs of a network."""
        rover_from_pair = by_component(observations.rover_from_pair)
        to_pair, pivot = rover_from_pair.swapaxes(0, 1), observations.pivot_in_rover.T
        lever = observations.origin_in_rover.T - pivot
        inner = (observations.focal_px, observations.base_m, *observations.centre_px.T)
        return cls(
            to_pair, rover_from_pair, pivot, lever, transform(to_pair, lever), np.stack(inner)
        )


def distinct(found: np.ndarray) -> np.ndarray:
    """The numbers that occur, ascending."""
    return np.flatnonzero(np.bincount(found))


def seen_from_several(point: np.ndarray, of: np.ndarray, points: int) -> Flags:
    """Which points have observations `of` different stops, or pairs."""
    one = np.zeros(points, dtype=of.dtype)
    one[point] = of  # of one of its observations
    differ = np.zeros(points, dtype=bool)
    differ[point[of != one[point]]] = True
    return differ


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Values of all unknowns."""

    rotations: Float64[np.ndarray, "stops 3 3"]
    centres: Float64[np.ndarray, "stops 3"]
    pointings: Float64[np.ndarray, "pairs 3"]
    points: Float64[np.ndarray, "points 3"]
    frames: Float64[np.ndarray, "frames 5"] = field(default_factory=lambda: np.zeros((0, 5)))
    """Places of the control frames: shift east, north, up (m), turn (rad), change of scale."""
    mast: Float64[np.ndarray, " 4"] = field(default_factory=lambda: np.zeros(MAST_UNKNOWNS))
    """Systematic errors of the mast, see `telemetry`."""

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
    rotations, origins = observations.in_rover(state.pointings)
    moved = (of_stop @ origins[:, :, None])[:, :, 0]
    return of_stop @ rotations, state.centres[observations.pair_stop] + moved


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Quantities of every pair and point at a state, component by component."""

    pairs: Float64[np.ndarray, "16 pairs"]
    """F (9), origin in the LSL (3), f, B, c_x, c_y."""
    stop: Int32[np.ndarray, " pairs"]
    centres: Float64[np.ndarray, "3 stops"]
    points: Float64[np.ndarray, "3 points"]
    bodies: PairBodies
    pointings: Float64[np.ndarray, "pairs 3"]

    @classmethod
    def of(cls, state: State, observations: Observations) -> Views:
        """The quantities at a state."""
        bodies, stop = observations.bodies, observations.pair_stop
        of_stop = np.take(by_component(state.rotations), stop, axis=2)
        by_mast = product(of_stop, by_component(rotation_of_vector(state.pointings)))
        table = np.empty((16, len(stop)))
        table[:9] = product(by_mast, bodies.rover_from_pair).swapaxes(0, 1).reshape(9, -1)
        table[9:12] = transform(of_stop, bodies.pivot)
        table[9:12] += transform(by_mast, bodies.lever)
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
        """The same with other point coordinates."""
        return replace(self, points=points)

    def are_in_front(self, sights: Sights) -> Bool[np.ndarray, " m"]:
        """Which points are in front of the camera, so that they have misclosures."""
        axis, origin = np.take(self.pairs[6:12], sights.pair, axis=1).reshape(2, 3, -1)
        arm = np.take(self.points, sights.point, axis=1) - origin
        return np.einsum("im,im->m", axis, arm) > 0

    def misclosures(self, sights: Sights) -> Vectors:
        """Observed minus computed (x, y, p), pixels; NaN behind the camera."""
        of_pair = np.take(self.pairs, sights.pair, axis=1)
        e = np.take(self.points, sights.point, axis=1)
        e -= of_pair[9:12]
        y = transform(of_pair[:9].reshape(3, 3, -1), e)
        scale = of_pair[12] / np.where(y[2] > 0, y[2], np.nan)
        y[2] = of_pair[13]
        y *= scale
        y[:2] += of_pair[14:16]
        return np.subtract(sights.measured, y, out=y)

    def masts(self) -> Float64[np.ndarray, "12 pairs"]:
        """For rotations of the mast: q (3) and B J (9)."""
        jacobian = by_component(left_jacobian(-self.pointings))  # J(-m) = Exp(m)' J(m)
        turning = product(self.bodies.to_pair, jacobian).reshape(9, -1)
        return np.concatenate([self.bodies.lever_in_pair, turning])

    def partials(
        self, sights: Sights, masts: Float64[np.ndarray, "12 pairs"] | None = None
    ) -> Partials:
        """Derivatives of (x, y, p), times the weights; `masts` if they are known already."""
        of_pair = np.take(self.pairs[:14], sights.pair, axis=1)
        of_mast = np.take(self.masts() if masts is None else masts, sights.pair, axis=1)
        X = np.take(self.points, sights.point, axis=1)
        F, q, K = of_pair[:9].reshape(3, 3, -1), of_mast[:3], of_mast[3:].reshape(3, 3, -1)
        y = transform(F, X - of_pair[9:12])
        scale = of_pair[12] / y[2] * sights.weight  # of one pixel per metre, across and along
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
        """Vectors from stops to points, in the LSL."""
        return X - np.take(self.centres, stop, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Partials:
    """Derivatives of (x, y, p), component by component: (coordinate, unknown, observation)."""

    by_point: Matrices
    by_pointing: Matrices
    X: Vectors
    """The points, in the LSL."""

    def of(self, part: slice) -> Partials:
        """The derivatives of some consecutive observations."""
        return Partials(self.by_point[..., part], self.by_pointing[..., part], self.X[:, part])

    def apply_weight(self, weight: Float64[np.ndarray, " m"]) -> Partials:
        """The equations of observations times their weights."""
        return Partials(self.by_point * weight, self.by_pointing * weight, self.X)

    def by_stop(self, arm: Vectors) -> Float64[np.ndarray, "3 6 m"]:
        """Derivatives by (d, dc) of a stop: a' [arm] = (a x arm)', a a row of `by_point`."""
        return np.concatenate([cross_rows(self.by_point, arm), -self.by_point], axis=1)

    def by_row(
        self, views: Views, stop: np.ndarray
    ) -> tuple[Float64[np.ndarray, "m 3 9"], Float64[np.ndarray, "m 3 3"]]:
        """Derivatives by (d, dc, dm) and by dX for each observation; `stop` is that of each."""
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
