"""A stereo bar that is not as its labels have it is found from the images, and set right."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.matching.stereo.orientation import (
    turn_in_place,
    vertical_parallax,
)
from solmap.photogrammetry.synthetic.downlink import render_jobs
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.tasks.network.match import align_rows


@pytest.fixture(scope="module")
def pair():
    world = make_world(WorldParams("plains", TraverseParams(stops=1), pairs=1), 8)
    files = [job.run(world) for job in render_jobs(world)]
    return [read_image(file.data, file.path.rpartition("/")[2]) for file in files]


def test_a_straight_bar_is_left_alone(pair):
    _, turn = align_rows(*pair)
    assert turn is None


def test_a_bent_bar_is_found_to_a_twentieth_of_a_pixel(pair):
    left, right = pair
    bend = np.array([0.0006, -0.0007, 0.0005])  # radians: half a row and more
    camera = turn_in_place(right.image.camera, right.image.stop.frame, bend)
    bent = replace(right, image=replace(right.image, camera=camera))
    images, turn = align_rows(left, bent)
    np.testing.assert_allclose(turn, -bend, atol=8e-5)  # radians: 0.04 px at the edge
    assert abs(vertical_parallax(images).median_px) < 0.05


def test_images_that_do_not_belong_together_keep_their_labels(pair, rng):
    left, right = pair
    noise = rng.normal(1000.0, 50.0, right.pixels.shape).astype(np.float32)
    _, turn = align_rows(left, replace(right, pixels=noise))
    assert turn is None
