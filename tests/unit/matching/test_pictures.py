import numpy as np

from photogrammetry.matching.dense import match_densely
from photogrammetry.matching.pictures import (
    draw_candidates,
    draw_matches,
    draw_parallax,
    draw_parallax_curve,
    in_three_bands,
)
from photogrammetry.matching.sparse import SparseParams, match_interest_points, match_sparsely


def test_accepted_candidates_are_white_and_rejected_ones_black(scene, ground):
    images = scene([ground]).images
    candidates = match_interest_points(images, SparseParams())
    candidates.accepted[:5] = False
    picture = draw_candidates(images, candidates)
    assert picture.shape == (256, 512, 3)
    for point, accepted in zip(candidates.left[-20:], candidates.accepted[-20:], strict=True):
        assert (picture[point[1], point[0]] == (255 if accepted else 0)).all()


def test_matches_are_drawn_where_they_lie_in_both_images(scene, ground):
    images = scene([ground]).images
    matches = match_sparsely("pair", images)
    picture = draw_matches(images, matches)
    x, y = np.rint(matches.left[0]).astype(int)
    right = round(float(matches.left[0, 0] - matches.parallax_px[0]))
    assert (picture[y, x] == picture[y, 256 + right]).all()
    assert np.ptp(picture[y, x].astype(int)) > 0  # a colour


def test_unmatched_pixels_are_black_in_the_parallax_picture(scene, ground):
    parallax = match_densely(scene([ground]).images)
    picture = draw_parallax(parallax)
    assert (picture[~np.isfinite(parallax)] == 0).all()
    assert (picture[np.isfinite(parallax)].sum(axis=1) > 0).all()
    assert not draw_parallax(np.full((4, 5), np.nan, np.float32)).any()


def test_the_parallax_curve_is_drawn_through_the_candidates(scene, ground):
    candidates = match_interest_points(scene([ground]).images, SparseParams())
    picture = draw_parallax_curve(candidates, SparseParams().verification)
    orange = (picture == (0, 140, 255)).all(axis=2)
    assert orange.sum() > 500
    columns = np.nonzero(orange.any(axis=0))[0]
    heights = [np.nonzero(orange[:, c])[0].mean() for c in columns[[5, -5]]]
    assert heights[0] > heights[1] + 50  # parallax grows from the top row to the foot


def test_masked_pixels_are_black(scene, ground):
    images = scene([ground]).images
    mask = images.left_mask.copy()
    mask[10:20] = False
    assert not in_three_bands(images.left, mask)[10:20].any()
    assert not in_three_bands(images.left, np.zeros_like(mask)).any()
