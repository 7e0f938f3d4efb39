"""Initial values: stop by stop, a rigid alignment on what earlier stops have seen.

Telemetry may be metres and degrees off; image rays from there do not meet. But the points that
two stops triangulated from the same features differ by one rigid motion (paper, section 3.2), so
each stop in turn is laid onto the earlier ones: minimise over its pose (R, c)

    sum_i w_i e_i' S_i^-1 e_i + telemetry (tilt, azimuth, increment)     e_i = X_i - (R Y_i + c)

with X_i the place that an earlier stop gives the point (LSL), Y_i the place in the rover frame of
the new stop, and S_i the sum of their covariances: image coordinates, range (which dominates),
and the mast pointing of both. Wrong ties are weighed down by graduated non-convexity (Yang et al.
2020) with the truncated least-squares loss: w_i = 1 below, 0 above, and in between

    w_i = g sqrt(mu (mu + 1)) / r_i - mu,      r_i^2 = e_i' S_i^-1 e_i,  g the gate

with mu raised from nearly convex to the step function. No random sampling: the same network gives
the same start. A stop without cross-site ties is carried along by its telemetry increment.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from photogrammetry.adjustment.collinearity import Observations, State, triangulated_in_pair
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.priors import (
    Telemetry,
    telemetry_misclosures,
    telemetry_partials,
)
from photogrammetry.adjustment.rotations import cross_matrix, rotation_of_vector

GROWTH = 2.0
"""Factor by which the loss is sharpened a round; 1.4 in the publication, for far worse outliers."""
ROUNDS = 60
UNCHECKED_TIES = 3
"""So many ties place a stop without checking one another; telemetry must not contradict them."""
HALF = 0.5
"""Weights end at 0 or 1; this tells them apart."""
SHARP = 1e3
"""Where mu ends: weights between 0 and 1 are then left only within 0.1 % of the gate."""


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Every observation's own point in its rover frame, with covariance; which may align."""

    points: np.ndarray
    covariances: np.ndarray
    usable: np.ndarray
    size: np.ndarray
    """Sum of the three variances, square metres."""


