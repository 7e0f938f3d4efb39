"""Telemetry as observations: gravity, azimuth, and the increment from the stop before.

With the telemetry pose (R°, c°) of a stop and the unknown pose (R, c), M = R R°', and the stop
before marked by a minus sign, the observations of a stop are

    tilt       (M' e_z)_x,y = 0                 down, in the level frame of telemetry
    azimuth    a = 0  if measured (FINE), else  a - a_ = 0;   a, twist of M about z:
                                                tan a = (M_10 - M_01) / (M_00 + M_11)
    position   R_' (c - c_) = R°_' (c° - c°_)   the increment, in the frame of the rover before

The position is observed as an increment because wheels measure increments: a correction of the stop
before rotates and shifts the increment too, and carries over to all later stops. Its standard
deviation is a fraction of the distance driven (slip) plus a floor. First order:

    d(M' e_z) = M' (e_z x d)       d(R_'(c - c_)) = R_' (dc - dc_ + [c - c_] d_)
    da = ((-M_20 q + M_21 p) d_x + (-M_21 q - M_20 p) d_y) / (p^2 + q^2) + d_z

with p = M_10 - M_01, q = M_00 + M_11. The mast pointing error m_j of a pair is the sum of errors of
the mast that are the same at all stops and a small independent one,

    m_j - B_j s = 0,     s = 0,     B_j s = s_1 e + s_2 x + s_3 y + s_4 z,     e = z x f / |z x f|

with the elevation zero s_1 about the elevation axis e of a pair that looks along f, the tilt of the
azimuth axis about the rover's x and y, and the azimuth zero s_4. Ties determine s_1 alone. The
azimuth zero rotates everything that any stop sees about the vertical: headings stay, and the places
of all stops turn about the held one by as much as s_4 is uncertain.

Tilt is observed in the rover's level frame and not as (M e_z)_x,y = 0: that is as small, but
rotates with the azimuth, and Gauss-Newton would take the rotation for a misfit. After 2,000 stops
it made the softest bending mode a tenth stiffer than it is, and every step a tenth too short.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import MAST_UNKNOWNS, State
from solmap.photogrammetry.adjustment.model.network import Network, PairGeometry
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import cross_matrix
from solmap.photogrammetry.arrays import Flags, Float64

ROWS = 6
"""Observations of a stop: two of tilt, one of azimuth, three of position."""


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """The telemetry of a network as arrays; stop k follows stop k - 1."""

    rotations: Float64[np.ndarray, "stops 3 3"]
    centres: Float64[np.ndarray, "stops 3"]
    is_fine: Flags
    weight: Float64[np.ndarray, "stops 6"]
    """1/sigma of each observation, zero where there is none."""
    pointing_weight: float
    """1/sigma; infinite where the label's pointing is exact."""
    mast: Float64[np.ndarray, "pairs 3 k"] = field(default_factory=lambda: np.zeros((0, 3, 0)))
    """B; not given: masts have no systematic errors."""
    mast_weight: float = 0.0
    """Prior 1/sigma of systematic errors."""
    before: np.ndarray = field(init=False)
    """Number of the stop before each stop; the first refers to itself, with zero weight."""
    steps: Float64[np.ndarray, "stops 3"] = field(init=False)
    """Vector from the stop before, in the frame of the rover there."""

    def __post_init__(self) -> None:
        before = np.maximum(np.arange(len(self.centres)) - 1, 0)
        object.__setattr__(self, "before", before)
        steps = _in_rover(self.rotations[before], self.centres - self.centres[before])
        object.__setattr__(self, "steps", steps)

    @classmethod
    def of(cls, network: Network, params: AdjustmentParams) -> Telemetry:
        """The telemetry observations of the stops of a network."""
        rotations = np.array([s.lsl_from_rover.rotation for s in network.stops]).reshape(-1, 3, 3)
        centres = np.array([s.lsl_from_rover.translation_m for s in network.stops]).reshape(-1, 3)
        fine = np.array([s.is_fine for s in network.stops], dtype=bool)
        follows = np.arange(len(network.stops)) > 0
        driven = np.zeros(len(centres))
        driven[1:] = np.linalg.norm(np.diff(centres, axis=0), axis=1)
        weight = np.zeros((len(centres), ROWS))
        weight[:, :2] = 1.0 / np.radians(params.tilt_deg)
        step = np.where(follows, 1.0 / np.radians(params.azimuth_step_deg), 0.0)
        weight[:, 2] = np.where(fine, 1.0 / np.radians(params.azimuth_fine_deg), step)
        sigma_m = params.slip * driven + params.position_floor_m
        weight[:, 3:] = np.where(follows, 1.0 / sigma_m, 0.0)[:, None]
        pointing = 1.0 / float(np.radians(params.pointing_deg))
        mast, sigma = mast_partials(network.pairs), float(np.radians(params.mast_deg))
        return cls(rotations, centres, fine, weight, pointing, mast, 1.0 / sigma)

    @property
    def masts_turn(self) -> bool:
        """Whether mast pointings are unknown."""
        return bool(np.isfinite(self.pointing_weight))

    @property
    def mast_unknowns(self) -> int:
        """How many systematic errors of the mast are unknown."""
        return self.mast.shape[2] if self.masts_turn else 0

    def misses(self, state: State) -> Float64[np.ndarray, "pairs 3"]:
        """Pointings minus their systematic part."""
        return state.pointings - self.mast @ state.mast if self.mast_unknowns else state.pointings

    def of_stops(self, stops: np.ndarray) -> Telemetry:
        """The telemetry of some consecutive stops."""
        return Telemetry(
            self.rotations[stops],
            self.centres[stops],
            self.is_fine[stops],
            self.weight[stops],
            self.pointing_weight,
        )


