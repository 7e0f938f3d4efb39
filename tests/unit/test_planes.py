"""Planes through nine cells, beside those fitted over windows."""

import numpy as np
import pytest

from solmap.photogrammetry.planes import nine_cell_gradients, window_gradients


@pytest.mark.parametrize("missing", [0.0, 0.1, 0.4, 0.8, 1.0])
def test_planes_through_nine_cells_equal_those_fitted_over_three(rng, missing):
    elevation = rng.normal(-1900.0, 0.05, (60, 70)).astype(np.float32)
    elevation[rng.random(elevation.shape) < missing] = np.nan
    quick = nine_cell_gradients(elevation, 0.08)[:, 1:-1, 1:-1]
    fitted = window_gradients(elevation, 0.08, 0.24)[:, 1:-1, 1:-1]
    np.testing.assert_array_equal(np.isnan(quick), np.isnan(fitted))
    assert np.isfinite(quick).any() == (missing < 1.0)
    # 1900 m have steps of 0.12 mm in single precision, which both start from.
    np.testing.assert_allclose(quick, fitted, atol=2e-3)


def test_a_tilted_plane_has_one_gradient_with_any_missing_cells(rng):
    east, north = np.meshgrid(np.arange(40) * 0.5, np.arange(30)[::-1] * 0.5)
    elevation = (0.3 * east - 0.2 * north).astype(np.float32)
    elevation[rng.random(elevation.shape) < 0.3] = np.nan
    found = nine_cell_gradients(elevation, 0.5)
    known = np.isfinite(found[0])
    assert known.sum() > 500
    np.testing.assert_allclose(found[0][known], 0.3, atol=1e-5)
    np.testing.assert_allclose(found[1][known], -0.2, atol=1e-5)


def test_the_outermost_cells_have_no_gradient():
    found = nine_cell_gradients(np.zeros((5, 6), np.float32), 1.0)
    np.testing.assert_array_equal(np.isfinite(found).sum(axis=(1, 2)), [12, 12])
