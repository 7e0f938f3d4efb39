"""The marginal: information of marginalised observations about the remaining stops.

A stop that no new image will see is marginalised together with its observations. Their information
about the remaining stops is kept exactly, as a square root of information (see `elimination` for
the same with points): with the corrections of what is marginalised (s) and of what remains (T), all
whitened observations that depend on s are triangulated orthogonally,

    | A_s  A_T | x = l    ->    | R_ss  R_sT |  x = | d_s |          conditional of s, given T
                                |  0    R_TT |      | d_T |          marginal of T

so that |R_TT x_T - d_T|^2 replaces them (Di et al. 2008, equations 3 and 4, with X = s, Y = T; the
Kalman form there, orthogonal transformations here as in Blais 1983 and Holm 1989).

The marginal is linear about the poses at that time, but the remaining stops are estimated again. It
is therefore written in coordinates that follow the bending of the traverse: with the anchor a, the
last of the stops, and values at that time marked by °,

    z_a = (Log(R_a R_a°'), c_a - c_a°)                                        the anchor in the LSL
    z_i = (Log(R_a'R_i (R_a°'R_i°)'), R_a'(c_i - c_a) - R_a°'(c_i° - c_a°))   others, relative to it
    z_j = m_j - m_j°                                                          pointings
    z_g = p_g - p_g°                                                          control frames
    z_s = s - s°                                                systematic errors of the mast

A common motion of all stops, which later observations may cause, does not change z_i. First order,
with J the left Jacobian of the rotation vector:

    dz_i = (J^-1 R_a' (d_i - d_a),   R_a' (dc_i - dc_a + [c_i - c_a] d_a))
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import Memory
from solmap.photogrammetry.adjustment.model.collinearity import (
    PAIR_UNKNOWNS,
    STOP_UNKNOWNS,
    State,
)
from solmap.photogrammetry.adjustment.model.network import FRAME_UNKNOWNS, Network
from solmap.photogrammetry.adjustment.model.small_matrices import (
    cross_matrix,
    inverse_left_jacobian,
)
from solmap.photogrammetry.arrays import Bool, Float64, Int32
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Coordinates z of some stops and pairs about their values at one time.

    The last stop is the anchor. Columns: 6 for each stop, 3 for each pair, 5 for each control
    frame, and those of the mast.
    """

    stops: Int32[np.ndarray, " stops"]
    """Their numbers in the network."""
    pairs: Int32[np.ndarray, " pairs"]
    rotations: Float64[np.ndarray, "stops 3 3"]
    centres: Float64[np.ndarray, "stops 3"]
    pointings: Float64[np.ndarray, "pairs 3"]
    frames: Int32[np.ndarray, " frames"] = field(default_factory=lambda: np.zeros(0, np.int32))
    frame_places: Float64[np.ndarray, "frames 5"] = field(default_factory=lambda: np.zeros((0, 5)))
    mast: Float64[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0))
    """Systematic errors of the mast; none where they are not unknowns."""
    reference: tuple[np.ndarray, np.ndarray] = field(init=False)
    """Rotations and positions relative to the anchor at that time: see `_from_anchor`."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "reference", _from_anchor(self.rotations, self.centres))

    @classmethod
    def at(
        cls,
        state: State,
        stops: np.ndarray,
        pairs: np.ndarray,
        frames: np.ndarray | None = None,
        mast: int = 0,
    ) -> Chart:
        """The coordinates about a state."""
        frames = np.zeros(0, dtype=np.int32) if frames is None else frames.astype(np.int32)
        return cls(
            stops.astype(np.int32),
            pairs.astype(np.int32),
            state.rotations[stops],
            state.centres[stops],
            state.pointings[pairs],
            frames,
            state.frames[frames],
            state.mast[:mast],
        )

    @property
    def size(self) -> int:
        """Number of coordinates."""
        posed = STOP_UNKNOWNS * len(self.stops) + PAIR_UNKNOWNS * len(self.pairs)
        return posed + FRAME_UNKNOWNS * len(self.frames) + len(self.mast)

    def coordinates(self, state: State) -> Float64[np.ndarray, " n"]:
        """Z of a state."""
        turn, place = _from_anchor(state.rotations[self.stops], state.centres[self.stops])
        reference_turn, reference_place = self.reference
        z = np.empty((len(self.stops), STOP_UNKNOWNS))
        z[:, :3] = _vectors(turn @ reference_turn.mT)
        np.subtract(place, reference_place, out=z[:, 3:])
        turned = state.pointings[self.pairs] - self.pointings
        shifted = state.frames[self.frames] - self.frame_places
        missed = state.mast[: len(self.mast)] - self.mast
        return np.concatenate([z.ravel(), turned.ravel(), shifted.ravel(), missed])

    def pose_partials(
        self, state: State, z: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "p p"]:
        """Derivatives of z by (d, dc) of the stops, in the LSL, at a state whose coordinates are z.

        Pointings, frames and errors of the mast differ from their z by constants.
        """
        n, rotations = len(self.stops), state.rotations[self.stops]
        bend = inverse_left_jacobian(z[: 6 * n].reshape(n, 6)[:, :3])
        centres, to_anchor = state.centres[self.stops], rotations[-1].T
        J, others = np.zeros((n, 2, 3, n, 2, 3)), np.arange(n - 1)  # turn and shift of each stop
        turns = bend[:-1] @ to_anchor
        J[others, 0, :, others, 0] = turns
        J[:-1, 0, :, -1, 0] = -turns
        J[others, 1, :, others, 1] = to_anchor
        J[:-1, 1, :, -1, 1] = -to_anchor
        J[:-1, 1, :, -1, 0] = to_anchor @ cross_matrix(centres[:-1] - centres[-1])
        J[-1, 0, :, -1, 0] = bend[-1]
        J[-1, 1, :, -1, 1] = np.eye(3)
        return J.reshape(6 * n, 6 * n)

    @property
    def poses_by_coordinates(self) -> Float64[np.ndarray, "p p"]:
        """Derivatives of (d, dc) of the stops by their z at the chart's own values: J^-1 there."""
        n, from_anchor = len(self.stops), self.rotations[-1]
        K, others = np.zeros((n, 2, 3, n, 2, 3)), np.arange(n - 1)
        K[others, 0, :, others, 0] = K[others, 1, :, others, 1] = from_anchor
        K[:, 0, :, -1, 0] = K[:, 1, :, -1, 1] = np.eye(3)
        K[:, 1, :, -1, 0] = -cross_matrix(self.centres - self.centres[-1])
        return K.reshape(6 * n, 6 * n)


