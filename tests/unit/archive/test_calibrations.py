"""Calibrations as OpenCV, ROS, Kalibr and the Ames Stereo Pipeline write them."""

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.archive.calibrations import read_calibration
from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.calibrated import BrownConrady, Fisheye
from solmap.photogrammetry.errors import LabelError

KALIBR = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.2816, 0.0745, 0.0001, 1.76e-05]
  distortion_model: radtan
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.99999726, 0.00231207, 0.00037600, -0.11000740]
  - [-0.00231714, 0.99989819, 0.01408980, 0.00048958]
  - [-0.00034339, -0.01409063, 0.99990066, 0.00018200]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.02, -0.01, 0.002]
  distortion_model: equidistant
  intrinsics: [457.587, 456.134, 379.999, 255.238]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
"""
ROS = """image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [436.0, 0.0, 364.0, 0.0, 434.6, 256.2, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.36, 0.11, 0.001, 0.0005, 0.0]
"""
TSAI = """fu = 620.86
fv = 622.3
cu = 526.1
cv = 374.3
u_direction = 1 0 0
v_direction = 0 1 0
w_direction = 0 0 1
C = 0.0751 -0.065 -0.902
R = 0 0 1 1 0 0 0 1 0
k1 = -0.33
k2 = 0.125
p1 = -0.0004
p2 = 0.0011
"""


def test_a_camera_of_the_ames_stereo_pipeline_has_its_stated_position():
    (eye,) = read_calibration(TSAI, "left.tsai")
    camera = eye.camera
    assert isinstance(camera, BrownConrady)
    assert eye.size is None
    np.testing.assert_array_equal(camera.centre, [0.0751, -0.065, -0.902])
    np.testing.assert_allclose(camera.rays(np.array([[526.1, 374.3]])), [[1, 0, 0]], atol=1e-12)
    assert camera.distortion == (-0.33, 0.125, -0.0004, 0.0011)


def test_a_file_without_distortion_is_a_pinhole():
    text = "VERSION_4\nPINHOLE\n" + TSAI.partition("k1")[0] + "pitch = 1\nNULL\n"
    (eye,) = read_calibration(text, "left.tsai")
    assert isinstance(eye.camera, Cahv)
    ahead_right_below = np.array([[4.0751, 0.935, 1.098]])
    expected = [[526.1 + 620.86 / 4, 374.3 + 622.3 / 2]]
    np.testing.assert_allclose(eye.camera.project(ahead_right_below), expected, atol=1e-9)


def test_a_chain_of_kalibr_has_the_right_camera_on_the_right():
    left, right = read_calibration(KALIBR, "camchain.yaml")
    assert left.size == right.size == (752, 480)
    assert isinstance(left.camera, BrownConrady)
    assert isinstance(right.camera, Fisheye)
    np.testing.assert_array_equal(left.camera.centre, np.zeros(3))
    np.testing.assert_allclose(right.camera.centre, [0.0, 0.11, 0.0], atol=1.1e-3)
    points = np.array([[5.0, 0.3, 0.4], [9.0, -1.0, 1.0]])  # forward, right, down
    in_left = points[:, [1, 2, 0]]
    rows = [line.partition("[")[2].rstrip("]").split(",") for line in KALIBR.splitlines()[10:13]]
    step = np.array(rows, dtype=float)
    in_right = in_left @ step[:, :3].T + step[:, 3]
    matrix = np.array([[457.587, 0, 379.999], [0, 456.134, 255.238], [0, 0, 1]])
    lens = np.array(right.camera.distortion)
    seen, _ = cv2.fisheye.projectPoints(in_right[:, None], np.zeros(3), np.zeros(3), matrix, lens)
    np.testing.assert_allclose(right.camera.project(points), seen[:, 0], atol=1e-3)


def test_a_stereo_calibration_of_opencv_projects_like_opencv():
    matrix = np.array([[500.0, 0, 320], [0, 501.0, 240], [0, 0, 1]])
    turn, shift = cv2.Rodrigues(np.array([0.01, -0.02, 0.005]))[0], np.array([[-0.2], [0.01], [0]])
    lens = np.array([[-0.2, 0.05, 0.001, -0.0005, 0.0]])
    file = cv2.FileStorage("x.yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    parts = {"M1": matrix, "D1": 0 * lens, "M2": matrix, "D2": lens, "R": turn, "T": shift}
    for name, value in parts.items():
        file.write(name, value)
    left, right = read_calibration(file.releaseAndGetString(), "stereo.yml")
    assert isinstance(left.camera, Cahv)
    points = np.array([[5.0, 0.3, 0.4], [9.0, -1.0, 1.0]])
    for camera, at, distortion in (
        (left.camera, (np.zeros(3), np.zeros(3)), 0 * lens),
        (right.camera, (cv2.Rodrigues(turn)[0], shift), lens),
    ):
        seen, _ = cv2.projectPoints(points[:, [1, 2, 0]], *at, matrix, distortion)
        np.testing.assert_allclose(camera.project(points), seen[:, 0], atol=1e-6)


def test_a_camera_of_ros_is_read():
    (eye,) = read_calibration(ROS, "left.yaml")
    assert eye.size == (640, 480)
    assert isinstance(eye.camera, BrownConrady)
    assert eye.camera.distortion == (-0.36, 0.11, 0.001, 0.0005, 0.0)


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("", "a.yaml", "a.yaml: cannot be read as a calibration"),
        ("\x00\x01", "a.yaml", "a.yaml: cannot be read as a calibration"),
        ("a: 1", "a.yaml", "neither cam0"),
        ("cam0: 3", "a.yaml", "cam0 is missing"),
        (KALIBR.partition("cam1")[0], "a.yaml", "cam1 is missing"),
        (
            KALIBR.replace("camera_model: pinhole", "camera_model: omni"),
            "a.yaml",
            "'omni'.*pinhole",
        ),
        (ROS.replace("plumb_bob", "thin_prism"), "a.yaml", "'thin_prism' is not known"),
        (ROS.replace("[436.0, 0.0,", "[436.0, 2.0,"), "a.yaml", "skew"),
        (ROS.replace("436.0", "-436.0"), "a.yaml", "above zero"),
        (ROS.replace("436.0", "wide"), "a.yaml", "camera_matrix should be 9 numbers"),
        (TSAI.replace("R = 0 0 1", "R = 0 0 2"), "a.tsai", "not a rotation matrix"),
        (TSAI.replace("fu = 620.86", ""), "a.tsai", "fu should be 1 number"),
        (TSAI.replace("v_direction = 0 1 0", "v_direction = 0 -1 0"), "a.tsai", "v_direction"),
        (TSAI + "AdjustableTSAI\n", "a.tsai", "'AdjustableTSAI' is not known"),
        (TSAI + "pitch = 0.0064\n", "a.tsai", "pitch should be 1"),
    ],
)
def test_unusable_calibrations_are_refused_in_one_line(text, name, message):
    with pytest.raises(LabelError, match=message) as refused:
        read_calibration(text, name)
    assert str(refused.value).startswith(name)
    assert "\n" not in str(refused.value)
