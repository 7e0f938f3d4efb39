import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, epipolar_pair
from solmap.photogrammetry.errors import CameraError
from solmap.photogrammetry.frames import Frame, FrameKind, rover_frame

ROVER = rover_frame(125, 100)
PAIR = Frame(FrameKind.PAIR, (125, 100, 1))
SIZE = (1024, 1024)


def camera(centre, yaw_degrees=0.0, pitch_degrees=-20.0, f=1200.0, size=SIZE, radial=None):
    """A camera in a rover frame (x forward, y right, z down), turned right and up from there."""
    turn = Rotation.from_euler("ZY", [yaw_degrees, pitch_degrees], degrees=True).as_matrix()
    forward, right, down = turn.T
    h = f * right + (size[0] - 1) / 2 * forward
    v = f * down + (size[1] - 1) / 2 * forward
    if radial is None:
        return Cahv(np.array(centre), forward, h, v)
    return Cahvor(np.array(centre), forward, h, v, forward, np.array(radial))


def pair_of(left, right, left_size=SIZE, right_size=SIZE):
    return epipolar_pair(left, right, left_size, right_size, ROVER, PAIR)


def navcam():
    radial = (0.0, -0.015, 0.02)
    return (
        camera([0.4, 0.1, -1.3], yaw_degrees=0.4, pitch_degrees=-20.1, radial=radial),
        camera([0.4, 0.3, -1.301], yaw_degrees=-0.3, pitch_degrees=-19.9, radial=radial),
    )


def test_a_point_has_the_same_row_in_both_epipolar_images(rng):
    left, right = navcam()
    pair = pair_of(left, right)
    points = np.array([0.4, 0.1, -1.3]) + rng.uniform([2, -3, -1], [40, 3, 2], (200, 3))
    left_eye, right_eye = pair.cameras()
    in_left, in_right = left_eye.project(points), right_eye.project(points)
    np.testing.assert_allclose(in_left[:, 1], in_right[:, 1], atol=1e-9)
    image_points, parallax = pair.project(pair.rover_from_pair.inverse.apply(points))
    np.testing.assert_allclose(image_points, in_left, atol=1e-9)
    np.testing.assert_allclose(parallax, in_left[:, 0] - in_right[:, 0], atol=1e-9)


def test_the_rig_of_spirit_has_its_published_baseline_and_scale(cameras):
    left, right = (cameras[f"navcam_{eye}_spirit_sol767"] for eye in ("left", "right"))
    pair = pair_of(left, right)
    assert pair.base_m == pytest.approx(0.200345, abs=2e-6)
    assert pair.focal_px == pytest.approx(1215.0, rel=0.02)  # mean of labels, less distortion
    assert 1000 <= pair.lines <= 1060
    assert 1000 <= pair.samples <= 1110


def test_triangulation_inverts_projection(rng):
    pair = pair_of(*navcam())
    points = rng.uniform([-3, -2, 1.5], [3, 2, 60], (100, 3))
    np.testing.assert_allclose(pair.triangulate(*pair.project(points)), points, atol=1e-9)


def test_every_pixel_with_a_partner_is_kept():
    left, right = navcam()
    pair = pair_of(left, right)
    edge = np.linspace(0, 1023, 65)
    grid = np.stack(np.meshgrid(edge, edge), -1).reshape(-1, 2)
    for eye, ideal, other in zip((left, right), pair.cameras(), (right, left), strict=True):
        for metres in (1.5, 20.0, 1000.0):
            points = eye.centre + metres * eye.rays(grid)
            seen = other.project(points)
            both = ((seen >= 0) & (seen <= 1023)).all(axis=1)
            kept = ideal.project(points[both])
            assert both.sum() > 1000
            assert kept.min() > -1.0
            assert (kept < [pair.samples, pair.lines]).all()


def test_cameras_that_toe_in_lose_no_common_field():
    left = camera([0.0, 0.0, -1.5], yaw_degrees=1.0, f=3600.0)
    right = camera([0.0, 0.3, -1.5], yaw_degrees=-1.0, f=3600.0)
    pair = pair_of(left, right)
    assert pair.samples == pytest.approx(1024 + 2 * 3600 * np.tan(np.radians(1.0)), abs=12)
    assert pair.focal_px == pytest.approx(3600.0, rel=1e-4)


def test_sub_frames_keep_their_common_rows():
    left, right = navcam()
    pair = pair_of(left.subframe(300, 200), right.subframe(300, 260), (400, 300), (400, 300))
    assert pair.lines == pytest.approx(240, abs=12)
    assert pair.samples == pytest.approx(400 + 2 * 0.35 / 57.3 * 1200, abs=12)  # toed in
    # the middle of the common sub-frame lies in the middle of the epipolar image
    middle = left.centre + 30.0 * left.rays(np.array([[500.0, 380.0]]))
    seen = pair.cameras()[0].project(middle)[0]
    np.testing.assert_allclose(seen, [pair.samples / 2, pair.lines / 2], atol=25)


def test_a_wide_field_is_cut_to_a_reasonable_size():
    left = camera([0.5, -0.05, -0.5], f=330.0)
    right = camera([0.5, 0.05, -0.5], yaw_degrees=0.5, f=330.0)
    turned = pair_of(left, camera([0.5, 0.05, -0.5], yaw_degrees=70.0, f=330.0))
    for pair in (pair_of(left, right), turned):
        assert max(pair.samples, pair.lines) <= 2048


def test_cameras_without_common_rows_are_refused():
    left = camera([0.0, 0.0, -1.5], pitch_degrees=-60.0)
    right = camera([0.0, 0.2, -1.5], pitch_degrees=20.0)
    with pytest.raises(CameraError, match=r"have no common field of view.*one exposure"):
        pair_of(left, right)


def test_cameras_that_look_along_their_baseline_are_refused():
    left = camera([0.0, 0.0, -1.5], pitch_degrees=0.0)
    right = camera([1.0, 0.0, -1.5], pitch_degrees=0.0)
    with pytest.raises(CameraError, match="viewing direction is along the baseline"):
        pair_of(left, right)


def test_cameras_at_one_place_are_refused():
    with pytest.raises(CameraError, match="have no baseline"):
        pair_of(camera([0.0, 0.0, -1.5]), camera([0.0, 0.0, -1.5], yaw_degrees=3.0))


def test_an_impossible_pair_is_refused():
    good = pair_of(*navcam())
    with pytest.raises(CameraError, match="above zero"):
        EpipolarPair(good.rover_from_pair, 0.0, 1200.0, (0.0, 0.0), 10, 10)


def test_range_error_grows_with_the_square_of_the_range():
    pair = pair_of(*navcam())
    points = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 50.0]])
    covariance = pair.covariances(*pair.project(points), 0.1, 0.1)
    sigma_z = np.sqrt(covariance[:, 2, 2])
    expected = points[:, 2] ** 2 * 0.1 / (pair.base_m * pair.focal_px)
    np.testing.assert_allclose(sigma_z, expected, rtol=1e-9)
