import cv2
import numpy as np
import pytest

from solmap.photogrammetry.cameras.calibrated import BrownConrady, Fisheye
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import CameraError
from solmap.photogrammetry.frames import Pose, rotation_of_roll_pitch_yaw, rover_frame, site_frame

AXES = (
    np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    @ rotation_of_roll_pitch_yaw(0.05, -0.4, 0.3).T
)
CENTRE = np.array([0.1, -0.05, -0.9])
LENS = ((620.9, 622.3), (526.1, 374.3))
LENSES = {
    "k1 k2 p1 p2": (BrownConrady, (-0.332, 0.1256, -0.0004, 0.0011)),
    "k3": (BrownConrady, (-0.28, 0.11, 0.001, 0.0002, -0.01)),
    "rational": (BrownConrady, (0.3, 0.05, 0.001, 0.0002, 0.001, 0.65, 0.12, 0.005)),
    "fisheye": (Fisheye, (-0.012, 0.021, -0.011, 0.0024)),
    "equidistant": (Fisheye, (0.0, 0.0, 0.0, 0.0)),
}


@pytest.fixture(params=list(LENSES))
def lens(request):
    kind, distortion = LENSES[request.param]
    return kind(CENTRE, AXES, *LENS, distortion)


@pytest.fixture
def seen(lens, rng):
    """Points 0.5 to 100 m away, and their image points."""
    image_points = rng.uniform(0, 1, (300, 2)) * [1023, 767]
    distances = np.geomspace(0.5, 100, 300)[:, None]
    return lens.ray_origins(image_points) + distances * lens.rays(image_points), image_points


def test_projecting_and_back_projecting_closes(lens, seen):
    points, image_points = seen
    assert isinstance(lens, CameraModel)
    np.testing.assert_allclose(lens.project(points), image_points, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(lens.rays(image_points), axis=1), 1.0, atol=1e-12)


def test_projections_equal_those_of_opencv(lens, seen):
    points, image_points = seen
    (fx, fy), (x, y) = LENS
    matrix = np.array([[fx, 0, x], [0, fy, y], [0, 0, 1.0]])
    in_camera = ((points - CENTRE) @ AXES.T)[:, None]
    project = cv2.fisheye.projectPoints if isinstance(lens, Fisheye) else cv2.projectPoints
    theirs, _ = project(in_camera, np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))
    np.testing.assert_allclose(theirs[:, 0], image_points, atol=1e-6)


def test_partial_derivatives_agree_with_finite_differences(lens, seen):
    points, _ = seen
    image_points, partials = lens.partials(points)
    np.testing.assert_array_equal(image_points, lens.project(points))
    for axis in range(3):
        step = 1e-5 * np.linalg.norm(points - CENTRE, axis=1)[:, None] * np.eye(3)[axis]
        slope = lens.project(points + step) - lens.project(points - step)
        slope /= 2 * step[:, axis, None]
        scale = np.abs(partials).max(axis=(1, 2))[:, None]
        np.testing.assert_allclose(partials[:, :, axis] / scale, slope / scale, atol=1e-7)


def test_a_point_on_the_axis_is_imaged_at_the_principal_point(lens):
    ahead = CENTRE + 3.0 * AXES[2]
    image_points, partials = lens.partials(np.stack([ahead, ahead + 1e-7 * AXES[0]]))
    np.testing.assert_allclose(image_points[0], LENS[1], atol=1e-9)
    np.testing.assert_allclose(partials[0], partials[1], rtol=1e-5, atol=1e-3)


def test_points_behind_a_perspective_camera_have_no_image():
    lens = BrownConrady(CENTRE, AXES, *LENS, LENSES["k1 k2 p1 p2"][1])
    assert np.isnan(lens.project((CENTRE - AXES[2])[None])).all()


def test_a_fisheye_images_more_than_a_half_space():
    lens = Fisheye(CENTRE, AXES, *LENS, (0.0, 0.0, 0.0, 0.0))
    aside = np.radians(100.0)
    point = CENTRE + 2.0 * (np.sin(aside) * AXES[0] + np.cos(aside) * AXES[2])
    x, y = lens.project(point[None])[0]
    np.testing.assert_allclose([x, y], [526.1 + 620.9 * aside, 374.3], atol=1e-9)


@pytest.mark.parametrize(
    ("lens", "inside", "outside"),
    [
        # r - 0.2 r^3 turns back at r = 1.29; theta - 0.2 theta^3 likewise
        (BrownConrady(CENTRE, AXES, *LENS, (-0.2, 0.0, 0.0, 0.0)), [1.2], [1.4, 2.2]),
        (Fisheye(CENTRE, AXES, *LENS, (-0.2, 0.0, 0.0, 0.0)), [np.tan(1.2)], [np.tan(1.4)]),
    ],
)
def test_a_point_far_outside_the_field_does_not_reappear(lens, inside, outside):
    def image(tangents):
        return lens.project(CENTRE + AXES[2] + np.array(tangents)[:, None] * AXES[0])

    assert np.isfinite(image(inside)).all()
    assert np.isnan(image(outside)).all()
    assert np.isnan(lens.rays(np.array([[526.1 + 0.9 * 620.9, 374.3]]))).all()  # beyond its rim


def test_moving_camera_and_points_together_keeps_the_image(lens, seen):
    points, image_points = seen
    rotation = rotation_of_roll_pitch_yaw(0.1, -0.2, 2.5)
    pose = Pose(site_frame(1), rover_frame(1, 0), rotation, np.array([3.0, -4.0, 0.5]))
    np.testing.assert_allclose(
        lens.transform(pose).project(pose.apply(points)), image_points, atol=1e-7
    )


def test_sub_frames_and_averages_image_the_same_ground(lens, seen):
    points, image_points = seen
    np.testing.assert_allclose(
        lens.subframe(384, 100).project(points), image_points - [384, 100], atol=1e-7
    )
    np.testing.assert_allclose(
        lens.average(2, 4).project(points), (image_points + 0.5) / [2, 4] - 0.5, atol=1e-7
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distortion": (0.1,)}, "4 or 5 or 8 coefficients, not 1"),
        ({"focal_px": (0.0, 600.0)}, "above zero"),
        ({"axes": np.eye(3) * 1.1}, "right angles"),
        ({"centre": np.array([np.nan, 0.0, 0.0])}, "finite"),
    ],
)
def test_impossible_cameras_are_refused(change, message):
    parts = {
        "centre": CENTRE,
        "axes": AXES,
        "focal_px": LENS[0],
        "principal_px": LENS[1],
        "distortion": (0.0, 0.0, 0.0, 0.0),
    }
    with pytest.raises(CameraError, match=message):
        BrownConrady(**{**parts, **change})
