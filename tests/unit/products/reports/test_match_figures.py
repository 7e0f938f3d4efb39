import numpy as np

from solmap.photogrammetry.matching.stereo.dense import (
    match_densely,
)
from solmap.photogrammetry.matching.stereo.sparse import (
    SparseParams,
    match_interest_points,
    match_sparsely,
)
from solmap.products.reports.matching_figures import (
    draw_candidates,
    draw_pair,
    draw_parallax,
    draw_parallax_curve,
    draw_residuals,
    in_three_bands,
)


def test_accepted_candidates_are_white_and_rejected_ones_black(scene, ground):
    images = scene([ground]).images
    candidates = match_interest_points(images, SparseParams())
    candidates.accepted[:5] = False
    picture = draw_candidates(images, candidates)
    assert picture.shape == (256, 512, 3)
    for point, accepted in zip(candidates.left[-20:], candidates.accepted[-20:], strict=True):
        assert (picture[point[1], point[0]] == (255 if accepted else 0)).all()


def test_unmatched_pixels_are_black_in_the_parallax_picture(scene, ground):
    parallax = match_densely(scene([ground]).images).parallax_px
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


def test_matches_are_coloured_by_how_far_dense_matching_is_from_them(scene, ground):
    images = scene([ground]).images
    matches = match_sparsely("pair", images)
    dense = match_densely(images).parallax_px
    x, y = np.rint(matches.left).astype(int).T
    far, unmatched = dense.copy(), dense.copy()
    far[y, x] = matches.parallax_px + 2.0
    unmatched[:] = np.nan
    agreeing = np.abs(dense[y, x] - matches.parallax_px) < 0.3
    assert agreeing.mean() > 0.9
    for parallax, colour in ((dense, (80, 200, 80)), (far, (60, 20, 220)), (unmatched, (255,) * 3)):
        picture = draw_residuals(images, matches, parallax.astype(np.float32))
        drawn = (picture[y, x] == colour).all(axis=1)
        assert drawn.mean() > 0.85


def test_a_sheet_shows_all_that_was_matched(scene, ground):
    images = scene([ground]).images
    params = SparseParams()
    sheet = draw_pair(
        images,
        match_interest_points(images, params),
        match_sparsely("pair", images),
        match_densely(images),
        params.verification,
    )
    assert sheet.shape == (3 * 256, 2 * 256, 3)
    for row in range(3):
        for column in range(2):
            panel = sheet[256 * row : 256 * (row + 1), 256 * column : 256 * (column + 1)]
            assert len(np.unique(panel.reshape(-1, 3), axis=0)) >= 3
