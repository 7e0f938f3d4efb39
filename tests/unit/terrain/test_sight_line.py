import numpy as np
import pytest

from solmap.photogrammetry.terrain.visibility.viewshed import Sight, sight_line, sight_line_stations

EYE = np.array([0.0, 0.0, 1.5])
TARGET = np.array([0.0, 20.0, 0.1])


def line(ground, eye=EYE, target=TARGET, max_unseen_m=4.0):
    places = sight_line_stations(eye, target, 0.1)
    return sight_line(eye, target, places, ground(places[:, 1]), max_unseen_m)


def flat(north):
    return np.zeros(len(north))


def test_flat_ground_is_in_sight_and_the_clearance_is_known():
    found = line(flat)
    assert found.sight is Sight.VISIBLE
    assert found.clearance_m == pytest.approx(0.1, abs=0.03)
    assert found.obstruction is None


def test_a_ridge_that_reaches_the_line_blocks_it_there():
    found = line(lambda north: np.where(np.abs(north - 12.0) < 0.25, 0.8, 0.0))
    assert found.sight is Sight.HIDDEN
    assert found.distance_m[found.obstruction] == pytest.approx(12.2, abs=0.06)
    assert found.clearance_m == pytest.approx(1.5 - 1.4 * 12.2 / 20 - 0.8, abs=0.01)
    lower = line(lambda north: np.where(np.abs(north - 12.0) < 0.25, 0.6, 0.0))
    assert lower.sight is Sight.VISIBLE


def test_a_long_unseen_stretch_leaves_it_open():
    def gap(width):
        return lambda north: np.where(np.abs(north - 10.0) < width / 2, np.nan, 0.0)

    assert line(gap(3.0)).sight is Sight.VISIBLE
    found = line(gap(6.0))
    assert found.sight is Sight.UNKNOWN
    assert found.unseen_m == pytest.approx(6.0, abs=0.2)


def test_known_ground_in_the_way_outweighs_unseen_ground():
    def both(north):
        return np.where(north < 8, np.nan, np.where(np.abs(north - 12) < 0.3, 1.0, 0.0))

    assert line(both).sight is Sight.HIDDEN


def test_the_unseen_ground_around_the_eye_does_not_count():
    assert line(lambda north: np.where(north < 6, np.nan, 0.0)).sight is Sight.VISIBLE


def test_where_nothing_is_known_nothing_is_said():
    found = line(lambda north: np.full(len(north), np.nan))
    assert found.sight is Sight.UNKNOWN
    assert found.clearance_m is None
