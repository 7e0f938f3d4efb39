"""The ground around a stop: its brightness under any sun, and the bias that its relief implies."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.matching.cross_site.ground_grid import (
    RELIEF_BAND_M,
    SHADOW_WAVE_M,
    GroundGrid,
)
from solmap.photogrammetry.matching.height_bias import LINES_PER_METRE, RELIEF_SIGMA, USUAL_BIAS

CELL_M, SIZE = 0.05, 240


@pytest.fixture
def albedo(rng):
    noise = rng.normal(size=(SIZE, SIZE)).astype(np.float32)
    return np.exp(0.5 * cv2.GaussianBlur(noise, (0, 0), 1.5))


@pytest.fixture
def grid(albedo):
    level = np.zeros((SIZE, SIZE), np.float32)
    return GroundGrid(CELL_M, level, 1.5, 240.0, 1200.0, brightness=albedo)


def test_detail_is_albedo_whatever_the_exposure_and_its_gradient(grid, albedo):
    slope = np.linspace(0.5, 2.0, SIZE, dtype=np.float32)[None, :]
    other = replace(grid, brightness=40 * slope * albedo)
    inside = (slice(20, -20),) * 2
    assert np.corrcoef(grid.detail[inside].ravel(), other.detail[inside].ravel())[0, 1] > 0.999
    assert np.std(grid.detail[inside]) == pytest.approx(1.0, abs=0.1)


def test_shadows_have_no_detail_and_change_none_beside_them(grid, albedo):
    dark = albedo.copy()
    dark[100:108, 100:108] *= 0.3
    shaded = replace(grid, brightness=dark)
    assert np.isnan(shaded.detail[102:106, 102:106]).all()
    aside = round(2 * SHADOW_WAVE_M / CELL_M)
    far = np.ones((SIZE, SIZE), bool)
    far[100 - aside : 108 + aside, 100 - aside : 108 + aside] = False
    np.testing.assert_allclose(shaded.detail[far], grid.detail[far], atol=0.05)
    near = ~far
    near[92:116, 92:116] = False
    known = np.isfinite(shaded.detail) & near
    assert known.mean() > 0.9 * near.mean()
    assert np.corrcoef(shaded.detail[known], grid.detail[known])[0, 1] > 0.95


def test_a_grid_without_brightness_has_no_detail(grid):
    assert np.isnan(replace(grid, brightness=None).detail).all()


def test_the_expected_height_bias_grows_with_the_relief(grid):
    """A wave of 1.5 m, of which Gaussians leave exp(-(2 pi sigma / 1.5)^2 / 2)."""
    wave_m, height_m = 1.5, 0.03
    east = np.arange(SIZE) * CELL_M
    up = np.tile(height_m * np.sin(2 * np.pi * east / wave_m), (SIZE, 1)).astype(np.float32)
    fine, coarse = (np.exp(-((2 * np.pi * s / wave_m) ** 2) / 2) for s in RELIEF_BAND_M)
    relief_m = height_m / np.sqrt(2) * (fine - coarse)
    found = replace(grid, up=up).expected_bias
    assert found.lines == pytest.approx(LINES_PER_METRE * relief_m, rel=0.05)
    assert found.sigma == RELIEF_SIGMA
    assert grid.expected_bias.lines == 0.0


def test_ground_not_seen_near_the_rover_has_the_usual_height_bias(grid):
    unseen = replace(grid, up=np.full_like(grid.up, np.nan))
    assert unseen.expected_bias == USUAL_BIAS
