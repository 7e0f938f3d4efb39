"""The same problem in GTSAM: stereo factors on rigid bodies, the first one held."""

from __future__ import annotations

import time

import gtsam
import numpy as np

from tests.support.adjustment.problems import Peer, shared_rows

SIGMAS = np.array([1.0, 1.0, np.sqrt(0.5)])
"""Of left sample, right sample and line, which counts once where left and right lines are two."""


def stop_key(k):
    return gtsam.symbol("s", k)


def point_key(k):
    return gtsam.symbol("p", k)


def graph_of(problem):
    """Factors and initial values."""
    observations, start = problem.observations, problem.start
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Diagonal.Sigmas(SIGMAS)
    cameras = [left_camera(observations, k) for k in range(len(observations.pair_stop))]
    rows = shared_rows(observations)
    for row in rows.tolist():
        pair = int(observations.pair[row])
        body_from_camera, calibration = cameras[pair]
        x, y, p = observations.measured[row]
        graph.add(
            gtsam.GenericStereoFactor3D(
                gtsam.StereoPoint2(x + p / 2, x - p / 2, y), noise,
                stop_key(int(observations.pair_stop[pair])),
                point_key(int(observations.point[row])), calibration, body_from_camera,
            )
        )  # fmt: skip
    for k, (R, c) in enumerate(zip(start.rotations, start.centres, strict=True)):
        values.insert(stop_key(k), gtsam.Pose3(gtsam.Rot3(R), c))
    for point in np.unique(observations.point[rows]).tolist():
        values.insert(point_key(point), start.points[point])
    graph.add(gtsam.NonlinearEqualityPose3(stop_key(0), values.atPose3(stop_key(0))))
    return graph, values


def left_camera(observations, pair):
    """Its pose in the rover, and the calibration of both cameras."""
    R, f = observations.rover_from_pair[pair], float(observations.focal_px[pair])
    base = float(observations.base_m[pair])
    centre = observations.origin_in_rover[pair] - R[:, 0] * base / 2
    calibration = gtsam.Cal3_S2Stereo(f, f, 0.0, *observations.centre_px[pair].tolist(), base)
    return gtsam.Pose3(gtsam.Rot3(R), centre), calibration


def adjusted(problem, most_iterations=100):
    """Levenberg and Marquardt's method as GTSAM has it; the time is that of the optimiser alone."""
    return optimised(*graph_of(problem), most_iterations)


def optimised(graph, values, most_iterations, factorisation="MULTIFRONTAL_CHOLESKY"):
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(most_iterations)
    params.setLinearSolverType(factorisation)
    params.setRelativeErrorTol(1e-9)
    params.setAbsoluteErrorTol(1e-9)
    optimiser = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    begin = time.process_time()
    found = optimiser.optimize()
    seconds = time.process_time() - begin
    reported = f"{optimiser.iterations()} iterations"
    return Peer(2 * graph.error(found), seconds, reported)


def covariances(problem, state):
    """Covariances (stops, 6, 6) of rotation vector and position in the LSL at a state."""
    graph, values = graph_of(problem.from_state(state))
    begin = time.process_time()
    marginals = gtsam.Marginals(graph, values)
    found = np.zeros((len(state.centres), 6, 6))
    for k, R in enumerate(state.rotations):
        # GTSAM turns and shifts a pose in its own frame: R Exp(w), c + R v
        to_lsl = np.kron(np.eye(2), R)
        found[k] = to_lsl @ marginals.marginalCovariance(stop_key(k)) @ to_lsl.T
    return found, time.process_time() - begin
