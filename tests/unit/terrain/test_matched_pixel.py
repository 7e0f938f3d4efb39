import numpy as np
import pytest

from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.terrain.measure.ground_point import (
    matched_pixel,
    sight_by_parallax,
)
from solmap.photogrammetry.terrain.visibility.viewshed import Sight
from tests.unit.terrain.conftest import looking

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


def test_a_right_pixel_has_that_of_the_left_one_it_was_matched_with():
    left = (60.3, 40.0)
    right = (left[0] - 4.0, 40.0)
    found = matched_pixel(right, Eye.RIGHT, RIGHT, GEOMETRY, ramp(), SIGMA)
    assert found.left == pytest.approx(left, abs=1e-6)
    assert found.parallax_px == pytest.approx(4.0)


def test_of_two_left_pixels_that_end_at_one_right_pixel_the_nearer_ground_is_seen():
    on_rock = matched_pixel((90.0, 110.0), Eye.RIGHT, RIGHT, GEOMETRY, ramp(), SIGMA)
    assert on_rock.parallax_px == pytest.approx(20.0)


def test_what_was_not_matched_or_is_not_shown_has_none():
    assert matched_pixel((4.0, 40.0), Eye.LEFT, LEFT, GEOMETRY, ramp(), SIGMA) is None
    assert matched_pixel((9999.0, 40.0), Eye.LEFT, LEFT, GEOMETRY, ramp(), SIGMA) is None
    assert matched_pixel((9999.0, 40.0), Eye.RIGHT, RIGHT, GEOMETRY, ramp(), SIGMA) is None


@pytest.mark.parametrize("eye", [Eye.LEFT, Eye.RIGHT])
def test_nearer_ground_hides_a_place_and_the_ground_itself_does_not(eye):
    def sight(left, parallax):
        point = GEOMETRY.triangulate(np.array([left]), np.array([parallax]))
        place = LSL_FROM_PAIR.apply(point)[0]
        known = 1e-6 * np.eye(3)
        return sight_by_parallax(place, known, LSL_FROM_PAIR, eye, GEOMETRY, ramp())

    assert sight((60.0, 40.0), 4.0) is Sight.VISIBLE
    behind = (110.0, 110.0) if eye is Eye.LEFT else (97.0, 110.0)
    assert sight(behind, 7.5) is Sight.HIDDEN
    assert sight((5.0, 40.0), 4.0) is Sight.UNKNOWN
