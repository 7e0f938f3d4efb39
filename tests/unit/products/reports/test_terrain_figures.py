"""Preview figures."""

from dataclasses import replace

import numpy as np

from solmap.photogrammetry.terrain.dtm.records import GroundClass
from solmap.photogrammetry.terrain.relief.slope import HillshadeParams
from solmap.products.reports.terrain_figures import (
    class_figure,
    relief_figure,
)
from tests.unit.terrain import conftest as scenes


def test_unseen_ground_is_transparent_in_every_figure():
    dtm = scenes.dtm_of(scenes.tilted)
    dtm.elevation[:20], dtm.ground[:20] = np.nan, GroundClass.UNSEEN
    for image in (relief_figure(dtm, HillshadeParams()), class_figure(dtm)):
        assert image.shape == (128, 128, 4)
        assert (image[:20, :, 3] == 0).all()
        assert (image[20:, :, 3] == 255).all()


def test_high_ground_has_another_colour_than_low_ground():
    image = relief_figure(scenes.dtm_of(lambda e, n: e + 0.0 * n), HillshadeParams())
    assert np.abs(image[64, 5].astype(int) - image[64, 120]).max() > 80


def test_classes_have_different_colours():
    dtm = scenes.dtm_of(scenes.level)
    dtm.ground[:, 64:] = GroundClass.INTERPOLATED
    image = class_figure(dtm)
    assert (image[10, 10] != image[10, 100]).any()


def test_a_large_figure_is_reduced():
    assert max(class_figure(scenes.dtm_of(scenes.level), max_side=50).shape) <= 50


def test_an_empty_model_gives_a_transparent_figure():
    dtm = scenes.dtm_of(scenes.level)
    empty = replace(dtm, elevation=np.full(dtm.grid.shape, np.nan, dtype=np.float32))
    assert (relief_figure(empty, HillshadeParams())[..., 3] == 0).all()
