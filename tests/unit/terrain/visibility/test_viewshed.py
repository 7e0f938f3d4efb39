"""Visibility on surfaces with a closed solution."""

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import GroundClass
from solmap.photogrammetry.terrain.visibility.viewshed import (
    Sight,
    ViewshedParams,
    sight_line,
    sight_line_stations,
    viewshed,
    viewshed_of_stop,
)

GRID = MapGrid(-20.0, 20.0, 0.16, 250, 250)
PARAMS = ViewshedParams(target_height_m=0.0)


def ground(surface):
    east, north = np.meshgrid(*GRID.centres())
    return surface(east, north).astype(np.float32)


def level(east, _):
    return 0 * east


def walled(east, north):
    """A wall of 1 m, 5 m north of the middle, 0.5 m thick."""
    return np.where((north > 5.0) & (north < 5.5) & (np.abs(east) < 3), 1.0, 0.0)


def by_walking(elevation, eye, row, col, target_m):
    """Whether the straight line to a cell's centre stays above the ground, each tenth of a cell."""
    east, north = GRID.centres()
    goal = np.array([east[col], north[row], elevation[row, col] + target_m])
    length = np.hypot(*(goal - eye)[:2]) / GRID.cell_m
    share = np.linspace(0, 1, max(2, int(10 * length)))[:, None]
    share = share[(share[:, 0] * length > 1) & ((1 - share[:, 0]) * length > 1)]
    e, n, up = (eye + share * (goal - eye)).T
    c, r = (e - GRID.west) / GRID.cell_m - 0.5, (GRID.north - n) / GRID.cell_m - 0.5
    c0, r0 = np.floor(c).astype(int), np.floor(r).astype(int)
    fc, fr = c - c0, r - r0
    height = (
        elevation[r0, c0] * (1 - fr) * (1 - fc)
        + elevation[r0 + 1, c0] * fr * (1 - fc)
        + elevation[r0, c0 + 1] * (1 - fr) * fc
        + elevation[r0 + 1, c0 + 1] * fr * fc
    )
    return bool((height <= up).all())


def test_level_ground_is_visible_to_the_requested_radius():
    sight = viewshed(ground(level), GRID, np.array([0, 0, 1.5]), PARAMS)
    assert (sight == Sight.VISIBLE).all()
    near = viewshed(ground(level), GRID, np.array([0, 0, 1.5]), ViewshedParams(radius_m=10.0))
    east, north = np.meshgrid(*GRID.centres())
    assert ((near == Sight.VISIBLE) == (np.hypot(east, north) <= 10.0)).mean() > 0.999


def test_the_shadow_of_a_wall_follows_the_eye_height():
    sight = viewshed(ground(walled), GRID, np.array([0.0, 0.0, 1.5]), PARAMS)
    east, north = GRID.centres()
    middle = sight[:, np.abs(east) < 0.2]
    # over the wall's far edge: 1.5 m above ground, 0.5 m above the wall, so 3 times as far
    hidden = north[(middle == Sight.HIDDEN).all(axis=1)]
    assert hidden.min() == pytest.approx(5.6, abs=0.2)
    edge = north[(north > 5.0) & (north < 5.5)].max()
    assert hidden.max() == pytest.approx(3 * edge, abs=0.5)
    assert (sight[:, np.abs(east) > 15][north < 0] == Sight.VISIBLE).all()


def test_a_higher_target_is_visible_over_the_wall():
    eye = np.array([0.0, 0.0, 1.5])
    low = viewshed(ground(walled), GRID, eye, PARAMS)
    high = viewshed(ground(walled), GRID, eye, ViewshedParams(target_height_m=1.0))
    assert (low == Sight.HIDDEN).sum() > 3 * (high == Sight.HIDDEN).sum()


def test_visible_ground_equals_what_a_straight_line_reaches(rng):
    def dunes(east, north):
        return 0.8 * np.sin(north / 2) + 0.6 * np.cos(east / 1.7)

    elevation, eye = ground(dunes), np.array([1.0, -2.0, 1.6])
    params = ViewshedParams(target_height_m=0.05)
    sight = viewshed(elevation, GRID, eye, params)
    rows, cols = rng.integers(2, 247, (2, 1500))
    seen = [by_walking(elevation, eye, r, c, 0.05) for r, c in zip(rows, cols, strict=True)]
    agree = (sight[rows, cols] == Sight.VISIBLE) == np.array(seen)
    assert 0.2 < np.mean(seen) < 0.8
    assert agree.mean() > 0.97  # the rest lies on the edge of a shadow, half a cell off


