"""The whole model in GTSAM: mast pointings and telemetry besides the images, the first stop held.

A mast head is a pose of its own, turned against its stop by the pointing; images are connected to
it by stereo factors, and a between factor states no rotation, with the standard deviation of
pointing, and a shift of a micrometre. Telemetry is modelled here independently as functions of
poses with
numeric derivatives, not taken from the adjustment.
"""

from __future__ import annotations

import gtsam
import numpy as np

from solmap.photogrammetry.adjustment.model.small_matrices import rotation_of_vector
from tests.support.adjustment.gtsam_peer import optimised, point_key, stop_key
from tests.support.adjustment.problems import shared_rows

FIXED_M = 1e-6
"""A mast head does not shift; a micrometre is a thousandth of what the nearest point shows."""
STEP = 1e-6


def head_key(k):
    return gtsam.symbol("h", k)


def graph_of(problem):
    """Factors and initial values of a problem with telemetry."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    add_images(graph, problem)
    add_masts(graph, problem)
    add_telemetry(graph, problem.telemetry)
    observations, start = problem.observations, problem.start
    for k, (R, c) in enumerate(zip(start.rotations, start.centres, strict=True)):
        values.insert(stop_key(k), gtsam.Pose3(gtsam.Rot3(R), c))
    turns = rotation_of_vector(start.pointings)
    for k, (stop, E) in enumerate(zip(observations.pair_stop.tolist(), turns, strict=True)):
        head = gtsam.Pose3(gtsam.Rot3(E), observations.pivot_in_rover[k])
        values.insert(head_key(k), values.atPose3(stop_key(stop)).compose(head))
    for point in np.unique(observations.point[shared_rows(observations)]).tolist():
        values.insert(point_key(point), start.points[point])
    return graph, values


def adjusted(problem, most_iterations=100):
    """Levenberg and Marquardt's method; by QR, since the heads' places are so much more certain."""
    graph, values = graph_of(problem)
    graph.add(gtsam.NonlinearEqualityPose3(stop_key(0), values.atPose3(stop_key(0))))
    return optimised(graph, values, most_iterations, "MULTIFRONTAL_QR")


def covariances(problem, state):
    """Covariances (stops, 6, 6) of rotation vector and position in the LSL; zero where held.

    By dense QR of GTSAM's own linear equations, stops last: its marginals go by Cholesky, which the
    certain places of the heads make singular.
    """
    graph, values = graph_of(problem.from_state(state))
    ordering, stops = gtsam.Ordering(), [stop_key(k) for k in range(len(state.centres))]
    for key in [*(key for key in values.keys() if key not in stops), *stops[1:], stops[0]]:  # noqa: SIM118
        ordering.push_back(key)
    A, _ = graph.linearize(values).jacobian(ordering)
    R = np.linalg.qr(A[:, :-6], mode="r")  # the first stop, last, is held
    size = 6 * (len(stops) - 1)
    back = np.linalg.inv(R[-size:, -size:])
    C = back @ back.T
    found = np.zeros((len(stops), 6, 6))
    for k in range(1, len(stops)):
        own = slice(6 * k - 6, 6 * k)
        to_lsl = np.kron(
            np.eye(2), state.rotations[k]
        )  # GTSAM turns and shifts in the pose's frame
        found[k] = to_lsl @ C[own, own] @ to_lsl.T
    return found


def add_images(graph, problem):
    """Left sample, right sample and line; errors of sample and parallax share the right sample."""
    observations = problem.observations
    for row in shared_rows(observations).tolist():
        pair = int(observations.pair[row])
        (x, y, p), sigma = observations.measured[row], 1.0 / observations.weight[row]
        C = np.diag([sigma[0], np.hypot(sigma[0], sigma[2]), sigma[1]]) ** 2
        C[0, 1] = C[1, 0] = sigma[0] ** 2
        f, base = float(observations.focal_px[pair]), float(observations.base_m[pair])
        lever = observations.origin_in_rover[pair] - observations.pivot_in_rover[pair]
        graph.add(
            gtsam.GenericStereoFactor3D(
                gtsam.StereoPoint2(x, x - p, y), gtsam.noiseModel.Gaussian.Covariance(C),
                head_key(pair), point_key(int(observations.point[row])),
                gtsam.Cal3_S2Stereo(f, f, 0.0, *observations.centre_px[pair].tolist(), base),
                gtsam.Pose3(gtsam.Rot3(observations.rover_from_pair[pair]), lever),
            )
        )  # fmt: skip


def add_masts(graph, problem):
    sigma = 1.0 / problem.telemetry.pointing_weight
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([sigma, FIXED_M], 3))
    for k, stop in enumerate(problem.observations.pair_stop.tolist()):
        straight = gtsam.Pose3(gtsam.Rot3(), problem.observations.pivot_in_rover[k])
        graph.add(gtsam.BetweenFactorPose3(stop_key(stop), head_key(k), straight, noise))


def add_telemetry(graph, telemetry):
    """Tilt of every stop, and azimuth and step from the stop before."""
    if telemetry.is_fine.any():
        raise ValueError("no azimuth of a problem for GTSAM may be measured (FINE)")
    for k in range(1, len(telemetry.centres)):
        reported = telemetry.rotations[k - 1 : k + 1], telemetry.centres[k - 1 : k + 1]
        for keys, error, weight in (
            ([stop_key(k)], tilt_from(reported[0][1]), telemetry.weight[k, :2]),
            ([stop_key(k - 1), stop_key(k)], step_from(*reported), telemetry.weight[k, 2:]),
        ):
            noise = gtsam.noiseModel.Diagonal.Sigmas(1.0 / weight)
            graph.add(gtsam.CustomFactor(noise, gtsam.KeyVector(keys), differentiated(error)))


def tilt_from(reported):
    """Horizontal part of down, in the level that telemetry reports."""
    return lambda poses: (reported @ poses[0].rotation().matrix().T)[:2, 2]


def step_from(rotations, centres):
    """Azimuth against the change that telemetry reports, and drive in the rover before."""
    drive = rotations[0].T @ (centres[1] - centres[0])

    def error(poses):
        turns = [p.rotation().matrix() @ R.T for p, R in zip(poses, rotations, strict=True)]
        a, b = (np.arctan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1]) for M in turns)
        driven = poses[0].rotation().matrix().T @ (poses[1].translation() - poses[0].translation())
        return np.append(np.arctan2(np.sin(b - a), np.cos(b - a)), driven - drive)

    return error


def differentiated(error):
    """An error of poses in the form that GTSAM requires, derivatives by central differences."""

    def with_jacobians(factor, values, jacobians):
        poses = [values.atPose3(key) for key in factor.keys()]  # noqa: SIM118 - not a dictionary
        if jacobians is not None:
            for i, pose in enumerate(poses):
                columns = []
                for unit in STEP * np.eye(6):
                    ends = [
                        error([*poses[:i], pose.retract(move), *poses[i + 1 :]])
                        for move in (unit, -unit)
                    ]
                    columns.append((ends[0] - ends[1]) / (2 * STEP))
                jacobians[i] = np.asfortranarray(np.column_stack(columns))
        return error(poses)

    return with_jacobians
