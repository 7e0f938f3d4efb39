import numpy as np
import pytest

from solmap.photogrammetry.matching.cross_site.ground_views import (
    LONGEST,
    common_cells,
    limit_resolution,
    smallest_stretch,
)


def ellipse(along_m, across_m, azimuth):
    """C of a pixel that is so long along its view."""
    u = np.array([np.cos(azimuth), np.sin(azimuth)])
    n = np.array([-u[1], u[0]])
    return (along_m**2 * np.outer(u, u) + across_m**2 * np.outer(n, n))[None]


def longest_and_widest(cells):
    return np.linalg.svd(cells, compute_uv=False)[0]


def test_cells_are_as_large_as_the_pixel_of_either_image_in_every_direction(rng):
    for _ in range(20):
        one, other = (ellipse(*rng.uniform(0.01, 0.3, 2), rng.uniform(0, np.pi)) for _ in range(2))
        cells = common_cells(one, other, square_m=0.01)[0]
        for pixel in (one[0], other[0]):
            # G G' - C has no negative direction
            assert np.linalg.eigvalsh(cells @ cells.T - pixel).min() > -1e-12


def test_perpendicular_views_share_square_cells():
    cells = common_cells(ellipse(0.1, 0.01, 0.3), ellipse(0.1, 0.01, 0.3 + np.pi / 2), 0.01)
    np.testing.assert_allclose(longest_and_widest(cells), [0.1, 0.1])


def test_collinear_views_share_narrow_cells_only_where_they_are_long():
    short, long = (
        common_cells(ellipse(along, 0.01, 0.3), ellipse(along / 2, 0.01, 0.3 + np.pi), 0.2)
        for along in (0.15, 0.4)
    )
    np.testing.assert_allclose(longest_and_widest(short), [0.15, 0.15])
    np.testing.assert_allclose(longest_and_widest(long), [0.4, 0.1])  # of the area 0.2 x 0.2


def test_no_cell_is_a_strip():
    length, width = longest_and_widest(
        common_cells(ellipse(2.0, 0.01, 0.3), ellipse(2.0, 0.01, 0.3), 0.2)
    )
    assert length / width == pytest.approx(LONGEST)


def test_unknown_ground_has_no_cell():
    unknown = np.full((1, 2, 2), np.nan)
    assert np.isnan(common_cells(unknown, ellipse(0.1, 0.1, 0.0), 0.2)).all()


def test_cells_are_no_finer_than_requested():
    cells = limit_resolution(np.array([[[0.02, 0.0], [0.0, 0.3]]]), 0.05)
    np.testing.assert_allclose(cells[0], [[0.05, 0.0], [0.0, 0.3]])


def test_the_smallest_stretch_is_the_smaller_singular_value(rng):
    maps = rng.normal(size=(50, 2, 2))
    expected = np.linalg.svd(maps, compute_uv=False)[:, 1]
    np.testing.assert_allclose(smallest_stretch(maps), expected, atol=1e-9)
