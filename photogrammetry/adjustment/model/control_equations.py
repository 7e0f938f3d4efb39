"""Control as observations: positions of stops in frames whose own position is unknown.

A stop at c with rotation R, seen at u (east, north, up) and azimuth A in a frame of place
p = (t_east, t_north, t_up, b, a), gives up to four observations (see `control.ControlFrame`)

    east, north   k + (I + [[a, -b], [b, a]]) (u - k) + t  -  (c_east, c_north) = 0
    up            u_up + t_up - c_up = 0
    azimuth       A - atan2(b, 1 + a) - atan2(R_10, R_00) = 0

with k the frame's centre. Places are linear in all unknowns. With the first column r of R and a
turn d of the stop

    d atan2(r_1, r_0) = d_z - (r_0 d_x + r_1 d_y) r_2 / (r_0^2 + r_1^2)

The four are whitened together by W, W'W = C^-1. Prior knowledge of a frame's position enters as
five observations of p.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedControl,
    AdjustedFrame,
)
from solmap.photogrammetry.adjustment.model.collinearity import State
from solmap.photogrammetry.adjustment.model.network import FRAME_UNKNOWNS, MAP, Network, StopControl
from solmap.photogrammetry.arrays import Bool, Float64, Int32

ROWS = 4
"""Observations of a stop: east, north, up and azimuth."""


@dataclass(frozen=True, slots=True, eq=False)
class Control:
    """The control of a network as arrays."""

    stop: Int32[np.ndarray, " n"]
    frame: Int32[np.ndarray, " n"]
    values: Float64[np.ndarray, "n 4"]
    """East, north, up (m) and azimuth (rad) in the frame; zero where not observed."""
    whiten: Float64[np.ndarray, "n 4 4"]
    """W; rows and columns of zeros for what is not observed."""
    is_given: Bool[np.ndarray, "n 4"]
    used: Bool[np.ndarray, " n"]
    """Control that is not set aside as blunders."""
    centres: Float64[np.ndarray, "frames 2"]
    """Centre about which frames are rotated, (east, north)."""
    likely: Float64[np.ndarray, "frames 5"]
    prior: Float64[np.ndarray, "frames 5 5"]
    """Whitens the prior of each frame's position."""
    is_free: Bool[np.ndarray, "frames 5"]
    is_datum: Bool[np.ndarray, " n"]
    """Which control observations define the map's origin; they are never tested."""

    @classmethod
    def of(cls, network: Network) -> Control:
        """All control of a network."""
        stops = {stop: k for k, stop in enumerate(network.stop_ids)}
        frames = {frame.name: k for k, frame in enumerate(network.frames)}
        control, count = network.control, len(network.frames)
        whiten, is_given = np.zeros((len(control), ROWS, ROWS)), np.zeros((len(control), ROWS))
        for k, one in enumerate(control):
            whiten[k], is_given[k] = _whitening(one)
        prior = np.zeros((count, FRAME_UNKNOWNS, FRAME_UNKNOWNS))
        for k, frame in enumerate(network.frames):
            prior[k] = _root_of_inverse(frame.covariance, np.array(frame.is_free))
        return cls(
            np.array([stops[one.stop] for one in control], dtype=np.int32),
            np.array([frames[one.frame] for one in control], dtype=np.int32),
            np.array([one.values for one in control]).reshape(-1, ROWS),
            whiten,
            is_given > 0,
            np.ones(len(control), dtype=bool),
            np.array([frame.centre_m for frame in network.frames], float).reshape(-1, 2),
            np.array([frame.place for frame in network.frames]).reshape(-1, FRAME_UNKNOWNS),
            prior,
            np.array([f.is_free for f in network.frames], dtype=bool).reshape(-1, FRAME_UNKNOWNS),
            np.array([one.frame == MAP.name for one in control], dtype=bool),
        )

    @property
    def surplus(self) -> int:
        """Redundancy: observations in use, those of frames too, minus the unknowns of frames."""
        return int(self.is_given[self.used].sum())

    def with_used(self, used: np.ndarray) -> Control:
        """The same equations with other control set aside."""
        return replace(self, used=used)

    def misclosures(self, state: State) -> Float64[np.ndarray, "n 4"]:
        """Observed minus computed east, north, up (m) and azimuth (rad); zero where not given."""
        p, R, c = state.frames[self.frame], state.rotations[self.stop], state.centres[self.stop]
        centre = self.centres[self.frame]
        arm, b, a = self.values[:, :2] - centre, p[:, 3], p[:, 4]
        l = np.empty((len(self.stop), ROWS))
        l[:, 0] = centre[:, 0] + arm[:, 0] * (1 + a) - arm[:, 1] * b + p[:, 0] - c[:, 1]
        l[:, 1] = centre[:, 1] + arm[:, 1] * (1 + a) + arm[:, 0] * b + p[:, 1] - c[:, 0]
        l[:, 2] = self.values[:, 2] + p[:, 2] + c[:, 2]
        off = self.values[:, 3] - np.arctan2(b, 1 + a) - np.arctan2(R[:, 1, 0], R[:, 0, 0])
        l[:, 3] = np.arctan2(np.sin(off), np.cos(off))
        return np.where(self.is_given, l, 0.0)

    def whitened_misclosures(self, state: State) -> Float64[np.ndarray, "n 4"]:
        """Misclosures in standard deviations."""
        return (self.whiten @ self.misclosures(state)[:, :, None])[:, :, 0]

    def partials(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Whitened derivatives (n, 4, 6) of what is computed by (d, dc), and (n, 4, 5) by dp."""
        R, p = state.rotations[self.stop], state.frames[self.frame]
        of_stop, of_frame = np.zeros((len(self.stop), ROWS, 6)), np.zeros((len(self.stop), ROWS, 5))
        of_stop[:, 0, 4] = of_stop[:, 1, 3] = 1.0
        of_stop[:, 2, 5] = -1.0
        level = R[:, 0, 0] ** 2 + R[:, 1, 0] ** 2
        of_stop[:, 3, :2] = -R[:, :2, 0] * (R[:, 2, 0] / level)[:, None]
        of_stop[:, 3, 2] = 1.0
        east, north = (self.values[:, :2] - self.centres[self.frame]).T
        of_frame[:, range(3), range(3)] = -1.0
        of_frame[:, 0, 3], of_frame[:, 0, 4] = north, -east
        of_frame[:, 1, 3], of_frame[:, 1, 4] = -east, -north
        b, a = p[:, 3], p[:, 4]
        size = (1 + a) ** 2 + b**2
        of_frame[:, 3, 3], of_frame[:, 3, 4] = (1 + a) / size, -b / size
        return self.whiten @ of_stop, self.whiten @ of_frame

    def prior_misclosures(self, state: State) -> Float64[np.ndarray, "frames 5"]:
        """Prior of the frames minus their present position, in standard deviations."""
        return (self.prior @ (self.likely - state.frames)[:, :, None])[:, :, 0]

    def fit_frames(self, state: State) -> Float64[np.ndarray, "frames 5"]:
        """Positions of the frames that fit the stops best."""
        start = replace(state, frames=self.likely)
        l = self.whitened_misclosures(start) * self.used[:, None]
        _, A = self.partials(start)
        N, n = self.prior.mT @ self.prior, np.zeros_like(self.likely)
        np.add.at(N, self.frame, A.mT @ A * self.used[:, None, None])
        np.add.at(n, self.frame, (A.mT @ l[:, :, None])[:, :, 0])
        places = self.likely.copy()
        for k, free in enumerate(self.is_free):
            places[k, free] += np.linalg.solve(N[k][np.ix_(free, free)], n[k, free])
        return places


def frame_places(
    adjusted: tuple[AdjustedFrame, ...], network: Network
) -> Float64[np.ndarray, "frames 5"]:
    """Positions of a network's frames: of the previous adjustment, or else the priors."""
    known = {frame.frame.name: frame.place for frame in adjusted}
    places = [known.get(frame.name, frame.place) for frame in network.frames]
    return np.array(places).reshape(-1, FRAME_UNKNOWNS)


def was_used(
    control: tuple[StopControl, ...], adjusted: tuple[AdjustedControl, ...]
) -> Bool[np.ndarray, " n"]:
    """Which control the previous adjustment used; control that it did not have counts as used."""
    refused = [one.control for one in adjusted if not one.used]
    return np.array([not any(one.is_same(no) for no in refused) for one in control], dtype=bool)


def _whitening(control: StopControl) -> tuple[np.ndarray, np.ndarray]:
    is_given = np.zeros(ROWS)
    given = np.array(control.components)
    is_given[given] = 1.0
    W = np.zeros((ROWS, ROWS))
    W[np.ix_(given, given)] = np.linalg.inv(np.linalg.cholesky(control.covariance))
    return W, is_given


def _root_of_inverse(covariance: np.ndarray, free: np.ndarray) -> np.ndarray:
    W = np.zeros_like(covariance)
    if free.any():
        inside = np.ix_(free, free)
        W[inside] = np.linalg.inv(np.linalg.cholesky(covariance[inside]))
    return W
