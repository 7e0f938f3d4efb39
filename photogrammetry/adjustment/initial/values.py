"""Initial values of stops and points.

**Stops.** Telemetry may be metres and degrees off; image rays from there do not meet. But the
points that two stops triangulated from the same features differ by one rigid motion (Di et al.
2008, section 3.2), so each stop in turn is aligned with the earlier ones: minimise over its pose
(R, c)

    sum_i w_i e_i' S_i^-1 e_i + telemetry (tilt, azimuth, increment)     e_i = X_i - (R Y_i + c)

with X_i the point as placed by an earlier stop (LSL), Y_i the point in the rover frame of the new
stop, and S_i the sum of their covariances: image coordinates, range (the largest part), and the
mast pointing of both. Wrong ties are down-weighted as in `alignment`. A stop without cross-site
ties follows its telemetry increment. While there are ties with stops up to `REACH` back, only these
count: at ground revisited later the drift since then has to be removed first, which is loop closure
(`loops`).

**Points that only single images see.** An observation without parallax is a ray, origin o and unit
direction u in the LSL. The point X of two or more rays minimises the sum of its squared distances
from them,

    sum_i (I - u_i u_i') (X - o_i) = 0

The cameras of a panorama's images are centimetres apart, so pointing errors of 0.1 degrees make the
rays of far points diverge. A point that would lie behind the cameras or further than
`FURTHEST_BASES` times the distance between them is set to that distance along the mean direction;
points are adjusted by their inverse depth, so the adjustment converges from there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.initial.alignment import (
    GROSS,
    HALF,
    ROUNDS,
    Misfit,
    RigidPoints,
    TruncatedLoss,
)
from solmap.photogrammetry.adjustment.initial.loops import REACH, close_loops
from solmap.photogrammetry.adjustment.model.collinearity import (
    Observations,
    State,
    Views,
    pair_orientations,
)
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.sightings import Overview, weighted_mean_points
from solmap.photogrammetry.adjustment.model.small_matrices import rotation_of_vector
from solmap.photogrammetry.adjustment.model.telemetry import (
    Telemetry,
    telemetry_misclosures,
    telemetry_partials,
)
from solmap.photogrammetry.arrays import Flags, Float64

UNCHECKED_TIES = 3
"""This many ties determine a pose without checking each other; telemetry must not contradict
them."""


FURTHEST_BASES = 1000.0
"""Distance in baselines at which the parallax of a Navcam is one pixel."""
LEAST_BASE_M = 1e-3
STIFFNESS = 1e-13
"""Keeps the system of parallel rays solvable; their points are set to the furthest distance."""


def initialise(  # noqa: PLR0913, PLR0917 - the network, where it stands, and what is seen of it
    observations: Observations,
    telemetry: Telemetry,
    held: np.ndarray,
    params: AdjustmentParams,
    known: State,
    is_known: np.ndarray,
    overview: Overview | None = None,
) -> tuple[State, Views, np.ndarray]:
    """Initial poses of all stops and points, what is seen from there, and which observations fit.

    Stops that `is_known` or `held` keep the pose they have in `known`; the others are aligned.
    """
    overview = overview or Overview.of(observations, known.pointings, len(held), params)
    seen, best = overview.seen, overview.best
    state, fits = known, np.ones(len(observations), dtype=bool)
    rows_of_stop = np.split(
        np.argsort(observations.stop, kind="stable"),
        np.cumsum(np.bincount(observations.stop, minlength=len(held)))[:-1],
    )
    earlier = np.full(observations.points, -1)
    for k, ours in enumerate(best):
        points = observations.point[ours]
        if not (held[k] or is_known[k]):
            state = _propagate_stop(state, telemetry, k)
            shared = earlier[points] >= 0
            recent = shared & (observations.stop_of(earlier[points]) >= k - REACH)
            shared = recent if recent.any() else shared
            theirs = earlier[points[shared]]
            ties = RigidPoints(*overview.in_lsl(state, theirs), *overview.in_rover(ours[shared]))
            state, weights = _align(state, telemetry, k, ties)
            wrong = points[shared][weights < HALF]
            rows = rows_of_stop[k]
            fits[rows[np.isin(observations.point[rows], wrong)]] = False
        fresh = (earlier[points] < 0) | (seen.size[ours] < seen.size[earlier[points]])
        fresh |= observations.stop_of(earlier[points]) < k - REACH
        fresh &= fits[ours]
        earlier[points[fresh]] = ours[fresh]
    state, contradicting = close_loops(state, telemetry, held, overview)
    fits[contradicting] = False
    views = Views.of(state, observations)
    points = weighted_mean_points(views, observations, seen, fits)
    return replace(state, points=points), views.at(points.T.copy()), fits


def propagate_telemetry(
    state: State, telemetry: Telemetry, held: np.ndarray, is_known: np.ndarray
) -> State:
    """The state with every other stop moved to where telemetry puts it from the stop before."""
    for k in np.flatnonzero(~(held | is_known)).tolist():
        state = _propagate_stop(state, telemetry, k)
    return state


def _propagate_stop(state: State, telemetry: Telemetry, k: int) -> State:
    """Move stop k to where its telemetry increment leads from the stop before."""
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
    return replace(state, rotations=rotations, centres=centres)


def _align(
    state: State, telemetry: Telemetry, k: int, ties: RigidPoints
) -> tuple[State, np.ndarray]:
    """The state with stop k aligned to the others, and the weight (0..1) of each of its ties."""
    loss = TruncatedLoss(np.ones(len(ties.X)))
    if not len(loss.weights):
        return state, loss.weights
    state_before = state
    link = telemetry.of_stops(_with_the_stop_before(k))
    misfit = ties.misfit(state.rotations[k], state.centres[k])
    for _ in range(ROUNDS):
        state = _align_step(state, link, k, misfit, loss.weights)
        misfit = ties.misfit(state.rotations[k], state.centres[k])
        loss = loss.sharpen(misfit.standardised, GROSS)
        if loss.is_settled:
            break
    aligned = _align_step(state, link, k, misfit, loss.weights)
    unchecked = (loss.weights > HALF).sum() <= UNCHECKED_TIES
    if unchecked and _telemetry_misfit(aligned, link, k) > GROSS:
        return state_before, np.zeros(len(ties.X))
    return aligned, loss.weights


def _with_the_stop_before(k: int) -> np.ndarray:
    return np.array([max(k - 1, 0), k])


def _telemetry_misfit(state: State, link: Telemetry, k: int) -> float:
    """Deviation of stop k from its telemetry increments, in standard deviations."""
    ends = state.of_stops(_with_the_stop_before(k))
    return float(np.linalg.norm(telemetry_misclosures(ends, link)[1] * link.weight[1]))


def _align_step(
    state: State, link: Telemetry, k: int, misfit: Misfit, weights: np.ndarray
) -> State:
    """One Gauss-Newton step of the alignment, from a state and its misfit."""
    N, n = misfit.normals(weights)
    ends = state.of_stops(_with_the_stop_before(k))
    l = telemetry_misclosures(ends, link)[1] * link.weight[1]
    T = telemetry_partials(ends, link)[1, :, 6:] * link.weight[1][:, None]
    N, n = N + T.T @ T, n + T.T @ l
    x = np.linalg.solve(N + 1e-12 * np.eye(6) * np.trace(N), n)
    rotations, centres = state.rotations.copy(), state.centres.copy()
    rotations[k] = rotation_of_vector(x[:3]) @ rotations[k]
    centres[k] = centres[k] + x[3:]
    return replace(state, rotations=rotations, centres=centres)


def intersect_rays(state: State, observations: Observations, used: Flags) -> State:
    """The state with every unplaced point of two or more used observations intersected."""
    lost = ~np.isfinite(state.points).all(axis=1)
    rows = np.flatnonzero(used & lost[observations.point])
    count = np.bincount(observations.point[rows], minlength=observations.points)
    rows = rows[count[observations.point[rows]] > 1]
    if not len(rows):
        return state
    origins, rays = _rays(state, observations, rows)
    number, of = np.unique(observations.point[rows], return_inverse=True)
    shape = (len(number), 3)
    centre, mean, reach = np.zeros(shape), np.zeros(shape), np.full(len(number), LEAST_BASE_M)
    np.add.at(centre, of, origins)
    centre /= np.bincount(of)[:, None]
    np.add.at(mean, of, rays)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    np.maximum.at(reach, of, 2.0 * np.linalg.norm(origins - centre[of], axis=1))
    N, n = np.tile(STIFFNESS * np.eye(3), (len(number), 1, 1)), np.zeros(shape)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    np.add.at(N, of, across)
    np.add.at(n, of, (across @ (origins - centre[of])[:, :, None])[:, :, 0])
    away = np.linalg.solve(N, n[:, :, None])[:, :, 0]
    depth, furthest = (away * mean).sum(axis=1), reach * FURTHEST_BASES
    bad = (depth <= 0) | (depth > furthest)
    points = state.points.copy()
    points[number] = centre + np.where(bad[:, None], furthest[:, None] * mean, away)
    return replace(state, points=points)


def _rays(
    state: State, observations: Observations, rows: np.ndarray
) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, "m 3"]]:
    """Origin and unit direction of some observations, in the LSL."""
    rotations, origins = pair_orientations(state, observations)
    j = observations.pair[rows]
    plane = observations.measured[rows, :2] - observations.centre_px[j]
    rays = np.column_stack([plane / observations.focal_px[j, None], np.ones(len(rows))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return origins[j], (rotations[j] @ rays[:, :, None])[:, :, 0]
