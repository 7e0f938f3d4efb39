"""The landscape is one surface, in any window."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.synthetic.lattice import Fractal, Window, bilinear, node_distance_m
from solmap.photogrammetry.synthetic.terrain import TERRAINS, RockField, Terrain, raise_rocks
from solmap.photogrammetry.terrain.dtm.grid import MapGrid


@pytest.mark.parametrize("kind", TERRAINS)
def test_two_windows_have_the_same_ground_where_they_overlap(kind):
    terrain = Terrain(5, kind)
    one = terrain.patch(Window(0, -210, 40, 400, 300))
    other = terrain.patch(Window(0, -75, 143, 200, 180))
    here = (slice(135, 335), slice(103, 283))
    np.testing.assert_allclose(one.elevation[here], other.elevation, atol=2e-6)  # float32, 10 m
    np.testing.assert_allclose(one.albedo[here], other.albedo, atol=2e-6)


@settings(max_examples=20, deadline=None)
@given(row=st.integers(-3000, 3000), col=st.integers(-3000, 3000), level=st.integers(0, 6))
def test_a_fractal_does_not_depend_on_the_window(row, col, level):
    fractal = Fractal(seed=2, stream=1, sigma=0.02, hurst=0.8)
    wide = fractal.values(Window(level, row, col, 60, 70))
    narrow = fractal.values(Window(level, row + 13, col + 22, 30, 31))
    np.testing.assert_allclose(wide[13:43, 22:53], narrow, atol=1e-5)


def test_different_seeds_give_different_ground():
    window = Window(0, 0, 0, 50, 50)
    assert np.abs(Terrain(1).soil(window) - Terrain(2).soil(window)).max() > 0.01


def test_relief_grows_with_distance_by_the_hurst_exponent():
    hurst = 0.75
    z = Fractal(seed=3, stream=1, sigma=0.02, hurst=hurst).values(Window(2, 0, 0, 1200, 1200))
    lags = np.array([4, 8, 16, 32, 64])
    deviation = [np.sqrt(np.mean((z[lag:] - z[:-lag]) ** 2)) for lag in lags]
    slope = np.polyfit(np.log(lags), np.log(deviation), 1)[0]
    assert slope == pytest.approx(hurst, abs=0.12)  # one realisation of 96 m


def test_elevations_are_those_of_the_nodes_and_linear_between_them():
    terrain = Terrain(8, "hills")
    patch = terrain.patch(Window(0, 100, -300, 40, 40))
    north, east = patch.window.north[7], patch.window.east[9]
    corners = patch.elevation[7:9, 9:11].astype(float)
    at_node = terrain.elevation(np.array([north]), np.array([east]))
    np.testing.assert_allclose(at_node, corners[0, 0], atol=1e-6)
    middle = terrain.elevation(np.array([north + 0.01]), np.array([east + 0.01]))
    np.testing.assert_allclose(middle, corners.mean(), atol=1e-6)


def test_outside_a_window_nothing_is_defined():
    values = np.ones((3, 4), np.float32)
    assert np.isnan(bilinear(values, np.array([-0.1, 1.0, 2.1]), np.array([0.0, 3.5, 1.0]))).all()


def test_wider_rocks_are_rarer_by_the_power_law():
    field = RockField(seed=4, per_m2=1.5, exponent=2.1, largest_m=1.2)
    window = Window(3, 0, 0, 600, 600)
    rocks = field.within(window, 0.05)
    rocks = rocks[(rocks[:, :2] >= 0).all(axis=1) & (rocks[:, :2] < 96).all(axis=1)]
    width = 2 * rocks[:, 3] * (rocks[:, 2] / rocks[:, 3]) ** (1 / 3)  # b = w / 2 / longer^0.5
    for at_least in (0.06, 0.12, 0.3):
        expected = 1.5 * (at_least / 0.05) ** -2.1
        assert np.mean(width > at_least) * len(width) / 96**2 == pytest.approx(expected, rel=0.25)


def test_no_rock_is_at_the_position_of_the_rover():
    field = RockField(seed=4, clearings=((3.0, 4.0),))
    window = Window.around(0, 3.0, 4.0, 3.0)
    relief, _ = raise_rocks(field.within(window, 0.05), window)
    near = np.hypot(window.north[:, None] - 3.0, window.east[None, :] - 4.0) < 1.2
    assert relief[near].max() < 0.15
    assert relief[~near].max() > 0.0


def test_a_crater_is_a_bowl_with_a_rim():
    terrain = Terrain(1, "crater")
    crater = terrain.craters[-1]
    along = np.array([0.0, 1.0, 3.0]) * crater.radius_m
    flat = Terrain(1, "plains")
    window = Window.covering(3, crater.north + along, np.array([crater.east, crater.east + 1]))
    bowl = terrain._bowls(window)[:, 0] - flat._bowls(window)[:, 0]
    row, _ = window.nodes_of(crater.north + along, np.full(3, crater.east))
    centre, rim, outside = bowl[np.rint(row).astype(int)]
    assert centre < -0.8 * crater.depth_m
    assert rim > 0.5 * crater.rim_m
    assert abs(outside) < 0.5 * rim


def test_the_true_map_runs_from_north_to_south():
    terrain = Terrain(6, "hills")
    grid = MapGrid(west=2.0, north=9.0, cell_m=0.5, rows=6, cols=4)
    east, north = grid.centres()
    z = terrain.elevation(north[:, None], east[None, :])
    assert z.shape == grid.shape
    assert z[0, 3] == pytest.approx(float(terrain.elevation(np.array([8.75]), np.array([3.75]))[0]))


def test_an_unknown_terrain_is_refused_with_the_choices():
    with pytest.raises(TerrainError, match=r"'dunes': choose from .*plains"):
        Terrain(1, "dunes")


def test_every_level_doubles_the_node_distance():
    assert [node_distance_m(level) for level in (0, 1, 3)] == [0.02, 0.04, 0.16]
