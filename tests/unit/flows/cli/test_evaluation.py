"""Errors against the truth are stated in metres, of the way, and in stated standard deviations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.flows.cli.evaluation import TrueStop, evaluate_positions

SIGMAS = np.array([1e-3, 1e-3, 2e-3, 0.02, 0.03, 0.01])
"""Of rotation vector (radians) and position (metres)."""


def row(drive, place, turn=(0.0, 0.0, 0.0), *, held=False):
    quaternion = Rotation.from_rotvec(turn).as_quat(scalar_first=True)
    return {
        "site": 1,
        "drive": drive,
        "stop": f"mer2-site0001-drive{drive:04d}",
        "telemetry_ned_m": [0.0, 0.0, 0.0],
        "adjusted_ned_m": list(place),
        "adjusted_quaternion": quaternion.tolist(),
        "sigma_ned_m": SIGMAS[3:].tolist(),
        "covariance": np.diag(0 * SIGMAS if held else SIGMAS**2).tolist(),
        "held": held,
        "held_by": "the datum" if held else "ties",
    }


def test_a_stop_is_evaluated_by_its_distance_and_its_covariance():
    truths = [TrueStop(1, drive, np.array(place), np.eye(3)) for drive, place in
              ((0, (0.0, 0.0, 0.0)), (10, (12.0, 16.0, 0.0)))]  # fmt: skip
    rows = [
        row(0, (0.0, 0.0, 0.0), held=True),
        row(10, (12.0, 16.03, 0.01), (0.0, 1e-3, -4e-3)),
    ]
    held, other = evaluate_positions(rows, truths)
    assert held["nees"] is None
    assert held["percent"] is None
    assert other["percent"] == pytest.approx(100 * np.hypot(0.03, 0.01) / 20, abs=1e-3)
    assert other["azimuth_error_deg"] == pytest.approx(np.rad2deg(-4e-3), abs=1e-4)
    assert other["nees"] == pytest.approx((1 + 4 + 1 + 1) / 6, abs=2e-3)
