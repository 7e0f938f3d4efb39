"""The hard bar against the paper's way to hold it: two free images and heavy virtual observations.

Here every image has six unknowns of its own. That both images of a pair keep their places on the
bar, and the bar its place on the turned mast, is observed with very large weight (Di et al. 2008,
section 2). Derivatives are exact by complex steps, and all of it is dense and slow; where the
adjustment has its bar by construction, it must come to the same orientations.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import expm, qr, solve_triangular

from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.synthetic.networks import simulate_network

pytestmark = pytest.mark.slow

VIRTUAL_M, VIRTUAL_RAD = 1e-6, 1e-7
"""Standard deviations of the virtual observations: a millionth of what images can measure."""


@dataclass
class Reference:
    """Unknowns of the dense adjustment: motions into the LSL as 4 x 4 matrices, and points."""

    stops: np.ndarray
    turns: np.ndarray
    left: np.ndarray
    right: np.ndarray
    points: np.ndarray

    def corrected(self, x: np.ndarray) -> "Reference":
        """All unknowns after a correction; the first stop stays."""
        parts = np.split(x, np.cumsum(self.sizes)[:-1])
        stops, turns, left, right, points = parts
        moved = [self.stops[0], *map(moved_pose, self.stops[1:], stops.reshape(-1, 6))]
        return Reference(
            np.array(moved),
            np.array([*map(turned, self.turns, turns.reshape(-1, 3))]),
            np.array([*map(moved_pose, self.left, left.reshape(-1, 6))]),
            np.array([*map(moved_pose, self.right, right.reshape(-1, 6))]),
            self.points + points.reshape(-1, 3),
        )

    @property
    def sizes(self) -> list[int]:
        pairs = len(self.left)
        return [6 * (len(self.stops) - 1), 3 * pairs, 6 * pairs, 6 * pairs, 3 * len(self.points)]


def cross(v):
    return np.array([[0 * v[0], -v[2], v[1]], [v[2], 0 * v[0], -v[0]], [-v[1], v[0], 0 * v[0]]])


def turned(R, d):
    return expm(cross(d)) @ R


def moved_pose(pose, d):
    moved = pose.astype(np.result_type(pose, d))
    moved[:3, :3] = turned(moved[:3, :3], d[:3])
    moved[:3, 3] += d[3:]
    return moved


def matrix(rotation, shift):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, shift
    return pose


def axis_of(R):
    """Rotation vector of a small rotation, to second order."""
    return np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2


def virtual(observed, requested):
    """Difference of two poses over the standard deviations of virtual observations."""
    turn = axis_of(requested[:3, :3].T @ observed[:3, :3]) / VIRTUAL_RAD
    shift = requested[:3, :3].T @ (observed[:3, 3] - requested[:3, 3]) / VIRTUAL_M
    return np.concatenate([turn, shift])


def nominal(network, state, k):
    """Where the left image of a pair is when it sits on its mast."""
    pair = network.pairs[k]
    label, pivot = pair.geometry.rover_from_pair, pair.geometry.pivot_in_rover
    turn = state.turns[k]
    stop = state.stops[network.stop_ids.index(pair.stop)]
    pose = np.eye(4, dtype=turn.dtype)
    pose[:3, :3] = turn @ label.rotation
    pose[:3, 3] = pivot + turn @ (label.translation_m - pivot)
    return stop @ pose


def residuals(network, params, state):
    """All residuals over their standard deviations."""
    ties = network.ties
    rows = []
    for k in range(len(ties)):
        j, X = ties.pair[k], state.points[ties.point[k]]
        shape = network.pairs[j].geometry
        y_l = state.left[j][:3, :3].T @ (X - state.left[j][:3, 3])
        y_r = state.right[j][:3, :3].T @ (X - state.right[j][:3, 3])
        f = shape.focal_px
        seen = shape.centre_px + f * y_l[:2] / y_l[2]
        p = f * y_l[0] / y_l[2] - f * y_r[0] / y_r[2]
        rows.append((ties.left[k] - seen) / ties.sigma_px[k])
        rows.append(np.array([(ties.parallax_px[k] - p) / ties.sigma_parallax_px[k]]))
    for k, pair in enumerate(network.pairs):
        on_bar = state.left[k] @ matrix(np.eye(3), [pair.geometry.base_m, 0.0, 0.0])
        rows.append(virtual(state.left[k], nominal(network, state, k)))
        rows.append(virtual(state.right[k], on_bar))
        rows.append(log_of(state.turns[k]) / np.radians(params.pointing_deg))
    steps = [telemetry(network, params, state, k) for k in range(1, len(network.stops))]
    return np.concatenate([*rows, *steps])


def log_of(R):
    """Rotation vector, exact for the small turns of a mast."""
    v = axis_of(R)
    sine = np.sqrt(v @ v)
    return v if sine == 0 else v * np.arcsin(sine) / sine


def telemetry(network, params, state, k):
    """Tilt, propagated azimuth and increment of a stop (module `telemetry`), written out again."""
    R, R_ = (state.stops[i][:3, :3] for i in (k, k - 1))
    T, T_ = (network.stops[i].lsl_from_rover for i in (k, k - 1))
    tilt = (T.rotation @ R[2])[:2] / np.radians(params.tilt_deg)
    twists = []
    for now, reported in ((R, T.rotation), (R_, T_.rotation)):
        M = now @ reported.T
        twists.append(np.arctan((M[1, 0] - M[0, 1]) / (M[0, 0] + M[1, 1])))
    azimuth = (twists[0] - twists[1]) / np.radians(params.azimuth_step_deg)
    driven = np.linalg.norm(T.translation_m - T_.translation_m)
    step = R_.T @ (state.stops[k][:3, 3] - state.stops[k - 1][:3, 3])
    step_ = T_.rotation.T @ (T.translation_m - T_.translation_m)
    sigma_m = params.slip * driven + params.position_floor_m
    return np.concatenate([tilt, [azimuth], (step - step_) / sigma_m])


def dense_adjustment(network, params, start):
    """Gauss-Newton with QR; the state and the covariance of all unknowns."""
    state = start
    for _ in range(12):
        n = sum(state.sizes)
        l = residuals(network, params, state)
        J = np.zeros((len(l), n))
        for k in range(n):
            step = np.zeros(n, dtype=complex)
            step[k] = 1e-30j
            J[:, k] = residuals(network, params, state.corrected(step)).imag / 1e-30
        Q, R = qr(J, mode="economic")
        x = -solve_triangular(R, Q.T @ l)
        state = state.corrected(x)
        if np.abs(x).max() < 1e-11:
            break
    inverse = solve_triangular(R, np.eye(n))
    return state, inverse @ inverse.T


@pytest.fixture(scope="module")
def both():
    from solmap.photogrammetry.adjustment.model.params import AdjustmentParams  # noqa: PLC0415

    params = AdjustmentParams(sigma_freedoms=np.inf, mast_deg=1e-7)
    network, truth = simulate_network(
        np.random.default_rng(7), stops=2, pairs_per_stop=10, spacing_m=8.0,
        cross_ties=6, far_cross_ties=0, inter_ties=8, intra_ties=0,
    )  # fmt: skip
    adjusted, report = adjust_overall(network, params)
    assert report.is_usable
    assert report.blunders == 0
    poses = [matrix(p.rotation, p.translation_m) for p in truth.lsl_from_rover]
    start = Reference(
        np.array(poses),
        np.array([np.eye(3)] * len(network.pairs)),
        np.zeros((0, 4, 4)),
        np.zeros((0, 4, 4)),
        truth.points,
    )
    left = [nominal(network, start, k) for k in range(len(network.pairs))]
    bars = [matrix(np.eye(3), [p.geometry.base_m, 0, 0]) for p in network.pairs]
    start.left, start.right = np.array(left), np.array(left) @ np.array(bars)
    start.stops[0] = matrix(*pose_of(network.stops[0].lsl_from_rover))
    return network, adjusted, *dense_adjustment(network, params, start)


def pose_of(pose):
    return pose.rotation, pose.translation_m


def turn_between(one, other):
    return np.linalg.norm(axis_of(one.T @ other))


def test_free_images_with_virtual_observations_agree_with_rigid_baselines(both):
    network, adjusted, state, _ = both
    assert len(network.ties) > 30
    for k, pair in enumerate(network.pairs):
        pose = adjusted.pair(pair.pair_id).lsl_from_pair
        assert np.linalg.norm(state.left[k][:3, 3] - pose.translation_m) < 1e-6
        assert turn_between(state.left[k][:3, :3], pose.rotation) < 1e-6
        right = pose.translation_m + pose.rotation[:, 0] * pair.geometry.base_m
        assert np.linalg.norm(state.right[k][:3, 3] - right) < 1e-6


def test_stops_and_their_covariances_agree_with_rigid_baselines(both):
    network, adjusted, state, covariance = both
    stop = adjusted.stop(network.stop_ids[1])
    assert np.linalg.norm(state.stops[1][:3, 3] - stop.lsl_from_rover.translation_m) < 1e-6
    assert turn_between(state.stops[1][:3, :3], stop.lsl_from_rover.rotation) < 1e-7
    scale = np.sqrt(np.outer(np.diagonal(stop.covariance), np.diagonal(stop.covariance)))
    np.testing.assert_allclose(covariance[:6, :6] / scale, stop.covariance / scale, atol=1e-4)
