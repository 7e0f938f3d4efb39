"""Panoramas of a bowl whose every ray is known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.orthophoto.mosaic import NO_SOURCE
from solmap.photogrammetry.terrain.orthophoto.panorama import PanoramaParams, prepare_panorama
from solmap.photogrammetry.terrain.orthophoto.panorama_grid import (
    NODE,
    AngleGrid,
    StandingPlane,
    direction,
    ground_ranges,
)
from solmap.photogrammetry.terrain.orthophoto.panorama_seams import registration
from tests.unit.terrain.orthophoto.panorama_world import (
    LANDMARKS,
    PLANE,
    camera,
    dtm,
    elevation,
    ground_of,
    image,
    painted,
)

LOOKS = range(0, 360, 36)


@pytest.fixture(scope="module")
def ring():
    return [image(azimuth) for azimuth in LOOKS]


@pytest.fixture(scope="module")
def made(ring):
    return prepare_panorama(ring, PLANE, PanoramaParams(block_px=256), dtm())


@pytest.fixture(scope="module")
def drawn(made):
    return whole(made)


def whole(made):
    grey = np.full(made.grid.shape, np.nan, np.float32)
    ranges = np.full(np.array(made.grid.shape) // NODE, np.nan)
    sources = np.full(ranges.shape, NO_SOURCE, np.uint16)
    for block in made.blocks():
        rows, cols = block.brightness.shape
        grey[block.row : block.row + rows, block.col : block.col + cols] = block.brightness
        at = np.s_[
            block.row // NODE : (block.row + rows) // NODE,
            block.col // NODE : (block.col + cols) // NODE,
        ]
        ranges[at], sources[at] = block.ranges.range_m, block.sources
    return grey, ranges, sources


def rays_of(grid):
    azimuth = grid.west_deg + (np.arange(grid.cols) + 0.5) * grid.cell_deg
    above = grid.top_deg - (np.arange(grid.rows) + 0.5) * grid.cell_deg
    return direction(azimuth[None, :], above[:, None])


def test_a_full_ring_of_images_is_a_closed_circle(made, drawn):
    assert made.grid.cols * made.grid.cell_deg == pytest.approx(360.0)
    grey, *_ = drawn
    both = np.isfinite(grey[:, 0]) & np.isfinite(grey[:, -1])
    assert both.sum() > 100
    step = np.median(np.abs(grey[both, 0] - grey[both, -1]))
    assert step < 1.2 * np.nanmedian(np.abs(np.diff(grey, axis=1)))  # neighbours as any others


def test_landmarks_are_at_their_azimuth_and_elevation(made, drawn):
    grey, *_ = drawn
    for east, north in LANDMARKS:
        there = np.array([[north, east, -elevation(east, north)]]) - made.centre
        (row,), (col,) = made.grid.pixels_of(there)
        r, c = round(row), round(col)
        window = np.nan_to_num(grey[r - 4 : r + 5, c - 4 : c + 5], nan=0.0) - 170
        weight = np.maximum(window, 0)
        down, right = np.mgrid[-4:5, -4:5]
        found = (weight * down).sum() / weight.sum(), (weight * right).sum() / weight.sum()
        assert weight.max() > 100
        assert math.hypot(found[0] + r - row, found[1] + c - col) < 0.35, (east, north)


def test_brightness_is_that_of_the_ground_in_that_direction(made, drawn):
    grey, *_ = drawn
    rays = rays_of(made.grid).reshape(-1, 3)
    north, east, _ = ground_of(np.tile(made.centre, (len(rays), 1)), rays).T
    expected = painted(east, north).reshape(grey.shape)
    near = (np.hypot(east, north) < 12).reshape(grey.shape) & (expected < 145) & np.isfinite(grey)
    assert near.sum() > 100_000
    assert np.percentile(np.abs(grey - expected)[near], 95) < 4.0  # of 80 from trough to crest


def test_ranges_are_those_of_the_bowl(made, drawn):
    _, ranges, _ = drawn
    rays = rays_of(made.grid)[::NODE, ::NODE]
    flat = rays.reshape(-1, 3)
    there = ground_of(np.tile(made.centre, (len(flat), 1)), flat)
    true = np.linalg.norm(there - made.centre, axis=1).reshape(rays.shape[:2])
    level = np.hypot(*(there - made.centre)[:, :2].T).reshape(true.shape)
    known = np.isfinite(ranges) & (level > 1.0) & (level < 25.0)
    assert np.median(np.abs(ranges - true)[known] / true[known]) < 0.001
    assert np.percentile(np.abs(ranges - true)[known] / true[known], 99) < 0.01


def test_correctly_posed_images_meet_to_a_fraction_of_a_pixel(made):
    found = registration(made)
    assert len(found.seams) >= len(LOOKS)
    assert found.median_px < 0.1


def test_without_a_terrain_model_near_images_do_not_meet(ring):
    """The mast swings its cameras by decimetres: directions alone leave pixels of parallax."""
    deep = StandingPlane(np.array([0.0, 0.0, -100.0]), np.array([0.0, 0.0, 1.0]))
    flat = prepare_panorama(ring, deep, PanoramaParams(), None)
    bowl = prepare_panorama(ring, PLANE, PanoramaParams(), dtm())
    assert registration(bowl).p90_px < 0.2
    assert registration(flat).median_px > 1.0


def test_a_wrong_label_shows_in_the_seams(ring):
    off = image(72, seen_as=camera(72.75, -25.0))
    made = prepare_panorama([ring[1], off, ring[3]], PLANE, PanoramaParams(), dtm())
    shifts = [
        seam.shift_px for seam in registration(made).seams if "at 72" in (seam.first, seam.second)
    ]
    assert len(shifts) == 2
    assert np.mean(shifts) == pytest.approx(0.75 / made.grid.cell_deg, rel=0.1)


def test_brightness_is_balanced(ring):
    dark = [one if k % 2 else image(36 * k, gain=0.8) for k, one in enumerate(ring)]
    made = prepare_panorama(dark, PLANE, PanoramaParams(), dtm())
    np.testing.assert_allclose(made.gains[1::2, 0] / made.gains[::2, 0], 0.8, rtol=0.03)


def test_a_partial_panorama_is_as_wide_as_its_images(ring):
    made = prepare_panorama([ring[-1], ring[0], ring[1]], PLANE, PanoramaParams(), None)
    east = made.grid.west_deg + made.grid.cols * made.grid.cell_deg
    assert made.grid.west_deg < -50 < 50 < east
    assert east - made.grid.west_deg < 150


def test_directions_and_pixels_convert_both_ways():
    grid = AngleGrid(-40.0, 10.0, 0.1, 400, 1200)
    azimuth, above = np.array([-39.95, 0.0, 79.0]), np.array([9.95, -5.0, -29.0])
    row, col = grid.pixels_of(direction(azimuth, above))
    np.testing.assert_allclose(grid.west_deg + (col + 0.5) * 0.1, azimuth, atol=1e-9)
    np.testing.assert_allclose(grid.top_deg - (row + 0.5) * 0.1, above, atol=1e-9)


def test_ground_straight_below_is_at_its_depth():
    found = ground_ranges(
        np.array([0.0, 0.0, 1.5]), np.array([0.0, 90.0]), np.array([5.0, -45.0, -89.0]), PLANE
    )
    assert found.range_m[0].min() > 1000
    np.testing.assert_allclose(found.range_m[1], 1.5 * math.sqrt(2), rtol=1e-3)
    np.testing.assert_allclose(found.range_m[2], 1.5, rtol=1e-3)


def test_a_panorama_without_images_is_refused_with_advice():
    with pytest.raises(TerrainError, match="choose the other"):
        prepare_panorama([], PLANE, PanoramaParams())
