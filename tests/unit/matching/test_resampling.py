import numpy as np
import pytest
from scipy import ndimage

from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.epipolar import epipolar_pair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Frame, FrameKind, rover_frame
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.resampling import (
    epipolar_images,
    original_points,
    resample,
    sample_points,
    spline_coefficients,
)

SIZE = 200
ROVER, PAIR = rover_frame(1, 0), Frame(FrameKind.PAIR, (1,))


def eye(y_m, tilt, first_radial=-0.02):
    """One of two slightly turned cameras with the distortion of a Navcam."""
    a = np.array([1.0, tilt, 0.35 + tilt])
    a /= np.linalg.norm(a)
    right = np.cross([0.0, 0.0, 1.0], a)
    right /= np.linalg.norm(right)
    down = np.cross(a, right)
    middle = (SIZE - 1) / 2
    f = 240.0
    o = np.array([1.0, 0.02, 0.34])
    return Cahvor(
        np.array([0.4, y_m, -1.3]),
        a,
        f * right + middle * a,
        f * down + middle * a,
        o / np.linalg.norm(o),
        np.array([0.001, first_radial, 0.02]),
    )


@pytest.fixture
def rig():
    left, right = eye(0.1, 0.004), eye(0.3, -0.003)
    return left, right, epipolar_pair(left, right, (SIZE, SIZE), (SIZE, SIZE), ROVER, PAIR)


def wall(camera):
    """What a camera sees of a wavy pattern on a wall 6 m ahead."""
    y, x = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    rays = camera.rays(np.column_stack([x.ravel(), y.ravel()]))
    points = camera.centre + rays * ((6.0 - camera.centre[0]) / rays[:, :1])
    grey = 1000 + 300 * np.sin(points[:, 1] * 25) * np.cos(points[:, 2] * 21)
    return grey.reshape(SIZE, SIZE).astype(np.float32)


def test_the_map_is_exact_to_a_hundredth_of_a_pixel(rig):
    left, _, geometry = rig
    mapped = original_points(left, geometry)
    y, x = np.mgrid[0 : geometry.lines, 0 : geometry.samples].astype(float)
    rays = geometry.directions(np.column_stack([x.ravel(), y.ravel()]))
    exact = left.project(left.centre + 7.0 * rays).reshape(mapped.shape)
    assert np.abs(mapped - exact).max() < 0.01


def test_resampled_images_equal_those_of_ideal_cameras(rig):
    left, right, geometry = rig
    whole = np.ones((SIZE, SIZE), dtype=bool)
    images = epipolar_images(geometry, (wall(left), whole, left), (wall(right), whole, right))
    for camera, image, mask in zip(
        geometry.cameras(),
        (images.left, images.right),
        (images.left_mask, images.right_mask),
        strict=True,
    ):
        y, x = np.mgrid[0 : geometry.lines, 0 : geometry.samples].astype(float)
        rays = camera.rays(np.column_stack([x.ravel(), y.ravel()]))
        points = camera.centre + rays * ((6.0 - camera.centre[0]) / rays[:, :1])
        ideal = 1000 + 300 * np.sin(points[:, 1] * 25) * np.cos(points[:, 2] * 21)
        error = np.abs(image - ideal.reshape(image.shape))[4:-4, 8:-8]
        assert mask.mean() > 0.9
        steepest = 300 * 25 * 6.0 / 240.0  # grey values a pixel
        assert np.percentile(error, 99) < 0.015 * steepest  # hundredths of a pixel


def test_masked_pixels_stay_masked_with_their_surroundings(rig):
    left, _, geometry = rig
    image, mask = wall(left), np.ones((SIZE, SIZE), dtype=bool)
    image[80:90, 60:70], mask[80:90, 60:70] = 1e6, False
    resampled, usable = resample(image, mask, left, geometry, Eye.LEFT)
    clean, _ = resample(wall(left), np.ones_like(mask), left, geometry, Eye.LEFT)
    source = original_points(left, geometry)
    inside = ((source >= [57.5, 77.5]) & (source <= [71.5, 91.5])).all(axis=2)
    assert not usable[inside].any()
    assert usable.mean() > 0.9
    assert np.abs(resampled - clean)[usable].max() < 6.0  # 2 percent of the amplitude


def test_pixels_outside_the_original_are_not_usable(rig):
    left, _, geometry = rig
    image = wall(left)
    _, usable = resample(image, np.ones(image.shape, bool), left, geometry, Eye.LEFT)
    source = original_points(left, geometry)
    outside = ~((source >= 0) & (source <= SIZE - 1)).all(axis=2)
    assert outside.any()
    assert not usable[outside].any()


def test_eyes_of_different_size_are_resampled_to_one_geometry(rig):
    left, right, _ = rig
    part = right.subframe(20, 40)
    geometry = epipolar_pair(left, part, (SIZE, SIZE), (150, 120), ROVER, PAIR)
    images = epipolar_images(
        geometry,
        (wall(left), np.ones((SIZE, SIZE), dtype=bool), left),
        (wall(right)[40:160, 20:170], np.ones((120, 150), dtype=bool), part),
    )
    assert images.left.shape == images.right.shape == (geometry.lines, geometry.samples)
    assert geometry.lines < 140
    assert images.right_mask.sum() > 0.85 * 120 * 150


def test_exchanged_eyes_are_detected(rig):
    left, right, geometry = rig
    image, mask = wall(right), np.ones((SIZE, SIZE), dtype=bool)
    with pytest.raises(MatchingError, match=r"0\.2000 m from its position .* eyes exchanged"):
        resample(image, mask, right, geometry, Eye.LEFT)
    with pytest.raises(MatchingError, match="left or the right eye"):
        resample(image, mask, left, geometry, Eye.MONO)


def test_an_image_without_usable_pixels_is_refused(rig):
    left, _, geometry = rig
    with pytest.raises(MatchingError, match="no pixel of the image is usable"):
        resample(wall(left), np.zeros((SIZE, SIZE), bool), left, geometry, Eye.LEFT)


SPLINE_PX = 120


@pytest.fixture
def image(rng):
    return ndimage.gaussian_filter(rng.normal(0, 1, (SPLINE_PX, SPLINE_PX)), 1.0).astype(np.float32)


@pytest.fixture
def places(rng):
    return rng.uniform(0, SPLINE_PX - 1, (2, 70, 90)).astype(np.float32)


def test_values_between_pixels_equal_the_cubic_spline_up_to_the_border(image, places):
    x, y = places
    exact = ndimage.map_coordinates(image.astype(float), [y, x], order=3, mode="mirror")
    found = sample_points(spline_coefficients(image), x, y)
    # single precision of places near 100: 8e-6 px, times a slope of up to one per pixel
    np.testing.assert_allclose(found, exact, atol=5e-5)


def test_values_at_pixels_are_the_pixels(image):
    y, x = np.indices(image.shape, dtype=np.float32)
    np.testing.assert_allclose(sample_points(spline_coefficients(image), x, y), image, atol=5e-6)
