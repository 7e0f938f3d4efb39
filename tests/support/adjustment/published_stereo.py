"""A published stereo problem: the visual odometry factors that GTSAM ships as example data.

A line of factors is `camera point u_left u_right v X Y Z`, the last three in the camera's frame; a
line of poses `camera` and a 4 x 4 matrix world_from_camera, row by row; the calibration is
`fx fy skew u0 v0 base`. Cameras look along z, x to the right, y down, as here.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.adjustment.model.collinearity import Observations, State
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from tests.support.adjustment.problems import FIXED, RigProblem


def read_problem(folder, name):
    """The problem `VO_stereo_factors<name>.txt`; every camera is a stop with one rigid pair."""
    calibration = np.loadtxt(folder / f"VO_calibration{suffix(folder, name)}.txt").ravel()[:6]
    poses = np.loadtxt(folder / f"VO_camera_poses{name}.txt")
    factors = np.loadtxt(folder / f"VO_stereo_factors{name}.txt")
    matrices = poses[:, 1:].reshape(-1, 4, 4)
    number = {int(camera): k for k, camera in enumerate(poses[:, 0])}
    known = np.isin(factors[:, 0], poses[:, 0])
    factors = factors[known]
    pair = np.array([number[int(camera)] for camera in factors[:, 0]], dtype=np.int32)
    _, first, point = np.unique(factors[:, 1], return_index=True, return_inverse=True)
    focal, centre, base = calibration[0], calibration[3:5], calibration[5]
    left, right, line = factors[:, 2:5].T
    stops = len(matrices)
    observations = Observations(
        point=point.astype(np.int32).ravel(),
        pair=pair,
        measured=np.column_stack([(left + right) / 2, line, left - right]),
        weight=np.tile(np.sqrt([2.0, 2.0, 0.5]), (len(factors), 1)),
        pair_stop=np.arange(stops, dtype=np.int32),
        rover_from_pair=np.tile(np.eye(3), (stops, 1, 1)),
        origin_in_rover=np.tile([base / 2, 0.0, 0.0], (stops, 1)),
        pivot_in_rover=np.zeros((stops, 3)),
        focal_px=np.full(stops, focal),
        base_m=np.full(stops, base),
        centre_px=np.tile(centre, (stops, 1)),
        points=len(first),
    )
    R, c = orthonormal(matrices[:, :3, :3]), matrices[:, :3, 3].copy()
    places = c[pair[first]] + np.einsum("nij,nj->ni", R[pair[first]], factors[first, 5:8])
    start = State(R, c, np.zeros((stops, 3)), places)
    telemetry = Telemetry(R, c, np.zeros(stops, dtype=bool), np.zeros((stops, 6)), FIXED)
    return RigProblem(observations, telemetry, start)


def suffix(folder, name):
    """A problem without a calibration of its own has the common one."""
    return name if (folder / f"VO_calibration{name}.txt").exists() else ""


def orthonormal(matrices):
    """The nearest rotations: files carry six digits."""
    U, _, V = np.linalg.svd(matrices)
    return U @ V
