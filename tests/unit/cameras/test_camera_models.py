import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from jaxtyping import TypeCheckError

from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.cahvor import Cahvor, largest_square, undistort
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import CameraError
from solmap.photogrammetry.frames import Pose, rotation_of_roll_pitch_yaw, rover_frame, site_frame


def test_a_point_on_a_ray_is_imaged_at_the_pixel_of_the_ray(model, in_view):
    points, image_points = in_view
    np.testing.assert_allclose(model.project(points), image_points, atol=1e-9)


def test_projecting_and_back_projecting_closes_for_every_camera_of_the_facts(unit_cameras, rng):
    for name, camera in unit_cameras.items():
        image_points = rng.uniform(0, 1, (500, 2)) * [1023, 505 if name == "di_li_2004" else 1023]
        points = camera.ray_origins(image_points) + 7.0 * camera.rays(image_points)
        np.testing.assert_allclose(camera.project(points), image_points, atol=1e-9, err_msg=name)


def test_a_transposed_array_fails_at_the_call_that_received_it(navcam, rng):
    with pytest.raises(TypeCheckError, match="points"):
        navcam.project(rng.uniform(1, 2, (3, 200)))


def test_rays_are_of_unit_length(model, rng):
    lengths = np.linalg.norm(model.rays(rng.uniform(0, 1023, (300, 2))), axis=1)
    np.testing.assert_allclose(lengths, 1.0, atol=1e-12)


def test_partial_derivatives_agree_with_finite_differences(model, in_view):
    points, _ = in_view
    image_points, partials = model.partials(points)
    for axis in range(3):
        step = 1e-5 * np.linalg.norm(points - model.centre, axis=1)[:, None] * np.eye(3)[axis]
        slope = (model.project(points + step) - model.project(points - step)) / (
            2 * step[:, axis, None]
        )
        # Central differences of 1e-5 of the distance: truncation of 1e-10, rounding of 1e-8.
        scale = np.abs(partials).max(axis=(1, 2))[:, None]
        np.testing.assert_allclose(partials[:, :, axis] / scale, slope / scale, atol=1e-7)
    np.testing.assert_array_equal(image_points, model.project(points))


def test_partial_derivatives_are_continuous_on_the_axis(hazcam, navcam):
    for camera in (hazcam, navcam):
        on_axis = camera.c + 3.0 * camera.o
        beside = on_axis + 1e-6 * np.cross(camera.o, [0, 0, 1])
        _, partials = camera.partials(np.stack([on_axis, beside]))
        np.testing.assert_allclose(partials[0], partials[1], rtol=1e-4, atol=1e-3)


def test_points_behind_the_camera_have_no_image(model):
    behind = model.centre - 5.0 * model.a
    image_points = model.project(np.stack([behind, model.centre + 5.0 * model.a]))
    assert np.isnan(image_points[0]).all()
    assert np.isfinite(image_points[1]).all()


def test_points_without_image_have_no_derivatives(model):
    sideways = np.cross(getattr(model, "o", model.a), [0.0, 0.0, 1.0])  # d.O = 0, or d.A = 0
    points = model.centre + np.stack([np.zeros(3), -5.0 * model.a, 3.0 * sideways])
    image_points, partials = model.partials(points)
    lost = np.isnan(image_points).all(axis=1)
    assert lost[:2].all()
    assert np.isnan(partials[lost]).all()


