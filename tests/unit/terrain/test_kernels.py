"""Compiled loops of terrain models, against the same formulas for one cell or profile at a time."""

import itertools

import numpy as np
import pytest

from solmap.photogrammetry.terrain import kernels

SIDE = 24
LATTICE = (8, 8, np.float32(0.5), np.float32(4.0), np.float32(4.0))
NAN = float("nan")


@pytest.fixture
def planes(rng):
    """Points of a view over uneven ground; a tenth of them unknown."""
    east, north = np.meshgrid(np.linspace(-1.7, 1.7, SIDE), np.linspace(1.7, -1.7, SIDE))
    made = np.stack([east, north, 0.3 * rng.normal(size=(SIDE, SIDE))]).astype(np.float32)
    made[:, rng.random((SIDE, SIDE)) < 0.1] = NAN
    return made


@pytest.fixture
def parallax(rng):
    return rng.uniform(5, 9, (SIDE, SIDE)).astype(np.float32)


def cells_of(points):
    east, north, _ = points.astype(np.float64)
    return np.floor(4 - north / 0.5) * 8 + np.floor(4 + east / 0.5)


def test_points_of_pixels_lie_on_their_rays(parallax, rng):
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    across, down = (np.arange(SIDE) - 11.5) / 40, (np.arange(SIDE) - 12.5) / 40
    parallax[3, 4] = NAN
    found = kernels.points_of_pixels(
        parallax, rotation, across, down, np.float32(20), np.float32(3)
    )
    rays = np.stack(np.broadcast_arrays(across[None], down[:, None], 1.0))
    expected = np.einsum("ij,jyx->iyx", rotation, rays) * (20 / parallax)
    expected[:, np.hypot(*expected[:2]) > 3] = NAN
    assert 0 < np.isnan(expected[0]).sum() < expected[0].size
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)


def test_squares_have_four_short_sides(planes, parallax):
    found = kernels.continuous_squares(planes, parallax, np.float32(2.5), np.float32(0.16))
    for y, x in np.ndindex(SIDE - 1, SIDE - 1):
        corners = [(y, x), (y, x + 1), (y + 1, x + 1), (y + 1, x), (y, x)]
        is_whole = all(
            abs(parallax[a] - parallax[b]) <= 2.5
            and np.hypot(*(planes[:2, *a] - planes[:2, *b])) <= 0.16
            for a, b in itertools.pairwise(corners)
        )
        assert found[y, x] == is_whole
    assert found.any()
    assert not found.all()
    assert not found[-1].any()
    assert not found[:, -1].any()


def test_only_corners_of_squares_are_kept(planes):
    squares = np.zeros((SIDE, SIDE), np.bool_)
    squares[4, 7] = True
    kept = kernels.without_isolated(planes, squares)
    expected = np.full_like(planes, NAN)
    expected[:, 4:6, 7:9] = planes[:, 4:6, 7:9]
    np.testing.assert_array_equal(kept, expected)


def test_the_upper_level_of_a_cell_explains_its_scatter(planes, parallax, rng):
    sigma_px = rng.uniform(0.1, 0.3, (SIDE, SIDE)).astype(np.float32)
    slope_m = 0.12
    found = kernels.upper_levels(planes, parallax, sigma_px, LATTICE, np.float32(0.25), slope_m)
    known, splits = np.isfinite(planes[0]), 0
    for cell in range(64):
        inside = known & (cells_of(planes) == cell)
        heights = planes[2][inside].astype(np.float64)
        if not len(heights):
            assert not found[:, cell].any()
            continue
        noise = np.mean(0.25 / parallax[inside] * np.abs(heights))
        for _ in range(kernels.SPLITS):
            if heights.std() <= np.hypot(2 * noise, slope_m):
                break
            heights = heights[heights > heights.mean()]
            splits += 1
        expected = len(heights), heights.mean(), heights.std(), np.mean(sigma_px[inside] ** 2)
        np.testing.assert_allclose(found[:, cell], expected, rtol=1e-5, atol=1e-7)
    assert splits > 10


def test_the_mesh_covers_cells_without_points(planes):
    squares = np.isfinite(planes[0])
    squares &= (
        np.roll(squares, -1, 0) & np.roll(squares, -1, 1) & np.roll(squares, (-1, -1), (0, 1))
    )
    squares[-1] = squares[:, -1] = False
    measured = np.zeros((1, 64))
    measured[0, ::3] = 1
    spacing = 0.06
    found = kernels.cells_of_mesh(planes, squares, measured, LATTICE, np.float32(spacing))
    expected = np.zeros((3, 64))
    for y, x in np.argwhere(squares):
        corner = planes[:, y : y + 2, x : x + 2].astype(np.float64)
        down = np.hypot(*(corner[:2, 1] - corner[:2, 0])).max()
        across = np.hypot(*(corner[:2, :, 1] - corner[:2, :, 0])).max()
        parts = int(np.ceil(down / spacing)), int(np.ceil(across / spacing))
        for i, j in np.ndindex(parts):
            t, s = (i + 0.5) / parts[0], (j + 0.5) / parts[1]
            above, below = (row @ (1 - s, s) for row in np.moveaxis(corner, 1, 0))
            point = above * (1 - t) + below * t
            cell = int(cells_of(point[:, None])[0])
            if not measured[0, cell]:
                expected[:, cell] += 1, point[2], down * t * (1 - t)
    assert expected[0].any()
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_ground_behind_a_rise_is_hidden():
    """A camera 1.5 m above level ground with a wall at 4 m, and a gap beyond it."""
    distance = np.arange(1, 21, dtype=np.float32)
    height = np.full((20, 3), np.float32(-1.5))
    height[3:4, 0] = -0.5  # the wall, in the first profile only
    height[5:10] = NAN
    height[15:, 2] = NAN
    nothing = np.full(3, np.float32(np.inf)), np.zeros(3, np.float32)
    supposed, hidden = kernels.hidden_along(
        height, distance, *nothing, np.float32(0.001), np.float32(0.4)
    )
    np.testing.assert_array_equal(supposed[4:], np.float32(-1.5))
    assert hidden[5:10, 0].all()
    assert not hidden[:, 1:].any()
    assert not hidden[10:, 0].any()


def test_gaps_are_supposed_as_low_as_the_lower_side():
    height = np.array([[NAN], [-1.0], [NAN], [-2.0], [NAN]], np.float32)
    supposed, _ = kernels.hidden_along(
        height,
        np.arange(1, 6, dtype=np.float32),
        np.full(1, np.float32(np.inf)),
        np.zeros(1, np.float32),
        np.float32(0.001),
        np.float32(0.4),
    )
    np.testing.assert_array_equal(supposed[:, 0], np.float32([-1, -1, -2, -2, -2]))


def test_ground_between_a_rise_and_far_ground_is_hidden_by_the_jump():
    """The image jumps from a crest to ground far beyond: a plane between would pass very near."""
    height = np.full((30, 2), np.float32(-1.5))
    height[9] = -0.2
    height[10:] = NAN
    distance = np.arange(1, 31, dtype=np.float32)
    beyond = np.float32([-0.015, np.inf]), np.float32([1 / 200, 0])
    _, hidden = kernels.hidden_along(height, distance, *beyond, np.float32(0.0001), np.float32(0.4))
    assert hidden[10:, 0].all()
    assert not hidden[:, 1].any()