def test_ground_without_elevation_is_unknown_and_hides_nothing():
    elevation = ground(level)
    elevation[:, 100:110] = np.nan  # a gap of 1.6 m
    sight = viewshed(elevation, GRID, np.array([0.0, 0.0, 1.5]), PARAMS)
    assert (sight[:, 100:110] == Sight.UNKNOWN).all()
    east, north = np.meshgrid(*GRID.centres())
    across = (east < -5) & (np.abs(north) < 5)
    assert (sight[across & (sight != Sight.UNKNOWN)] == Sight.VISIBLE).all()


def test_ground_beyond_a_long_unseen_stretch_is_unknown_unless_it_is_hidden():
    elevation = ground(walled)
    east, north = np.meshgrid(*GRID.centres())
    elevation[(north > 6.0) & (north < 12.0)] = np.nan
    elevation[np.hypot(east, north) < 3.0] = np.nan  # below the mast
    sight = viewshed(elevation, GRID, np.array([0.0, 0.0, 1.5]), PARAMS)
    beyond = (north > 12.5) & (north < 15.0)
    assert (sight[beyond & (np.abs(east) < 4)] == Sight.HIDDEN).all()
    assert (sight[beyond & (east > 15)] == Sight.UNKNOWN).all()
    assert (sight[(north < -5)] == Sight.VISIBLE).all()


def test_an_eye_outside_the_map_is_accepted():
    sight = viewshed(ground(level), GRID, np.array([40.0, 0.0, 1.5]), PARAMS)
    assert (sight == Sight.VISIBLE).all()


def test_ground_occluded_from_a_stop_is_hidden(scenes):
    dtm = scenes.dtm_of(scenes.level, side=512)
    east, north = np.meshgrid(*dtm.grid.centres())
    occluded = (north > 4.0) & (np.abs(east) < 1.0)
    dtm.elevation[(north > 4.0) & (np.abs(east) < 3.0)] = np.nan
    dtm.ground[(north > 4.0) & (np.abs(east) < 3.0)] = GroundClass.UNSEEN
    dtm.ground[occluded] = GroundClass.OCCLUDED
    # ground seen over more than 4 m of unseen ground, and some beyond reach
    sight, grid = viewshed_of_stop(dtm, np.array([0.0, 0.0, 1.5]), ViewshedParams())
    assert grid.cell_m == 0.16
    near, _ = viewshed_of_stop(dtm, np.array([0.0, 0.0, 1.5]), ViewshedParams(radius_m=2.0))
    assert 0 < (near > 0).sum() < np.pi * (2.2 / 0.16) ** 2
    east, north = np.meshgrid(*grid.centres())
    inside = (north > 4.2) & (north < 10.0)
    assert (sight[inside & (np.abs(east) < 0.8)] == Sight.HIDDEN).all()
    assert (sight[inside & (np.abs(east) > 1.2) & (np.abs(east) < 2.8)] == Sight.UNKNOWN).all()
    assert (sight[inside & (np.abs(east) > 3.2) & (np.abs(east) < 10.0)] == Sight.VISIBLE).all()


EYE = np.array([0.0, 0.0, 1.5])
TARGET = np.array([0.0, 20.0, 0.1])


def line(ground, eye=EYE, target=TARGET, max_unseen_m=4.0):
    places = sight_line_stations(eye, target, 0.1)
    return sight_line(eye, target, places, ground(places[:, 1]), max_unseen_m)


def flat(north):
    return np.zeros(len(north))


def test_flat_ground_is_in_sight_with_its_clearance():
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


def test_a_long_unseen_stretch_leaves_visibility_open():
    def gap(width):
        return lambda north: np.where(np.abs(north - 10.0) < width / 2, np.nan, 0.0)

    assert line(gap(3.0)).sight is Sight.VISIBLE
    found = line(gap(6.0))
    assert found.sight is Sight.UNKNOWN
    assert found.unseen_m == pytest.approx(6.0, abs=0.2)


def test_known_obstacles_outweigh_unseen_ground():
    def both(north):
        return np.where(north < 8, np.nan, np.where(np.abs(north - 12) < 0.3, 1.0, 0.0))

    assert line(both).sight is Sight.HIDDEN


def test_unseen_ground_around_the_eye_does_not_count():
    assert line(lambda north: np.where(north < 6, np.nan, 0.0)).sight is Sight.VISIBLE


def test_without_known_ground_visibility_is_unknown():
    found = line(lambda north: np.full(len(north), np.nan))
    assert found.sight is Sight.UNKNOWN
    assert found.clearance_m is None
