"""What is observed in a network and where its unknowns stand, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.adjustment.componentwise import (
    Matrices,
    Vectors,
    by_component,
    turned,
)
from solmap.photogrammetry.adjustment.records import Network
from solmap.photogrammetry.adjustment.rotations import rotation_of_vector
from solmap.photogrammetry.arrays import Bool, Flags, Float64, Int32

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
    bodies: PairBodies = field(init=False)
    """The same geometry, component by component."""
    sights: Sights = field(init=False)
    """The same observations, component by component."""
    stop: Int32[np.ndarray, " n"] = field(init=False)
    """Stop of each observation."""
    is_stereo: Flags = field(init=False)
    """Whether the parallax was measured, and shows a point in front of the cameras."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "bodies", PairBodies.of(self))
        measured, weight = self.measured.T.copy(), self.weight.T.copy()
        object.__setattr__(self, "sights", Sights(self.point, self.pair, measured, weight))
        object.__setattr__(self, "stop", self.pair_stop[self.pair])
        in_front = (self.weight[:, 2] > 0) & (self.measured[:, 2] > 0)
        object.__setattr__(self, "is_stereo", in_front)

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

    def stop_of(self, rows: np.ndarray) -> Int32[np.ndarray, " m"]:
        """Stop of some of the observations."""
        return self.stop[rows]

    def in_rover(
        self, pointings: Float64[np.ndarray, "pairs 3"]
    ) -> tuple[Float64[np.ndarray, "pairs 3 3"], Float64[np.ndarray, "pairs 3"]]:
        """Rotation rover_from_pair and origin of every pair, turned by the mast about its head."""
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

    def counting(self, counts: Bool[np.ndarray, " m"]) -> Sights:
        """The same with no weight where they do not count."""
        return replace(self, weight=self.weight * counts)

    def part(self, part: slice) -> Sights:
        """Some consecutive ones."""
        measured, weight = self.measured[:, part], self.weight[:, part]
        return Sights(self.point[part], self.pair[part], measured, weight)


@dataclass(frozen=True, slots=True, eq=False)
class PairBodies:
    """What of the pairs stays when stops and masts move, component by component."""

    to_pair: Matrices
    """pair_from_rover."""
    rover_from_pair: Matrices
    pivot: Vectors
    lever: Vectors
    """From the mast head to the pair, in the rover frame."""
    lever_in_pair: Vectors
    optics: Float64[np.ndarray, "4 pairs"]
    """f, B, c_x, c_y."""

    @classmethod
    def of(cls, observations: Observations) -> PairBodies:
        """Of all pairs of a network."""
        rover_from_pair = by_component(observations.rover_from_pair)
        to_pair, pivot = rover_from_pair.swapaxes(0, 1), observations.pivot_in_rover.T
        lever = observations.origin_in_rover.T - pivot
        inner = (observations.focal_px, observations.base_m, *observations.centre_px.T)
        return cls(to_pair, rover_from_pair, pivot, lever, turned(to_pair, lever), np.stack(inner))


def numbers(found: np.ndarray) -> np.ndarray:
    """Which numbers occur, ascending."""
    return np.flatnonzero(np.bincount(found))


def seen_differently(point: np.ndarray, of: np.ndarray, points: int) -> Flags:
    """Which points have observations `of` different stops, or pairs."""
    one = np.zeros(points, dtype=of.dtype)
    one[point] = of  # of one of its observations
    differ = np.zeros(points, dtype=bool)
    differ[point[of != one[point]]] = True
    return differ


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """All unknowns, as they stand."""

    rotations: Float64[np.ndarray, "stops 3 3"]
    centres: Float64[np.ndarray, "stops 3"]
    pointings: Float64[np.ndarray, "pairs 3"]
    points: Float64[np.ndarray, "points 3"]
    frames: Float64[np.ndarray, "frames 5"] = field(default_factory=lambda: np.zeros((0, 5)))
    """Places of the control frames: shift east, north, up (m), turn (rad), change of scale."""

    def of_stops(self, stops: np.ndarray) -> State:
        """The poses of some stops alone."""
        return State(
            self.rotations[stops], self.centres[stops], self.pointings[:0], self.points[:0]
        )