def sightings(
    observations: Observations, pointings: np.ndarray, params: AdjustmentParams
) -> Sightings:
    """Triangulate every observation by itself in the frame of its rover."""
    j = observations.pair
    in_pair = triangulated_in_pair(observations)
    turned = (rotation_of_vector(pointings) @ observations.rover_from_pair)[j]
    arm = (turned @ in_pair[:, :, None])[:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = 1.0 / observations.weight
        along = in_pair / observations.measured[:, 2:] * sigma[:, 2:]
        across = (in_pair[:, 2] * sigma[:, 0] / observations.focal_px[j]) ** 2
    S = along[:, :, None] * along[:, None, :]
    S[:, 0, 0] += across
    S[:, 1, 1] += across
    lever = cross_matrix(arm) * np.radians(params.pointing_deg)
    S = turned @ S @ turned.swapaxes(1, 2) + lever @ lever.swapaxes(1, 2)
    usable = observations.is_stereo & (observations.measured[:, 2] >= params.far_parallax_px)
    size = np.trace(S, axis1=1, axis2=2)
    return Sightings(observations.origins_in_rover(pointings)[j] + arm, S, usable, size)


def initialise(
    observations: Observations,
    telemetry: Telemetry,
    held: np.ndarray,
    params: AdjustmentParams,
    known: State,
    is_known: np.ndarray,
) -> tuple[State, np.ndarray]:
    """Poses of all stops, points, and which observations fit (False: grossly off).

    Stops that `is_known` or `held` keep the pose they have in `known`; the others are aligned.
    """
    seen = sightings(observations, known.pointings, params)
    state, fits = known, np.ones(len(observations), dtype=bool)
    best = _best_sightings(observations, seen, len(held))
    rows_of_stop = np.split(
        np.argsort(observations.stop, kind="stable"),
        np.cumsum(np.bincount(observations.stop, minlength=len(held)))[:-1],
    )
    earlier = np.full(observations.points, -1)
    for k, ours in enumerate(best):
        points = observations.point[ours]
        if not (held[k] or is_known[k]):
            state = _carried(state, telemetry, k)
            shared = earlier[points] >= 0
            ties = RigidTies.of(state, observations, seen, ours[shared], earlier[points[shared]])
            state, weights = _aligned(state, telemetry, k, ties, params)
            wrong = points[shared][weights < HALF]
            rows = rows_of_stop[k]
            fits[rows[np.isin(observations.point[rows], wrong)]] = False
        fresh = (earlier[points] < 0) | (seen.size[ours] < seen.size[earlier[points]])
        fresh &= fits[ours]
        earlier[points[fresh]] = ours[fresh]
    return with_points(state, observations, seen, fits), fits


def _best_sightings(observations: Observations, seen: Sightings, stops: int) -> list[np.ndarray]:
    """For each stop its observations that may align, the best one of each point."""
    rows = np.flatnonzero(seen.usable)
    stop, point = observations.stop[rows], observations.point[rows]
    order = np.lexsort((seen.size[rows], point, stop))
    rows, stop, point = rows[order], stop[order], point[order]
    first = np.ones(len(rows), dtype=bool)
    first[1:] = (point[1:] != point[:-1]) | (stop[1:] != stop[:-1])
    ends = np.searchsorted(stop[first], np.arange(stops + 1))
    return [rows[first][a:b] for a, b in pairwise(ends.tolist())]


def carried(state: State, telemetry: Telemetry, held: np.ndarray, is_known: np.ndarray) -> State:
    """The state with every other stop where telemetry leads from the stop before."""
    for k in np.flatnonzero(~(held | is_known)).tolist():
        state = _carried(state, telemetry, k)
    return state


def _carried(state: State, telemetry: Telemetry, k: int) -> State:
    """Put stop k where its telemetry increment leads from the stop before."""
    rotations, centres = state.rotations.copy(), state.centres.copy()
    rotations[k] = telemetry.rotations[k]
    centres[k] = telemetry.centres[k]
    if k:
        change = rotations[k - 1] @ telemetry.rotations[k - 1].T
        azimuth = np.arctan2(change[1, 0] - change[0, 1], change[0, 0] + change[1, 1])
        if not telemetry.is_fine[k]:
            rotations[k] = rotation_of_vector(np.array([0.0, 0.0, azimuth])) @ rotations[k]
        step = telemetry.centres[k] - telemetry.centres[k - 1]
        centres[k] = centres[k - 1] + change @ step
    return State(rotations, centres, state.pointings, state.points)


@dataclass(frozen=True, slots=True, eq=False)
class RigidTies:
    """Points that earlier stops place in the LSL and a new stop in its own rover frame."""

    X: np.ndarray
    S_X: np.ndarray
    Y: np.ndarray
    S_Y: np.ndarray

    @classmethod
    def of(
        cls,
        state: State,
        observations: Observations,
        seen: Sightings,
        ours: np.ndarray,
        theirs: np.ndarray,
    ) -> RigidTies:
        """The ties of observations `ours` of the new stop with `theirs` of earlier ones."""
        stop = observations.stop[theirs]
        R = state.rotations[stop]
        return cls(
            state.centres[stop] + (R @ seen.points[theirs][:, :, None])[:, :, 0],
            R @ seen.covariances[theirs] @ R.swapaxes(1, 2),
            seen.points[ours],
            seen.covariances[ours],
        )


def _aligned(
    state: State, telemetry: Telemetry, k: int, ties: RigidTies, params: AdjustmentParams
) -> tuple[State, np.ndarray]:
    """The state with stop k laid onto the others, and the weight (0..1) of each of its ties."""
    weights = np.ones(len(ties.X))
    if not len(weights):
        return state, weights
    gate, mu, state_before = params.gross, 0.0, state
    for _ in range(ROUNDS):
        state, r = _align_step(state, telemetry, k, ties, weights)
        if not mu:
            mu = gate**2 / max(2 * float(r.max()) ** 2 - gate**2, 1e-9)
        old, weights = weights, _truncated(r, gate, mu)
        if mu >= SHARP or (r.max() <= gate and np.abs(weights - old).max() < 1.0 / SHARP):
            break
        mu *= GROWTH
    aligned = _align_step(state, telemetry, k, ties, weights)[0]
    if (weights > HALF).sum() <= UNCHECKED_TIES and _telemetry_misfit(aligned, telemetry, k) > gate:
        return state_before, np.zeros(len(ties.X))
    return aligned, weights


def _telemetry_misfit(state: State, telemetry: Telemetry, k: int) -> float:
    """How far stop k is from its telemetry, in standard deviations."""
    both = np.array([max(k - 1, 0), k])
    link = telemetry.of_stops(both)
    off = telemetry_misclosures(state.of_stops(both), link)[1] * link.weight[1]
    return float(np.linalg.norm(off))


def _truncated(r: np.ndarray, gate: float, mu: float) -> np.ndarray:
    """Weights of the truncated least-squares loss as far as it is sharpened by now."""
    with np.errstate(divide="ignore"):
        between = gate * np.sqrt(mu * (mu + 1)) / r - mu
    return np.clip(between, 0.0, 1.0)


def _align_step(
    state: State,
    telemetry: Telemetry,
    k: int,
    ties: RigidTies,
    weights: np.ndarray,
) -> tuple[State, np.ndarray]:
    """One Gauss-Newton step of the alignment, and the standardised misfit of each tie after it."""
    X, S_X, Y, S_Y = ties.X, ties.S_X, ties.Y, ties.S_Y
    R = state.rotations[k]
    turned = Y @ R.T
    e = X - turned - state.centres[k]
    P = np.linalg.inv(S_X + R @ S_Y @ R.T)
    A = np.concatenate([-cross_matrix(turned), np.broadcast_to(np.eye(3), (len(Y), 3, 3))], axis=2)
    PA = P @ A * weights[:, None, None]
    both = np.array([max(k - 1, 0), k])
    link, ends = telemetry.of_stops(both), state.of_stops(both)
    l = telemetry_misclosures(ends, link)[1] * link.weight[1]
    T = telemetry_partials(ends, link)[1, :, 6:] * link.weight[1][:, None]
    N = np.einsum("nij,nik->jk", A, PA) + T.T @ T
    n = np.einsum("nij,ni->j", PA, e) + T.T @ l
    x = np.linalg.solve(N + 1e-12 * np.eye(6) * np.trace(N), n)
    rotations, centres = state.rotations.copy(), state.centres.copy()
    rotations[k] = rotation_of_vector(x[:3]) @ R
    centres[k] = centres[k] + x[3:]
    new = X - Y @ rotations[k].T - centres[k]
    r = np.sqrt((new * (P @ new[:, :, None])[:, :, 0]).sum(axis=1))
    return State(rotations, centres, state.pointings, state.points), r


def with_points(
    state: State, observations: Observations, seen: Sightings, used: np.ndarray
) -> State:
    """The state with every point at the weighted mean of its used sightings; NaN if none can.

    The weights are the inverse covariances of the sightings, so rays of several stops intersect
    here although each sighting alone is poor in range.
    """
    rows = np.flatnonzero(used & observations.is_stereo)
    stop, number = observations.stop[rows], observations.point[rows]
    R = state.rotations[stop]
    place = state.centres[stop] + (R @ seen.points[rows][:, :, None])[:, :, 0]
    P = np.linalg.inv(R @ seen.covariances[rows] @ R.swapaxes(1, 2))
    N, n = np.zeros((observations.points, 3, 3)), np.zeros((observations.points, 3))
    np.add.at(N, number, P)
    np.add.at(n, number, (P @ place[:, :, None])[:, :, 0])
    points = np.full((observations.points, 3), np.nan)
    placed = np.unique(number)
    points[placed] = np.linalg.solve(N[placed], n[placed][:, :, None])[:, :, 0]
    return State(state.rotations, state.centres, state.pointings, points)
