"""A small world for all tests of the package: two stops, pictures averaged over 4 x 4 pixels."""

import numpy as np
import pytest

from photogrammetry.synthetic.traverse import TraverseParams
from photogrammetry.synthetic.world import World, WorldParams, make_world

SMALL = WorldParams(
    terrain="hills",
    traverse=TraverseParams(stops=3, stops_per_site=2, slip=(0.05, 0.1)),
    pairs=2,
    pair_step=float(np.deg2rad(180)),
    pancam=True,
    averaging=4,
)


@pytest.fixture(scope="session")
def small_world() -> World:
    return make_world(SMALL, rng_seed=7)
