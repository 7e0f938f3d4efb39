"""The ground at points of images, by parallax and on terrain models."""

import numpy as np
import pytest

from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.measure.ground_point import (
    UP,
    ground_normal,
    intersect_terrain,
    matched_pixel,
    range_to_ground,
    sight_by_parallax,
    triangulate_pixel,
)
from solmap.photogrammetry.terrain.visibility.viewshed import Sight
from tests.unit.terrain.conftest import looking
from tests.unit.terrain.measure.test_oriented_image import FOCAL_PX, image, pose


def slope(places):
    """Rises 1 in 10 to the north."""
    return 0.1 * places[:, 1]


def test_a_ray_meets_a_slope_at_their_intersection(rng):
    start = np.array([0.0, 0.0, -1.5])
    for _ in range(20):
        target = np.array([rng.uniform(3, 30), rng.uniform(-10, 10), 0.0])
        target[2] = -0.1 * target[0]
        distance = np.linalg.norm(target - start)
        found = range_to_ground(start, (target - start) / distance, slope, 60.0, 0.05)
        assert found == pytest.approx(distance, abs=1e-4)


def test_a_ray_into_the_sky_or_into_unseen_ground_meets_nothing():
    start = np.array([0.0, 0.0, -1.5])

    def with_gap(places):
        return np.where((places[:, 1] > 4) & (places[:, 1] < 6), np.nan, 0.0)

    up = np.array([1.0, 0.0, -0.2]) / np.hypot(1.0, 0.2)
    assert range_to_ground(start, up, slope, 60.0, 0.05) is None
    into = np.array([5.0, 0.0, 1.5]) / np.hypot(5.0, 1.5)
    assert range_to_ground(start, into, with_gap, 60.0, 0.05) is None


def test_the_first_of_two_ridges_is_met():
    def ridges(places):
        return np.where(np.abs(places[:, 1] % 10 - 5) < 0.5, 1.0, 0.0)

    start, ray = np.array([0.0, 0.0, -1.5]), np.array([20.0, 0.0, 1.0])
    found = range_to_ground(start, ray / np.linalg.norm(ray), ridges, 60.0, 0.02)
    assert found * 20 / np.linalg.norm(ray) == pytest.approx(14.5, abs=0.03)


def test_the_normal_is_that_of_the_slope():
    normal = MAP_FROM_LSL @ ground_normal(np.array([3.0, 4.0]), slope, 0.25)
    assert normal == pytest.approx(np.array([0.0, -0.1, 1.0]) / np.hypot(0.1, 1.0))
    assert ground_normal(np.zeros(2), lambda p: np.full(len(p), np.nan), 0.25) == pytest.approx(UP)


def test_the_covariance_on_terrain_agrees_with_simulated_errors(rng):
    seen = image(pose(0), pointing=1e-3)
    pixel = np.array([500.0, 700.0])
    start, ray = seen.ray(pixel)
    distance = range_to_ground(start, ray, slope, 60.0, 0.02)
    met = start + distance * ray
    normal = ground_normal(met[[1, 0]], slope, 0.25)
    drawn = []
    for _ in range(3000):
        lift, turn = rng.normal(0, 0.02), rng.normal(0, 1e-3, 3)
        off = seen.camera.rays((pixel + rng.normal(0, 0.5, 2))[None])[0]
        begin = start + np.cross(turn, start - seen.pivot_in_lsl)
        off = off + np.cross(turn, off)
        t = (normal @ (met + lift * UP - begin)) / (normal @ off)
        drawn.append(begin + t * off)
    found = intersect_terrain(seen, met, ray, (normal, 0.02, pose(0)), 0.5, 1 / FOCAL_PX)
    assert np.cov(np.array(drawn).T) == pytest.approx(found.covariance, rel=0.15, abs=2e-5)


def test_a_matched_pixel_has_the_ground_of_its_pair():
    geometry, lsl_from_pair = looking(30.0, 12.0)
    point = lsl_from_pair.apply(np.array([[0.5, 0.8, 7.0]]))
    left, parallax = geometry.project(lsl_from_pair.inverse.apply(point))
    found = triangulate_pixel(
        image(), geometry, lsl_from_pair, left[0], float(parallax[0]), (0.1, 0.2)
    )
    assert found.point == pytest.approx(point[0])
    along = (point[0] - lsl_from_pair.translation_m) / np.linalg.norm(
        point[0] - lsl_from_pair.translation_m
    )
    sigma_z = 7.0**2 * 0.2 / (geometry.focal_px * geometry.base_m)
    assert np.sqrt(along @ found.covariance @ along) == pytest.approx(sigma_z, rel=0.03)


