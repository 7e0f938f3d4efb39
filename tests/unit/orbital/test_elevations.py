"""Orbital terrain models whose true place and level are known: found, or honestly not."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.orbital.elevations import register_elevations
from solmap.photogrammetry.orbital.records import OrbitalDtm
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from tests.support.orbital_scenes import dtm_scene, place_error


@pytest.fixture(scope="module")
def crater():
    return dtm_scene(105)


def error(found, one):
    """East, north (m), rotation (rad) and scale, and the same in stated standard deviations."""
    off = place_error(found, one)
    return off, off / np.sqrt(np.diagonal(found.correction.covariance))


def test_an_orbital_terrain_model_is_registered_in_plan_and_height(crater):
    found = register_elevations(crater.ground, crater.model)
    assert found.reason == ""
    off, in_sigmas = error(found, crater)
    assert np.hypot(*off[:2]) < 1.0  # a cell
    assert np.abs(in_sigmas).max() < 3.0
    assert found.correction.up_m == pytest.approx(crater.up_m, abs=0.1)


def test_inverted_heights_are_refused(crater):
    upside = replace(crater.model, elevation=-crater.model.elevation)
    found = register_elevations(crater.ground, upside)
    assert found.correction is None
    assert found.reason


def test_heights_of_other_ground_are_refused(crater):
    found = register_elevations(crater.ground, dtm_scene(106).model)
    assert found.correction is None


def test_cells_of_another_size_are_refused(crater):
    grid = MapGrid(-60.0, 60.0, 2.0, 60, 60)
    model = OrbitalDtm(grid, np.zeros((60, 60), np.float32))
    with pytest.raises(OrbitalError, match="resample"):
        register_elevations(crater.ground, model)


@pytest.mark.slow
def test_of_ninety_scenes_none_is_registered_wrongly_and_sigmas_are_true():
    reported, levels = [], []
    for seed in (*range(100, 130), *range(200, 260)):
        one = dtm_scene(seed)
        found = register_elevations(one.ground, one.model)
        if found.correction is not None:
            reported.append(error(found, one)[1][:3])
            levels.append(found.correction.up_m - one.up_m)
    assert len(reported) >= 30
    assert np.abs(reported).max() < 3.5
    rms = np.sqrt(np.square(reported).mean(axis=0))
    assert ((rms > 0.7) & (rms < 1.3)).all()
    assert np.abs(levels).max() < 0.15
