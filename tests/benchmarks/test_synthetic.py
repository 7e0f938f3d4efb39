"""How long the synthetic world takes, a question each."""

import pytest

from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.synthetic import lighting
from solmap.photogrammetry.synthetic.downlink import render_jobs
from solmap.photogrammetry.synthetic.render import first_hits, photograph, view_of
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world


@pytest.fixture(scope="module")
def world():
    return make_world(WorldParams(terrain="hills"), rng_seed=1)


def test_making_a_world_of_two_stops(benchmark):
    benchmark.pedantic(make_world, args=(WorldParams(terrain="hills"), 1), rounds=3)


def test_lighting_the_ground_of_a_stop(benchmark, world):
    def lit():
        lighting._light.cache_clear()
        return world.ground(0)

    assert len(benchmark.pedantic(lit, rounds=3).layers) == 4


def test_rendering_an_image_of_a_million_pixels(benchmark, world):
    world.ground(0)
    pixels = benchmark.pedantic(photograph, args=(world, world.shots[0], Eye.LEFT), rounds=5)
    assert pixels.shape == (1024, 1024)


def test_rendering_and_writing_an_image(benchmark, world):
    world.ground(0)
    file = benchmark.pedantic(render_jobs(world)[0].run, args=(world,), rounds=3)
    assert len(file.data) > 2 * 1024**2


def test_the_true_ground_of_a_million_pixels(benchmark, world):
    view, _ = view_of(world, world.shots[0], Eye.LEFT)
    points = benchmark.pedantic(first_hits, args=(world.ground(0), view), rounds=3)
    assert points.shape == (1024**2, 3)