def test_a_point_far_outside_the_field_does_not_reappear_in_the_image(navcam):
    folding = Cahvor(navcam.c, navcam.a, navcam.h, navcam.v, navcam.o, np.array([0.0, -0.2, 0.0]))
    across = np.cross(navcam.o, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    # chi (1 - 0.2 chi^2) turns back at chi = 1.29 and is zero again at 2.24.
    points = np.stack([navcam.c + 5 * (navcam.o + tangent * across) for tangent in (1.2, 1.4, 2.2)])
    assert np.isfinite(folding.project(points)).all(axis=1).tolist() == [True, False, False]


def test_no_points_give_no_image(model):
    assert model.project(np.empty((0, 3))).shape == (0, 2)
    assert model.rays(np.empty((0, 2))).shape == (0, 3)
    assert model.ray_origins(np.empty((0, 2))).shape == (0, 3)


def test_moving_camera_and_points_together_keeps_the_image(model, in_view):
    points, image_points = in_view
    rotation = rotation_of_roll_pitch_yaw(0.1, -0.2, 2.5)
    pose = Pose(site_frame(1), rover_frame(1, 0), rotation, np.array([3.0, -4.0, 0.5]))
    moved = model.transform(pose)
    assert isinstance(moved, CameraModel)
    np.testing.assert_allclose(moved.project(pose.apply(points)), image_points, atol=1e-8)


def test_a_sub_frame_images_the_same_ground_at_shifted_pixels(model, in_view):
    points, image_points = in_view
    cut = model.subframe(384, 100)
    np.testing.assert_allclose(cut.project(points), image_points - [384, 100], atol=1e-8)


def test_an_averaged_pixel_is_at_the_mean_of_its_pixels(model):
    block = np.array([[x, y] for x in (400.0, 401.0) for y in (520.0, 521.0, 522.0, 523.0)])
    averaged = model.average(2, 4)
    ray = model.rays(block.mean(axis=0)[None])
    point = model.ray_origins(block.mean(axis=0)[None]) + 4.0 * ray
    np.testing.assert_allclose(averaged.project(point), [[200.0, 130.0]], atol=1e-9)


def test_without_the_half_pixel_an_averaged_model_equals_that_of_a_label(model):
    plain = model.average(2, 4, correct_half_pixel=False)
    np.testing.assert_allclose(plain.h, model.h / 2)
    np.testing.assert_allclose(plain.v, model.v / 4)


def test_rays_of_a_fisheye_start_along_the_axis(hazcam, rng):
    image_points = rng.uniform(0, 1023, (100, 2))
    along = hazcam.ray_origins(image_points) - hazcam.c
    np.testing.assert_allclose(np.cross(along, hazcam.o), 0.0, atol=1e-12)
    assert 1e-4 < np.linalg.norm(along, axis=1).max() < 0.01  # millimetres


def test_the_three_types_of_cahvore_agree_near_the_axis(hazcam):
    fields = {name: getattr(hazcam, name) for name in hazcam.__dataclass_fields__}
    point = (hazcam.c + 4 * (hazcam.o + np.array([0.0, 0.01, 0.0])))[None]
    images = [Cahvore(**{**fields, "type": kind}).project(point) for kind in (1, 2, 3)]
    # They differ by the third power of the angle, 1e-6 / 3 of 450 px.
    np.testing.assert_allclose(images[0], images[1], atol=2e-3)
    np.testing.assert_allclose(images[0], images[2], atol=2e-3)


@example(r0=0.0, r1=-2.225073858507e-311, r2=0.0, share=0.0)
@given(
    r0=st.floats(-0.2, 0.2),
    r1=st.floats(-0.3, 0.3),
    r2=st.floats(-0.3, 0.3),
    share=st.floats(0.0, 0.95),
)
def test_the_radial_polynomial_is_inverted_wherever_it_is_unique(r0, r1, r2, share):
    r = np.array([r0, r1, r2])
    chi = np.array([share * min(np.sqrt(largest_square(r)), 2.0)])
    distorted = chi * (1 + r0 + r1 * chi**2 + r2 * chi**4)
    np.testing.assert_allclose(undistort(distorted, r), chi, rtol=1e-9, atol=1e-12)


def test_radii_outside_the_range_of_the_polynomial_have_no_inverse():
    r = np.array([0.0, -0.2, 0.0])  # reaches 0.861 at most
    assert np.isnan(undistort(np.array([0.5, 0.9, 5.0]), r)).tolist() == [False, True, True]


def test_a_model_without_image_plane_is_refused(navcam):
    with pytest.raises(CameraError, match="they span no image"):
        Cahv(navcam.c, navcam.a, navcam.h, navcam.h)


def test_non_finite_numbers_are_refused(navcam):
    with pytest.raises(CameraError, match="C of a camera model must be"):
        Cahv(np.array([0.0, np.nan, 0.0]), navcam.a, navcam.h, navcam.v)


def test_an_unknown_type_of_cahvore_is_refused(hazcam):
    fields = {name: getattr(hazcam, name) for name in hazcam.__dataclass_fields__}
    with pytest.raises(CameraError, match="of type 1, 2 or 3, not 4"):
        Cahvore(**{**fields, "type": 4})
    with pytest.raises(CameraError, match="P of a CAHVORE model must be between -1 and 1"):
        Cahvore(**{**fields, "parameter": 37.0})


def test_a_scale_that_mirrors_the_axis_is_refused(navcam):
    with pytest.raises(CameraError, match="R0 = -1"):
        Cahvor(navcam.c, navcam.a, navcam.h, navcam.v, navcam.o, np.array([-1.0, 0.0, 0.0]))


def test_averaging_over_zero_pixels_is_refused(navcam):
    with pytest.raises(CameraError, match="at least one, not 0"):
        navcam.average(0, 1)
