"""Planes of windows and of nine cells of a raster."""

import numpy as np
import pytest

from solmap.photogrammetry.planes import fit_window_planes, nine_cell_gradients, window_gradients


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


def test_planes_of_windows_are_those_of_least_squares_with_any_missing_cells(rng):
    elevation = (rng.normal(-1900.0, 0.05, (40, 300))).astype(np.float32)  # two blocks
    elevation[rng.random(elevation.shape) < 0.3] = np.nan
    found = fit_window_planes(elevation, 0.5, 2.5)
    known = np.argwhere(np.isfinite(found.scatter))
    assert len(known) > 5000
    for row, col in [*known[:3], *known[-3:], *rng.choice(known, 40)]:
        rows, cols = (slice(max(0, at - 2), at + 3) for at in (row, col))
        height = elevation[rows, cols].astype(float)
        south, east = (steps[np.isfinite(height)] for steps in np.indices(height.shape) * 0.5)
        design = np.column_stack([east - east.mean(), south.mean() - south, np.ones_like(east)])
        height = height[np.isfinite(height)]
        plane, squares, *_ = np.linalg.lstsq(design, height)
        normal = design.T @ design
        np.testing.assert_allclose(found.gradient[:, row, col], plane[:2], atol=1e-6)
        scatter = np.sqrt(squares[0] / (len(height) - 3))
        assert found.scatter[row, col] == pytest.approx(scatter, rel=1e-5)
        shape = normal[0, 0], normal[0, 1], normal[1, 1]
        np.testing.assert_allclose(found.shape[:, row, col], shape, rtol=1e-5, atol=1e-5)
