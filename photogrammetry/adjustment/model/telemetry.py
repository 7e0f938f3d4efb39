"""Telemetry as observations: gravity, azimuth, and the step from the stop before.

With the telemetry pose (R°, c°) of a stop and the unknown pose (R, c), M = R R°', and the stop
before marked by a minus sign, the observations of a stop are

    tilt       (M' e_z)_x,y = 0                 down, as the level that telemetry reports has it
    azimuth    a = 0  if measured (FINE), else  a - a_ = 0;   a, twist of M about z:
                                                tan a = (M_10 - M_01) / (M_00 + M_11)
    position   R_' (c - c_) = R°_' (c° - c°_)   the increment, in the frame of the rover before

The position is observed as an increment because that is what wheels measure: once the stop before
is corrected, the step turns and moves along with it and the correction carries over to all that
follow. Its standard deviation is a fraction of the distance driven (slip) plus a floor. First
order:

    d(M' e_z) = M' (e_z x d)       d(R_'(c - c_)) = R_' (dc - dc_ + [c - c_] d_)
    da = ((-M_20 q + M_21 p) d_x + (-M_21 q - M_20 p) d_y) / (p^2 + q^2) + d_z

with p = M_10 - M_01, q = M_00 + M_11. A part of the mast pointing m_j of a pair comes of errors of
the mast that are the same at all stops, and the rest is small and independent,

    m_j - B_j s = 0,     s = 0,     B_j s = s_1 e + s_2 x + s_3 y,     e = z x f / |z x f|

with the elevation zero s_1 about the elevation axis e of a pair that looks along f, and the tilt of
the azimuth axis about the rover's x and y. An azimuth zero is no unknown: it turns all that a stop
sees about the vertical, as its heading does; headings are told by steps, which it leaves alone, and
the first one's is the datum's.

Tilt is taken in the rover's level and not as (M e_z)_x,y = 0, which is as small: that would turn
with the azimuth, and Gauss-Newton would hold the turn for a misfit. After 2,000 stops this made the
softest bend seem a tenth stiffer than it is, and every step fall short by as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import State
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
    """1/sigma; infinite where masts point as their labels say."""
    mast: Float64[np.ndarray, "pairs 3 k"] = field(default_factory=lambda: np.zeros((0, 3, 0)))
    """B; nothing given: masts have no systematic errors."""
    mast_weight: float = 0.0
    """1/sigma of systematic errors beforehand."""
    before: np.ndarray = field(init=False)
    """Number of the stop before each stop; the first is before itself, with no weight."""
    steps: Float64[np.ndarray, "stops 3"] = field(init=False)
    """From the stop before, in the frame of the rover there."""

    def __post_init__(self) -> None:
        before = np.maximum(np.arange(len(self.centres)) - 1, 0)
        object.__setattr__(self, "before", before)
        steps = _in_rover(self.rotations[before], self.centres - self.centres[before])
        object.__setattr__(self, "steps", steps)

    @classmethod
    def of(cls, network: Network, params: AdjustmentParams) -> Telemetry:
        """What telemetry says about the stops of a network."""
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
        """Pointings without what is systematic in them."""
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


def mast_partials(pairs: Sequence[PairGeometry]) -> Float64[np.ndarray, "pairs 3 3"]:
    """B: turns of every pair by elevation zero and tilts of the azimuth axis."""
    B = np.zeros((len(pairs), 3, 3))
    B[:, 0, 1] = B[:, 1, 2] = 1.0
    for k, pair in enumerate(pairs):
        x, y, _ = pair.geometry.rover_from_pair.rotation[:, 2]
        level = float(np.hypot(x, y))
        B[k, :2, 0] = (-y / level, x / level) if level else (0.0, 0.0)
    return B


def _azimuths(M: Float64[np.ndarray, "stops 3 3"]) -> Float64[np.ndarray, " stops"]:
    """The twists of changes M about z."""
    return np.arctan2(M[:, 1, 0] - M[:, 0, 1], M[:, 0, 0] + M[:, 1, 1])


def _slopes(M: Float64[np.ndarray, "stops 3 3"]) -> Float64[np.ndarray, "stops 3"]:
    """Derivatives of the twists by d."""
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
    """M, by which stops are turned against their telemetry, in the LSL."""
    return rotations @ telemetry.rotations.swapaxes(1, 2)


def _in_rover(
    rotations: Float64[np.ndarray, "stops 3 3"], vectors: Float64[np.ndarray, "stops 3"]
) -> Float64[np.ndarray, "stops 3"]:
    return (vectors[:, None, :] @ rotations)[:, 0, :]
