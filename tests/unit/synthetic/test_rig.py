"""The mast carries the cameras as in the flight labels."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.frames import rotation_of_roll_pitch_yaw
from solmap.photogrammetry.imagery import Eye, StopId
from solmap.photogrammetry.synthetic.rig import (
    CALIBRATED_AT_C,
    CAMERAS,
    D_AZ,
    D_EL,
    Instrument,
    Pointing,
    RigErrors,
    rig_temperature,
)

STOP = StopId("MER2", 137, 0)


def test_the_mast_reproduces_the_flight_label_of_sol_1869():
    pointing = Pointing(np.deg2rad(141.99451), np.deg2rad(-25.742348))
    camera = CAMERAS[Instrument.NAVCAM, Eye.LEFT].in_mast.transform(pointing.rover_from_mast(STOP))
    # Label digits: C to 1e-6 m, unit vectors to 1e-6, H and V to 0.01 px.
    np.testing.assert_allclose(camera.c, [0.454993, 0.141198, -1.23312], atol=5e-6)
    np.testing.assert_allclose(camera.a, [-0.69585, 0.571462, 0.435], atol=3e-6)
    np.testing.assert_allclose(camera.h, [-1075.03, -654.572, 220.543], atol=0.02)
    np.testing.assert_allclose(camera.v, [50.6594, -19.3653, 1294.76], atol=0.02)
    np.testing.assert_allclose(camera.o, [-0.61985, 0.672629, 0.404174], atol=3e-6)


def test_the_motors_of_that_label_are_the_axis_minus_its_offsets():
    azimuth, elevation = Pointing(np.deg2rad(141.99451), np.deg2rad(-25.742348)).motors
    assert azimuth == pytest.approx(2.47455, abs=2e-5)
    assert elevation == pytest.approx(-0.503045, abs=3e-4)
    assert pytest.approx((0.0037228, 0.053756), abs=1e-5) == (D_AZ, D_EL)


def test_the_mast_quaternion_is_that_of_the_label():
    pointing = Pointing(np.deg2rad(141.99451), np.deg2rad(-25.742348))
    quaternion = pointing.rover_from_mast(STOP).quaternion
    np.testing.assert_allclose(quaternion, [0.317432, 0.21062, -0.0725336, 0.921746], atol=1e-6)


def test_the_navcam_baseline_is_the_published_one():
    left, right = (CAMERAS[Instrument.NAVCAM, eye].in_mast for eye in (Eye.LEFT, Eye.RIGHT))
    assert np.linalg.norm(right.c - left.c) == pytest.approx(0.200345, abs=1e-6)


def test_the_right_pancam_mirrors_the_left_one():
    left, right = (CAMERAS[Instrument.PANCAM, eye].in_mast for eye in (Eye.LEFT, Eye.RIGHT))
    assert right.c[1] - left.c[1] == pytest.approx(0.2968, abs=1e-4)
    points = np.array([[10.0, 0.4, 1.0], [25.0, -1.0, -2.0], [8.0, 0.1, 0.3]])
    mirrored = points * [1, -1, 1] + [0.0, 0.025, 0.0]
    (x_left, y_left), (x_right, y_right) = left.project(points).T, right.project(mirrored).T
    np.testing.assert_allclose(x_right, 1023 - x_left, atol=1e-6)
    np.testing.assert_allclose(y_right, y_left, atol=1e-6)


def test_a_pointing_error_of_the_mast_rotates_both_eyes_about_the_mast_head():
    pointing = Pointing(0.3, -0.3)
    miss = np.deg2rad([0.1, 0.2, -0.15])
    moved = pointing.rover_from_mast(STOP, turned_by=miss)
    assert np.array_equal(moved.translation_m, pointing.rover_from_mast(STOP).translation_m)
    turn = pointing.rotation.T @ moved.rotation
    angle = np.arccos((np.trace(turn) - 1) / 2)
    assert angle == pytest.approx(np.linalg.norm(miss), rel=1e-3)


@pytest.mark.parametrize("instrument", Instrument)
def test_temperature_rotates_the_right_cameras_about_their_centres(instrument):
    rig = RigErrors(bend=(1e-4, -2e-4, 3e-4), bend_per_kelvin=(1e-6, 0.0, -2e-5))
    left, right = (CAMERAS[instrument, eye].in_mast for eye in (Eye.LEFT, Eye.RIGHT))
    assert rig.camera_in_mast(instrument, Eye.LEFT, -20.0) is left
    for kelvin, turn in ((0.0, [1e-4, -2e-4, 3e-4]), (-10.0, [0.9e-4, -2e-4, 5e-4])):
        bent = rig.camera_in_mast(instrument, Eye.RIGHT, CALIBRATED_AT_C + kelvin)
        rotation = Rotation.from_rotvec(turn).as_matrix()
        np.testing.assert_allclose(bent.c, right.c, rtol=1e-12)
        for axis in "ahvo":
            np.testing.assert_allclose(
                getattr(bent, axis), rotation @ getattr(right, axis), atol=1e-8
            )


def test_a_rig_without_errors_equals_the_labels():
    rig = RigErrors()
    for (instrument, eye), unit in CAMERAS.items():
        assert rig.camera_in_mast(instrument, eye, -50.0) is unit.in_mast
    assert RigErrors(pointing=0.0).draw_miss(Pointing(1.0, -0.3), np.random.default_rng(0)) == (
        0.0,
        0.0,
        0.0,
    )


def test_systematic_errors_of_the_mast_are_those_of_its_axis_and_zeros():
    rig = RigErrors(pointing=0.0, mast_zero=(2e-3, -1e-3), mast_axis=(1e-3, 3e-3))
    for azimuth in (0.2, 2.0, 4.0):
        pointing = Pointing(azimuth, -0.3)
        miss = rig.draw_miss(pointing, np.random.default_rng(0))
        found = pointing.rotation @ rotation_of_roll_pitch_yaw(*miss)
        true = (
            rotation_of_roll_pitch_yaw(1e-3, 3e-3, 0.0)
            @ Pointing(azimuth + 2e-3, -0.3 - 1e-3).rotation
        )
        np.testing.assert_allclose(found, true, atol=1e-12)


def test_the_rig_is_warmer_after_noon_than_in_the_morning():
    assert rig_temperature(14.0) == pytest.approx(0.0)
    assert rig_temperature(9.5) < -15
