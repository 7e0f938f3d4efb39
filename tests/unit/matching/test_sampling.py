"""Splines through pixels, against SciPy's in double precision."""

import numpy as np
import pytest
from scipy import ndimage

from solmap.photogrammetry.matching.resampling import (
    along_rows,
    at_points,
    coefficients_of,
    row_coefficients,
)

SIZE = 120


@pytest.fixture
def image(rng):
    return ndimage.gaussian_filter(rng.normal(0, 1, (SIZE, SIZE)), 1.0).astype(np.float32)


@pytest.fixture
def places(rng):
    return rng.uniform(0, SIZE - 1, (2, 70, 90)).astype(np.float32)


def test_values_between_pixels_are_those_of_the_cubic_spline_up_to_the_border(image, places):
    x, y = places
    exact = ndimage.map_coordinates(image.astype(float), [y, x], order=3, mode="mirror")
    found = at_points(coefficients_of(image), x, y)
    # single precision of places near 100: 8e-6 px, times a slope of up to one a pixel
    np.testing.assert_allclose(found, exact, atol=5e-5)


def test_values_at_pixels_are_the_pixels(image):
    y, x = np.indices(image.shape, dtype=np.float32)
    np.testing.assert_allclose(at_points(coefficients_of(image), x, y), image, atol=5e-6)


def test_values_along_rows_are_those_of_each_row_alone(image, places):
    x = places[0]
    y = np.repeat(np.arange(len(x), dtype=np.float32)[:, None], x.shape[1], axis=1)
    found = along_rows(row_coefficients(image), x, y)
    for row in (0, 33, 69):
        exact = ndimage.map_coordinates(image[row].astype(float), [x[row]], order=3, mode="mirror")
        np.testing.assert_allclose(found[row], exact, atol=5e-5)