def test_the_total_covariance_adds_that_of_the_stop():
    shift = np.diag([0.0, 0.0, 0.0, 0.3, 0.2, 0.1]) ** 2
    seen = image(pose(1, covariance=shift))
    frame = Frame(FrameKind.PAIR, (0,))
    lsl_from_pair = Pose(LSL, frame, np.eye(3), np.zeros(3))
    geometry, _ = looking(0.0, 0.0)
    found = triangulate_pixel(
        seen, geometry, lsl_from_pair, np.array([100.0, 100.0]), 10.0, (0.1, 0.1)
    )
    extra = found.total_covariance - MAP_FROM_LSL @ found.covariance @ MAP_FROM_LSL.T
    assert np.sqrt(np.diagonal(extra)) == pytest.approx([0.2, 0.3, 0.1])


GEOMETRY, LSL_FROM_PAIR = looking(0.0, 15.0)
LEFT, RIGHT = GEOMETRY.cameras()


def ramp():
    """Parallax grows down the image, as on a plane, and a rock stands in it."""
    lines = np.arange(GEOMETRY.lines, dtype=np.float32)[:, None]
    parallax = np.broadcast_to(2.0 + 0.05 * lines, (GEOMETRY.lines, GEOMETRY.samples)).copy()
    parallax[100:120, 100:130] = 20.0
    parallax[:, :10] = np.nan
    return parallax


SIGMA = np.full((GEOMETRY.lines, GEOMETRY.samples), 0.15, np.float32)


def test_a_left_pixel_has_the_parallax_of_its_place():
    found = matched_pixel((60.3, 40.6), Eye.LEFT, LEFT, GEOMETRY, ramp(), SIGMA)
    assert found.left == pytest.approx((60.3, 40.6), abs=1e-6)
    assert found.parallax_px == pytest.approx(2.0 + 0.05 * 40.6, abs=1e-4)
    assert found.sigma_px == pytest.approx(0.15)


def test_a_right_pixel_has_the_parallax_of_its_left_match():
    left = (60.3, 40.0)
    right = (left[0] - 4.0, 40.0)
    found = matched_pixel(right, Eye.RIGHT, RIGHT, GEOMETRY, ramp(), SIGMA)
    assert found.left == pytest.approx(left, abs=1e-6)
    assert found.parallax_px == pytest.approx(4.0)


def test_of_two_left_matches_of_a_right_pixel_the_nearer_ground_is_used():
    on_rock = matched_pixel((90.0, 110.0), Eye.RIGHT, RIGHT, GEOMETRY, ramp(), SIGMA)
    assert on_rock.parallax_px == pytest.approx(20.0)


def test_unmatched_and_invisible_pixels_have_no_parallax():
    assert matched_pixel((4.0, 40.0), Eye.LEFT, LEFT, GEOMETRY, ramp(), SIGMA) is None
    assert matched_pixel((9999.0, 40.0), Eye.LEFT, LEFT, GEOMETRY, ramp(), SIGMA) is None
    assert matched_pixel((9999.0, 40.0), Eye.RIGHT, RIGHT, GEOMETRY, ramp(), SIGMA) is None


@pytest.mark.parametrize("eye", [Eye.LEFT, Eye.RIGHT])
def test_only_nearer_ground_hides_a_place(eye):
    def sight(left, parallax):
        point = GEOMETRY.triangulate(np.array([left]), np.array([parallax]))
        place = LSL_FROM_PAIR.apply(point)[0]
        known = 1e-6 * np.eye(3)
        return sight_by_parallax(place, known, LSL_FROM_PAIR, eye, GEOMETRY, ramp())

    assert sight((60.0, 40.0), 4.0) is Sight.VISIBLE
    behind = (110.0, 110.0) if eye is Eye.LEFT else (97.0, 110.0)
    assert sight(behind, 7.5) is Sight.HIDDEN
    assert sight((5.0, 40.0), 4.0) is Sight.UNKNOWN
