"""Where a stop lies in an image that its map was registered to."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.frames import LSL, Pose, rotation_of_roll_pitch_yaw
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.orbital.records import Correction
from solmap.photogrammetry.orbital.registration import stop_in_image

STOP = StopId("MER2", 10, 64)
COVARIANCE = np.array(
    [
        [4e-2, 1e-2, 1e-3, 0.0],
        [1e-2, 9e-2, -2e-3, 1e-4],
        [1e-3, -2e-3, 1e-3, 0.0],
        [0.0, 1e-4, 0.0, 1e-5],
    ]
)


def pose(east, north, up, azimuth_deg):
    rotation = rotation_of_roll_pitch_yaw(0.0, 0.0, float(np.radians(azimuth_deg)))
    return Pose(LSL, STOP.frame, rotation, np.array([north, east, -up]))


def test_the_correction_transforms_the_place_in_the_image_to_the_stop():
    correction = Correction(4.0, -3.0, 1.5, (10.0, 20.0), COVARIANCE, 0.01)
    control = stop_in_image(STOP, pose(33.0, 12.0, 1.0, 50.0), correction, "orbit")
    back = correction.apply(np.array([[control.east_m, control.north_m]]))
    np.testing.assert_allclose(back, [[33.0, 12.0]], atol=1e-9)
    np.testing.assert_allclose(control.azimuth_deg, 51.5)
    assert control.up_m is None


def test_its_covariance_agrees_with_differences():
    place = pose(33.0, 12.0, 1.0, 50.0)
    correction = Correction(4.0, -3.0, 1.5, (10.0, 20.0), COVARIANCE, 0.01)
    control = stop_in_image(STOP, place, correction, "orbit")
    h = 1e-6
    J = np.zeros((3, 4))
    for k, name in enumerate(("east_m", "north_m", "rotation_deg", "scale")):
        step = np.degrees(h) if k == 2 else h
        moved = replace(correction, **{name: getattr(correction, name) + step})
        other = stop_in_image(STOP, place, moved, "orbit")
        J[:, k] = (other.values - control.values)[[0, 1, 3]] / h
    np.testing.assert_allclose(control.covariance, J @ COVARIANCE @ J.T, rtol=1e-4, atol=1e-9)


def test_the_map_may_be_rotated_against_the_rover():
    correction = Correction(4.0, -3.0, 1.5, (10.0, 20.0), COVARIANCE, 0.01)
    place = pose(33.0, 12.0, 1.0, 50.0)
    found = [stop_in_image(STOP, place, correction, "orbit", sigma) for sigma in (0.0, 0.1)]
    sure, unsure = (one.covariance for one in found)
    assert unsure[2, 2] - sure[2, 2] == pytest.approx(np.radians(0.1) ** 2)


def test_a_terrain_model_gives_the_height_too():
    correction = Correction(4.0, -3.0, 1.5, (10.0, 20.0), COVARIANCE, 0.01, -1900.0, 0.05)
    control = stop_in_image(STOP, pose(33.0, 12.0, 1.0, 50.0), correction, "orbit")
    assert control.up_m == 1901.0
    np.testing.assert_allclose(control.covariance[2], [0.0, 0.0, 0.05**2, 0.0])
