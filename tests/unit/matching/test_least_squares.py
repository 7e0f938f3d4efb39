"""Least-squares matching of patches, on textures whose shift is known."""

import numpy as np
import pytest
from scipy import ndimage

from solmap.photogrammetry.matching.least_squares import fit_patches

HALF, REACH = 10, 5
PATCHES = 400


def drawn(rng, noise, shape=((1.0, 0.0), (0.0, 1.0))):
    """(templates, searches, true shifts): the same textures twice, each with noise of its own."""
    shift = rng.uniform(-0.7, 0.7, (PATCHES, 2))
    size = 2 * (HALF + REACH) + 1
    row, column = np.mgrid[:size, :size] - (HALF + REACH)
    templates, searches = [], []
    for d in shift:
        texture = ndimage.gaussian_filter(rng.normal(size=(size + 20, size + 20)), 1.5) * 10
        at = np.linalg.solve(shape, np.stack([column.ravel(), row.ravel()]) - d[:, None])
        middle = (size + 19) / 2
        search = ndimage.map_coordinates(texture, (at + middle)[::-1], order=3).reshape(size, size)
        inner = slice(10 + REACH, 10 + REACH + 2 * HALF + 1)
        templates.append(texture[inner, inner])
        searches.append(1.3 * search + 5.0)
    both = [np.array(patches) for patches in (templates, searches)]
    a, b = ((p + noise * rng.normal(size=p.shape)).astype(np.float32) for p in both)
    return a, b, shift


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_noise_does_not_bias_matches(rng, noise):
    # slopes from neighbouring cells alone push by 0.05 cells and more at this noise
    templates, searches, shift = drawn(rng, noise)
    fits = fit_patches(templates, searches, np.zeros((PATCHES, 2)), 8)
    error = fits.shift - shift
    good = np.abs(error).max(axis=1) < 1.0
    assert good.mean() > 0.98
    assert np.abs(error[good].mean(axis=0)).max() < 4 * error[good].std() / PATCHES**0.5
    assert np.abs(error[good].mean(axis=0)).max() < 0.02


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_the_stated_sigma_is_that_of_the_errors(rng, noise):
    templates, searches, shift = drawn(rng, noise)
    fits = fit_patches(templates, searches, np.zeros((PATCHES, 2)), 8)
    z = (fits.shift - shift) / fits.sigma[:, None]
    assert 0.6 < 1.4826 * np.median(np.abs(z)) < 1.4  # the larger of both axes is stated


def test_a_change_of_shape_is_found_with_the_shift(rng):
    shape = np.array([[1.1, 0.05], [-0.04, 0.93]])
    templates, searches, shift = drawn(rng, 0.05, shape)
    fits = fit_patches(templates, searches, np.zeros((PATCHES, 2)), 8)
    np.testing.assert_allclose(np.median(fits.affine, axis=0), shape, atol=0.02)
    assert np.median(np.abs(fits.shift - shift)) < 0.02
    assert np.median(fits.correlation) > 0.98
    assert np.median(fits.last_step) < 0.01
