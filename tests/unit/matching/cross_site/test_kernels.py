"""Compiled loops over the ground of a pair, against the same formulas in NumPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.matching.cross_site import kernels

LINES, SAMPLES, SIZE, CELL_M = 61, 80, 40, 0.5
GRID = CELL_M, 10.1, SIZE
CAMERA = np.array([20.0, 100.0, 40.0, 10.0])
ORIGIN = np.array([0.1, -0.2, -1.4])
TO_LEVEL = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@pytest.fixture
def rotation():
    """From (right, down, forward) to (north, east, down): north-east, 12 degrees down."""
    return Rotation.from_euler("zy", [40, -12], degrees=True).as_matrix() @ TO_LEVEL


@pytest.fixture
def parallax(rng):
    """Of rough ground; NaN at gaps and beyond the horizon."""
    y = (np.arange(LINES) - CAMERA[3])[:, None] / CAMERA[1]
    depth = 1.4 / np.maximum(y + np.tan(np.radians(12)), 1e-3)
    rough = CAMERA[0] / depth * np.ones(SAMPLES) * rng.normal(1, 0.02, (LINES, SAMPLES))
    rough[rng.random(rough.shape) < 0.05] = np.nan
    return rough.astype(np.float32)


def ground(parallax, rotation):
    """(positions in the level frame, index of the cell or -1) of all pixels."""
    line, sample = np.indices(parallax.shape)
    ray = np.stack([(sample - 40.0) / 100, (line - 10.0) / 100, np.ones(parallax.shape)], axis=-1)
    places = CAMERA[0] / parallax.astype(float)[..., None] * ray @ rotation.T + ORIGIN
    row = np.floor((10.1 - places[..., 0]) / CELL_M)
    col = np.floor((10.1 + places[..., 1]) / CELL_M)
    inside = (row >= 0) & (row < SIZE) & (col >= 0) & (col < SIZE)
    inside &= np.hypot(places[..., 0], places[..., 1]) > kernels.ROVER_M
    return places, np.where(inside, row * SIZE + col, -1).astype(int)


def test_ground_is_summed_in_its_cells(parallax, rotation, rng):
    mask = rng.random(parallax.shape) > 0.1
    grey = rng.uniform(50, 200, parallax.shape).astype(np.float32)
    found = kernels.sum_ground((parallax, mask, grey), CAMERA, rotation, ORIGIN, 2.0, GRID)
    places, cell = ground(parallax, rotation)
    used = mask & (parallax > 2.0) & (cell >= 0)
    used[:, 1::2] = False
    assert used.sum() > 500
    sums = [
        np.bincount(cell[used], weight, SIZE * SIZE)
        for weight in (None, grey[used], -places[used, 2])
    ]
    np.testing.assert_allclose(found, sums, rtol=1e-9, atol=1e-9)


def test_facets_are_weighted_by_range_and_exclude_crests(parallax, rotation, rng):
    grey = rng.uniform(50, 200, parallax.shape).astype(np.float32)
    found = kernels.sum_facets((parallax, grey), CAMERA, rotation, ORIGIN, 9.0, GRID)
    places, cell = ground(parallax, rotation)
    p, k = parallax.astype(float), kernels.GRADIENT_PX
    line, sample = np.indices(p.shape)
    x, y = sample - 40.0, line - 10.0
    ray = np.sqrt(1 + (x / 100) ** 2 + (y / 100) ** 2)
    across, down = np.full((2, *p.shape), np.nan)
    across[:, k:-k] = (p[:, 2 * k :] - p[:, : -2 * k]) / (2 * k)
    down[k:-k] = (p[2 * k :] - p[: -2 * k]) / (2 * k)
    normal = np.stack([100 * across, 100 * down, p - across * x - down * y], axis=-1)
    level = np.stack([x / 100, y / 100, np.ones(p.shape)], axis=-1) @ rotation[2]
    # a facet of the slopes of parallax, seen along the ray
    facing = p / np.linalg.norm(normal, axis=-1)
    used = (cell >= 0) & (facing > np.minimum(kernels.LEAST_FACING * ray, level))
    used &= CAMERA[0] / p * ray < 9.0
    used[:, 1::2] = False
    used[1::2] &= p[1::2] < CAMERA[0] / kernels.DENSE_M
    assert 50 < used.sum() < 0.9 * ((cell >= 0)[:, ::2]).sum()
    weight = (CAMERA[0] / p[used] * ray[used]) ** -2
    sums = [
        np.bincount(cell[used], some, SIZE * SIZE)
        for some in (weight, -weight * places[used, 2], weight * grey[used])
    ]
    np.testing.assert_allclose(found, sums, rtol=1e-6, atol=1e-9)


def test_the_rover_itself_is_not_part_of_the_ground():
    ahead_m = np.array([0.9, 1.1]) * kernels.ROVER_M  # along the axis of the view, downwards
    camera, north = np.array([20.0, 100.0, 0.0, 0.0]), TO_LEVEL.copy()
    parallax = np.array([[20 / ahead_m[0], np.nan, 20 / ahead_m[1]]], np.float32)
    rasters = parallax, np.ones((1, 3), bool), np.ones((1, 3), np.float32)
    sums = kernels.sum_ground(rasters, camera, north, np.zeros(3), 1.0, GRID)
    assert sums[0].sum() == 1


def test_heights_are_compared_where_known_at_both_stops(rng):
    earlier, later = rng.normal(0.0, 0.1, (2, 40, 40)).astype(np.float32)
    earlier[10:14, 20:24] = later[5:9, 5:9] = np.nan
    rotation = Rotation.from_rotvec([0.02, -0.01, 0.3]).as_matrix()
    shift, cell_m, half = np.array([0.31, -0.42, 0.05]), 0.1, 19.5
    limits = (cell_m, 0.5, 1.5)
    found = kernels.height_differences(earlier, later, rotation, shift, limits)
    row, col = np.nonzero(np.isfinite(later))
    here = np.column_stack([(half - row) * cell_m, (col - half) * cell_m, -later[row, col]])
    there = here @ rotation.T + shift
    u, v = there[:, 1] / cell_m + half, half - there[:, 0] / cell_m
    near, far = np.hypot(*here[:, :2].T), np.hypot(*there[:, :2].T)
    used = (u > 0) & (v > 0) & (u < 39) & (v < 39)
    used &= (far < 1.5 * near + 1) & (near < 1.5 * far + 1)
    expected = np.full_like(later, np.nan)
    for k in np.flatnonzero(used):
        i, j = int(u[k]), int(v[k])
        four = earlier[j : j + 2, i : i + 2].astype(float)
        a, b = u[k] - i, v[k] - j
        weight = np.outer([1 - b, b], [1 - a, a]) * np.isfinite(four)
        if weight.sum() > 0.5:
            mean = np.nansum(weight * four) / weight.sum()
            expected[row[k], col[k]] = mean + there[k, 2]
    assert 500 < np.isfinite(expected).sum() < used.sum()
    np.testing.assert_allclose(found, expected, atol=1e-6)