def _vectors(rotations: Float64[np.ndarray, "n 3 3"]) -> Float64[np.ndarray, "n 3"]:
    """Rotation vectors of rotations below about a right angle: corrections, not poses."""
    entries = rotations.reshape(-1, 9)
    v = (entries[:, [7, 2, 3]] - entries[:, [5, 6, 1]]) / 2  # of the skew-symmetric part
    sine, cosine = np.sqrt(np.vecdot(v, v)), (entries[:, ::4].sum(axis=1) - 1.0) / 2
    angle = np.arctan2(sine, cosine)
    return v * np.divide(angle, sine, out=np.ones_like(sine), where=sine > 0)[:, None]


def _from_anchor(rotations: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and positions relative to the last stop, and the last one's own in the LSL."""
    to_anchor = rotations[-1].T
    turn, place = to_anchor @ rotations, (centres - centres[-1]) @ rotations[-1]
    turn[-1], place[-1] = rotations[-1], centres[-1]
    return turn, place


@dataclass(frozen=True, slots=True, eq=False)
class Marginal:
    """|root z - right|^2: the information of marginalised observations."""

    chart: Chart
    root: Float64[np.ndarray, "r n"]
    right: Float64[np.ndarray, " r"]
    grounded: Bool[np.ndarray, " stops"]
    """Which of the stops are joined to the datum by images."""
    spent: float
    """Part of the sum of squares of the marginalised observations that no later change affects."""
    surplus: int
    """Number of marginalised observations minus the unknowns marginalised with them."""

    @property
    def stops(self) -> Int32[np.ndarray, " stops"]:
        """Numbers of the stops that it couples."""
        return self.chart.stops

    @property
    def pairs(self) -> Int32[np.ndarray, " pairs"]:
        """Numbers of the pairs that it couples."""
        return self.chart.pairs

    def cost_at(self, z: Float64[np.ndarray, " n"]) -> float:
        """The sum of squares of all marginalised observations at some coordinates."""
        off = self.root @ z - self.right
        return self.spent + float(off @ off)

    def rows(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Its observation equations A x = l for corrections in the LSL, at a state."""
        return self.rows_at(state, self.chart.coordinates(state))

    def rows_at(self, state: State, z: Float64[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """The same where the coordinates of the state are known."""
        J = self.chart.pose_partials(state, z)
        A, posed = self.root.copy(), len(J)
        A[:, :posed] = self.root[:, :posed] @ J
        return A, self.right - self.root @ z

    def normals_at(
        self, state: State, z: Float64[np.ndarray, " n"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Its normal matrix and right-hand side there."""
        A, l = self.rows_at(state, z)
        return A.T @ A, A.T @ l

    @property
    def frames(self) -> Int32[np.ndarray, " frames"]:
        """Numbers of the control frames that it couples."""
        return self.chart.frames

    @classmethod
    def of(cls, memory: Memory, network: Network) -> Marginal:
        """The marginal of a memory for the stops and pairs of a network."""
        stop_number = {stop: k for k, stop in enumerate(network.stop_ids)}
        pair_number = {pair.pair_id: k for k, pair in enumerate(network.pairs)}
        frame_number = {frame.name: k for k, frame in enumerate(network.frames)}
        lost = [str(stop) for stop in memory.stops if stop not in stop_number]
        lost += [name for name in memory.frames if name not in frame_number]
        lost += [name for name in memory.pair_ids if name not in pair_number]
        if lost:
            raise AdjustmentError(
                f"the marginal of the sequential adjustment contains {lost[0]}, which is not in "
                f"the network of {len(network.stops)} stops; pass all stops of its window, and "
                "their pairs"
            )
        chart = Chart(
            np.array([stop_number[stop] for stop in memory.stops], dtype=np.int32),
            np.array([pair_number[name] for name in memory.pair_ids], dtype=np.int32),
            memory.rotations,
            memory.centres,
            memory.pointings,
            np.array([frame_number[name] for name in memory.frames], dtype=np.int32),
            memory.frame_places,
            memory.mast,
        )
        grounded = np.array(memory.grounded, dtype=bool)
        return cls(chart, memory.root, memory.right, grounded, memory.spent, memory.surplus)

    def memory(self, network: Network, window: tuple[StopId, ...]) -> Memory:
        """The marginal by names, for storage."""
        chart, names = self.chart, network.stop_ids
        return Memory(
            window,
            tuple(names[k] for k in chart.stops.tolist()),
            tuple(network.pairs[k].pair_id for k in chart.pairs.tolist()),
            chart.rotations,
            chart.centres,
            chart.pointings,
            self.root,
            self.right,
            self.spent,
            self.surplus,
            tuple(self.grounded.tolist()),
            tuple(network.frames[k].name for k in chart.frames.tolist()),
            chart.frame_places,
            chart.mast,
        )
