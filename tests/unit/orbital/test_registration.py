"""Orbital images whose true place is known: found, or honestly not."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.orbital.records import Correction, GroundMap, OrbitalImage
from solmap.photogrammetry.orbital.registration import RegistrationParams, register
from solmap.photogrammetry.orbital.search import SearchParams
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from tests.support.orbital_scenes import middle_of, place_error, scene


@pytest.fixture(scope="module")
def hills():
    return middle_of(scene(109))


def off(found, one):
    return np.hypot(*place_error(found, one)[:2])


def test_a_rotated_and_shifted_image_under_another_sun_is_registered(hills):
    found = register(hills.ground, hills.image)
    assert found.reason == ""
    assert off(found, hills) < 0.25
    assert found.correction.rotation_deg == pytest.approx(hills.rotation_deg, abs=0.1)
    assert found.explained > 3 * found.runner_up


@pytest.mark.usefixtures("unchecked")
def test_an_uncontrolled_mosaic_is_registered_from_hundreds_of_metres():
    """Turned by up to three degrees and scaled by up to one percent as well."""
    one = middle_of(scene(109, uncontrolled=True))
    found = register(one.ground, one.image)
    assert found.reason == ""
    assert np.hypot(one.east_m, one.north_m) > 100.0
    error = place_error(found, one)
    assert np.hypot(*error[:2]) < 0.25
    assert np.abs(np.degrees(error[2])) < 0.1
    assert np.abs(error[3]) < 0.003
    assert (
        register(one.ground, one.image, RegistrationParams(SearchParams(12.0))).correction is None
    )


@pytest.mark.usefixtures("unchecked")
def test_a_negative_of_the_image_is_registered_at_the_same_place(hills):
    negative = replace(hills.image, brightness=255 - hills.image.brightness)
    assert off(register(hills.ground, negative), hills) < 0.25


@pytest.mark.usefixtures("unchecked")
def test_noise_is_not_registered(hills, rng):
    noise = replace(hills.image, brightness=rng.normal(size=hills.image.grid.shape).astype("f4"))
    found = register(hills.ground, noise)
    assert found.correction is None
    assert "undecided" in found.reason or "does not converge" in found.reason


@pytest.mark.usefixtures("unchecked")
def test_ground_outside_the_image_is_not_registered(hills):
    found = register(hills.ground, middle_of(scene(106)).image)
    assert found.correction is None


def test_flat_and_small_ground_is_refused_with_a_reason(hills):
    flat = replace(
        hills.ground,
        elevation=np.zeros_like(hills.ground.elevation),
        brightness=np.ones_like(hills.ground.brightness),
    )
    assert "flat and without contrast" in register(flat, hills.image).reason
    few = np.where(np.arange(160)[:, None] < 3, hills.ground.elevation, np.nan)
    few[:, 100:] = np.nan
    assert "too few" in register(replace(hills.ground, elevation=few), hills.image).reason


def test_cells_of_another_size_are_refused(hills):
    grid = MapGrid(-60.0, 60.0, 0.5, 288, 288)
    with pytest.raises(OrbitalError, match="resample"):
        register(hills.ground, OrbitalImage(grid, hills.image.brightness))


def test_a_correction_transforms_points_as_stated():
    correction = Correction(3.0, -1.0, 90.0, (10.0, 0.0), np.eye(4))
    np.testing.assert_allclose(correction.apply(np.array([[11.0, 0.0]])), [[13.0, 0.0]])


def test_rasters_of_another_shape_are_refused(hills):
    with pytest.raises(OrbitalError, match="cells on a grid"):
        GroundMap(hills.ground.grid, hills.ground.elevation[1:], hills.ground.brightness[1:])


@pytest.mark.slow
def test_of_thirty_scenes_none_is_registered_wrongly():
    wrong, reported, within = 0, 0, []
    for seed in range(100, 130):
        one = scene(seed)
        found = register(one.ground, one.image)
        if found.correction is None:
            continue
        reported += 1
        turn = abs(found.correction.rotation_deg - one.rotation_deg)
        wrong += off(found, one) > 0.25 or turn > 0.1
        within.append(off(found, one) / np.hypot(*found.correction.sigma_m))
    assert wrong == 0
    assert reported >= 27
    assert np.mean(np.array(within) < 2) > 0.8
