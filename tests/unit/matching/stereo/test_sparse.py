from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from solmap.photogrammetry.matching.least_squares import LeastSquaresMatcher, LeastSquaresParams
from solmap.photogrammetry.matching.stereo.interest_points import (
    SEPARATION_PX,
    FoerstnerParams,
    interest_points,
    subpixel_places,
)
from solmap.photogrammetry.matching.stereo.sparse import (
    SparseParams,
    largest_parallax_px,
    match_interest_points,
    match_sparsely,
)
from solmap.photogrammetry.matching.stereo.verification import (
    VerificationParams,
    agrees_with_terrain,
)


def corner_image(x, y, size=41):
    """A bright quadrant whose corner lies at (x, y), blurred as by a lens."""
    column = 0.5 + 0.5 * erf((np.arange(size) - x) / 1.2)
    row = 0.5 + 0.5 * erf((np.arange(size) - y) / 1.2)
    return (1000.0 * np.outer(row, column)).astype(np.float32)


def test_a_moved_corner_is_found_at_its_new_place():
    def strongest(image):
        points = interest_points(image, np.ones(image.shape, bool), FoerstnerParams())
        places = subpixel_places(image, points.pixels, FoerstnerParams())
        return places[np.argmax(points.weight)]

    found = strongest(corner_image(20.3, 19.6))
    # the gradient lines of a blurred quadrant meet a little inside of it
    np.testing.assert_allclose(found, [20.3, 19.6], atol=0.5)
    shift = strongest(corner_image(20.8, 19.6)) - found
    np.testing.assert_allclose(shift, [0.5, 0.0], atol=0.1)


def test_an_edge_is_not_an_interest_point():
    image = np.tile(np.linspace(0, 1, 60) > 0.5, (60, 1)).astype(np.float32) * 1000
    assert len(interest_points(image, np.ones(image.shape, bool), FoerstnerParams())) == 0


def test_interest_points_have_the_least_distance_and_the_requested_number(scene, ground):
    world = scene([ground])
    params = FoerstnerParams(count=300)
    points = interest_points(world.images.left, world.images.left_mask, params, 8)
    assert len(points) == 300
    between = np.abs(points.pixels[:, None] - points.pixels[None]).max(axis=2)
    assert between[~np.eye(300, dtype=bool)].min() > SEPARATION_PX
    assert points.pixels.min() >= 8
    assert points.pixels.max() <= 255 - 8


def test_no_interest_point_touches_a_masked_pixel(scene, ground):
    world = scene([ground])
    mask = world.images.left_mask.copy()
    mask[100:110, 100:110] = False
    points = interest_points(world.images.left, mask, FoerstnerParams(), 8).pixels
    near = (np.abs(points - 104.5) < 4.5 + 8.5).all(axis=1)
    assert len(points) > 200
    assert not near.any()


def test_verified_matches_are_true_to_a_tenth_of_a_pixel(scene, ground, rock):
    world = scene([ground, rock])
    matches = match_sparsely("pair", world.images)
    x, y = matches.left.astype(int).T
    error = matches.parallax_px - world.parallax_px[y, x]
    assert matches.pair_id == "pair"
    assert len(matches) > 100
    assert (np.abs(error) < 1.0).mean() >= 0.99
    assert np.median(np.abs(error)) < 0.03


def test_the_sigma_of_least_squares_matching_is_that_of_its_errors(scene, ground):
    world = scene([ground], noise=25.0)
    matches = match_sparsely("pair", world.images, SparseParams(per_cell=20))
    x, y = matches.left.astype(int).T
    normalised = (matches.parallax_px - world.parallax_px[y, x]) / matches.sigma_px
    assert len(matches) > 150
    assert 1.4826 * np.median(np.abs(normalised)) == pytest.approx(1.0, abs=0.3)


def test_least_squares_matching_finds_the_slope_of_the_ground(scene, ground):
    world = scene([ground], noise=2.0)
    pixels = np.array([[150, 90], [180, 150], [200, 200]], dtype=np.int32)
    truth = world.parallax_px[pixels[:, 1], pixels[:, 0]]
    matcher = LeastSquaresMatcher(world.images.left, world.images.right, LeastSquaresParams())
    refined = matcher.refine(pixels, truth + np.array([0.6, -0.5, 0.4]))
    assert refined.settled.all()
    np.testing.assert_allclose(refined.parallax_px, truth, atol=0.02)
    np.testing.assert_allclose(refined.slope, [[0.01, 0.13]] * 3, atol=0.01)


def test_a_point_that_leaves_its_maximum_is_not_accepted(scene, ground):
    world = scene([ground])
    pixels = np.array([[150, 90], [180, 150]], dtype=np.int32)
    truth = world.parallax_px[pixels[:, 1], pixels[:, 0]]
    matcher = LeastSquaresMatcher(world.images.left, world.images.right, LeastSquaresParams())
    refined = matcher.refine(pixels, truth + 9.0)
    good = refined.settled & (refined.correlation > 0.8)
    assert not good.any()


def test_blunders_are_removed_by_the_parallax_curve(rng):
    points = np.column_stack([rng.uniform(0, 1000, 800), rng.uniform(0, 1000, 800)])
    parallax = 5.0 + 0.1 * points[:, 1] + rng.normal(size=800) * 0.3
    wrong = rng.choice(800, 80, replace=False)
    parallax[wrong] = rng.uniform(0, 200, 80)
    accepted = agrees_with_terrain(points, parallax, VerificationParams())
    off = np.abs(parallax - 5.0 - 0.1 * points[:, 1]) > 8
    assert not accepted[off].any()
    assert accepted[~off].mean() > 0.98


def test_few_matches_are_kept_without_neighbours():
    points = np.array([[10.0, 10.0], [50.0, 60.0], [90.0, 110.0]])
    for number in range(4):
        accepted = agrees_with_terrain(
            points[:number], np.array([5.0, 6.0, 7.0])[:number], VerificationParams()
        )
        assert accepted.shape == (number,)
        assert accepted.all()


def test_matches_are_spread_over_the_grid(scene, ground):
    world = scene([ground])
    matches = match_sparsely("pair", world.images, SparseParams(cell_px=64, per_cell=2))
    cells, counts = np.unique(matches.left // 64, axis=0, return_counts=True)
    assert counts.max() <= 2
    assert len(cells) >= 12  # of 16; the left border has no partner


def test_unrelated_images_have_no_matches(scene, ground):
    first, second = scene([ground]), scene([replace(ground, seed=99)])
    matches = match_sparsely("pair", replace(first.images, right=second.images.right))
    assert len(matches) <= 3


def test_an_image_without_usable_pixels_has_no_matches(scene, ground):
    world = scene([ground])
    nothing = np.zeros_like(world.images.left_mask)
    assert len(match_sparsely("pair", replace(world.images, left_mask=nothing))) == 0


def test_no_match_is_searched_nearer_than_the_nearest_range(scene, ground):
    world = scene([ground])
    params = SparseParams(nearest_range_m=12.0)
    limit = largest_parallax_px(world.images.geometry, 12.0)
    assert limit == pytest.approx(20.0)
    candidates = match_interest_points(world.images, params)
    parallax = candidates.left[:, 0] - candidates.right[:, 0]
    assert len(candidates) > 20
    assert parallax.max() <= limit
