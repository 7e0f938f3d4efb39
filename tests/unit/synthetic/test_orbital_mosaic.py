"""The orbital image of a simulated world shows its ground, with the error it states."""

import numpy as np
import pytest

from solmap.photogrammetry.orbital.records import GroundMap, OrbitalImage
from solmap.photogrammetry.orbital.registration import register
from solmap.photogrammetry.synthetic.lattice import Window
from solmap.photogrammetry.synthetic.lighting import ground_radiance
from solmap.photogrammetry.synthetic.orbital import MOST_CELLS, orbital_mosaic, resampled, turn
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

WHERE_IT_IS = np.eye(2)


@pytest.fixture(scope="module")
def world():
    return make_world(WorldParams("hills", TraverseParams(stops=2)), 1)


def test_registration_to_the_true_ground_finds_the_stated_error(world):
    image = orbital_mosaic(world)
    grid = MapGrid(-32.0, 40.0, 0.25, 256, 256)
    patch = world.terrain.patch(Window.around(3, 0.0, 0.0, 48.0))
    window = patch.window
    lit = ground_radiance(patch.elevation, window.cell_m, world.stops[0].sun) * patch.albedo
    elevation, brightness = (
        resampled(nodes, window, grid, WHERE_IT_IS, (0.0, 0.0)) for nodes in (patch.elevation, lit)
    )
    found = register(
        GroundMap(grid, elevation, brightness), OrbitalImage(image.grid, image.brightness)
    ).correction
    assert found is not None
    middle = np.array([[0.0, 8.0]])
    error = image.error
    truly = middle @ turn(error.rotation_deg).T + [error.east_m, error.north_m]
    np.testing.assert_allclose(found.apply(middle), truly, atol=0.1)
    assert found.rotation_deg == pytest.approx(error.rotation_deg, abs=0.15)


def test_a_world_has_one_orbital_image(world):
    one, again = orbital_mosaic(world), orbital_mosaic(world)
    np.testing.assert_array_equal(one.brightness, again.brightness)
    assert one.error == again.error


@pytest.mark.parametrize("stops", [1, 60])
def test_the_image_contains_all_stops_in_a_bounded_number_of_cells(stops):
    world = make_world(WorldParams("plains", TraverseParams(stops=stops)), 3)
    image = orbital_mosaic(world)
    west, south, east, north = image.grid.bounds
    places = np.array([stop.lsl_from_rover.translation_m[:2] for stop in world.stops])
    assert np.all(places > [south + 50, west + 50])
    assert np.all(places < [north - 50, east - 50])
    assert max(image.grid.shape) <= MOST_CELLS
    assert np.isfinite(image.brightness).all()
