import math

import numpy as np
import pytest

from solmap.photogrammetry.cameras.surface import (
    Plane,
    Sphere,
    linearised_on,
    perspective_along,
    points_on,
)
from solmap.photogrammetry.errors import CameraError


@pytest.fixture
def perspective(hazcam):
    return perspective_along(hazcam, 1024, 1024, math.radians(50))


@pytest.fixture
def pixels(perspective, rng):
    _, samples, lines = perspective
    return rng.uniform(0, 1, (500, 2)) * [samples - 1, lines - 1]


GROUND = Plane(np.array([0.0, 0.0, 1.0]), 0.294)  # wheels of MER on level ground


@pytest.mark.parametrize("surface", [Sphere(1.0), Sphere(8.0), GROUND])
def test_on_its_surface_the_perspective_image_is_exact(hazcam, perspective, pixels, surface):
    """The fisheye's own ray through the pixel found meets the point that the perspective saw."""
    camera = perspective[0]
    points = points_on(surface, camera.centre, camera.rays(pixels))
    seen = ~np.isnan(points).any(axis=1)
    assert seen.sum() > 200
    fisheye = linearised_on(hazcam, camera, surface)(pixels)
    origins, rays = hazcam.ray_origins(fisheye[seen]), hazcam.rays(fisheye[seen])
    miss_m = np.linalg.norm(np.cross(points[seen] - origins, rays), axis=1)
    np.testing.assert_allclose(miss_m, 0, atol=1e-11)
    np.testing.assert_allclose(camera.project(points[seen]), pixels[seen], atol=1e-8)


def test_off_its_surface_the_error_is_that_of_the_pupil_and_falls_with_distance(
    hazcam, perspective, pixels
):
    camera = perspective[0]
    one = linearised_on(hazcam, camera, Sphere(1.0))(pixels)
    wrong_px = [
        np.nanmax(np.abs(linearised_on(hazcam, camera, Sphere(rho))(pixels) - one))
        for rho in (0.5, 2.0, 1000.0)
    ]
    shift_m = np.linalg.norm(hazcam.ray_origins(one) - hazcam.c, axis=1).max()
    bounds = [1.2 * 600 * shift_m * abs(1 - 1 / rho) for rho in (0.5, 2.0, 1000.0)]
    assert all(0 < wrong < bound for wrong, bound in zip(wrong_px, bounds, strict=True))
    # Seen from the ground instead, 3 m and 30 m differ by a tenth of that.
    far = [linearised_on(hazcam, camera, Sphere(rho))(pixels) for rho in (3.0, 30.0)]
    assert np.nanmax(np.abs(far[0] - far[1])) < 0.4 * wrong_px[2]


def test_the_perspective_image_keeps_the_scale_of_the_middle(hazcam, perspective):
    camera, samples, lines = perspective
    assert samples == lines > 1024
    middle = np.array([[(samples - 1) / 2, (lines - 1) / 2]])
    np.testing.assert_allclose(camera.rays(middle)[0], hazcam.o, atol=1e-12)
    to_fisheye = linearised_on(hazcam, camera, Sphere(5.0))
    half = np.array([[0.5, 0.0]])
    step = to_fisheye(middle + half) - to_fisheye(middle - half)
    assert np.hypot(*step[0]) == pytest.approx(1.0, abs=0.02)
    edge = np.array([[-0.5, (lines - 1) / 2]])
    angle = math.degrees(math.acos(camera.rays(edge)[0] @ hazcam.o))
    assert angle == pytest.approx(50, abs=0.1)


def test_the_sky_is_not_on_the_ground(perspective):
    camera = perspective[0]
    up = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    points = points_on(GROUND, camera.centre, up)
    assert np.isnan(points[[0, 2]]).all()
    assert points[1, 2] == pytest.approx(0.294)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda _: Sphere(0.0), "radius of a sphere is above zero"),
        (lambda _: Plane(np.zeros(3), 1.0), "make no plane"),
        (lambda camera: perspective_along(camera, 1024, 1024, math.radians(89)), "up to 85"),
        (
            lambda camera: perspective_along(camera, 1024, 1024, 0.0),
            "reaches 0 degrees to either side",
        ),
    ],
)
def test_impossible_surfaces_and_fields_are_refused(hazcam, make, complaint):
    with pytest.raises(CameraError, match=complaint):
        make(hazcam)