def mast_partials(pairs: Sequence[PairGeometry]) -> Float64[np.ndarray, "pairs 3 4"]:
    """B: rotations of every pair by elevation zero, tilts of the azimuth axis, azimuth zero."""
    B = np.zeros((len(pairs), 3, MAST_UNKNOWNS))
    B[:, :, 1:] = np.eye(3)
    for k, pair in enumerate(pairs):
        x, y, _ = pair.geometry.rover_from_pair.rotation[:, 2]
        level = float(np.hypot(x, y))
        B[k, :2, 0] = (-y / level, x / level) if level else (0.0, 0.0)
    return B


def _azimuths(M: Float64[np.ndarray, "stops 3 3"]) -> Float64[np.ndarray, " stops"]:
    """Rotations of the changes M about z."""
    return np.arctan2(M[:, 1, 0] - M[:, 0, 1], M[:, 0, 0] + M[:, 1, 1])


def _slopes(M: Float64[np.ndarray, "stops 3 3"]) -> Float64[np.ndarray, "stops 3"]:
    """Derivatives of these rotations by d."""
    p, q = M[:, 1, 0] - M[:, 0, 1], M[:, 0, 0] + M[:, 1, 1]
    size = np.maximum(p**2 + q**2, np.finfo(float).tiny)
    slopes = np.ones((len(M), 3))
    slopes[:, 0] = (-M[:, 2, 0] * q + M[:, 2, 1] * p) / size
    slopes[:, 1] = (-M[:, 2, 1] * q - M[:, 2, 0] * p) / size
    return slopes


def telemetry_misclosures(state: State, telemetry: Telemetry) -> Float64[np.ndarray, "stops 6"]:
    """Observed minus computed, not weighted."""
    before, M = telemetry.before, _changes(state.rotations, telemetry)
    azimuth = _azimuths(M)
    change = np.where(telemetry.is_fine, azimuth, azimuth - azimuth[before])
    step = _in_rover(state.rotations[before], state.centres - state.centres[before])
    l = np.empty((len(M), ROWS))
    l[:, :2] = -M[:, 2, :2]
    l[:, 2] = -np.arctan2(np.sin(change), np.cos(change))
    np.subtract(telemetry.steps, step, out=l[:, 3:])
    return l


def telemetry_partials(state: State, telemetry: Telemetry) -> Float64[np.ndarray, "stops 6 12"]:
    """Derivatives of the six by (d_, dc_) of the stop before and (d, dc) of the stop."""
    before = telemetry.before
    M = _changes(state.rotations, telemetry)
    slope = _slopes(M)
    to_rover = state.rotations[before].swapaxes(1, 2)
    A = np.zeros((len(before), ROWS, 12))
    A[:, :2, 6], A[:, :2, 7] = M[:, 1, :2], -M[:, 0, :2]
    A[:, 2, 6:9] = slope
    A[:, 2, 0:3] = np.where(telemetry.is_fine[:, None], 0.0, -slope[before])
    A[:, 3:, 0:3] = to_rover @ cross_matrix(state.centres - state.centres[before])
    A[:, 3:, 3:6] = -to_rover
    A[:, 3:, 9:12] = to_rover
    return A


def _changes(
    rotations: Float64[np.ndarray, "stops 3 3"], telemetry: Telemetry
) -> Float64[np.ndarray, "stops 3 3"]:
    """M, the rotation of stops against their telemetry, in the LSL."""
    return rotations @ telemetry.rotations.swapaxes(1, 2)


def _in_rover(
    rotations: Float64[np.ndarray, "stops 3 3"], vectors: Float64[np.ndarray, "stops 3"]
) -> Float64[np.ndarray, "stops 3"]:
    return (vectors[:, None, :] @ rotations)[:, 0, :]
