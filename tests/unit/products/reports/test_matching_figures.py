import numpy as np
import pytest

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.alignment import AlignmentParams
from solmap.photogrammetry.matching.inter_stereo import InterStereoParams, tie_inter_stereo
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.matching.stereo.dense import (
    match_densely,
)
from solmap.photogrammetry.matching.stereo.sparse import (
    SparseParams,
    match_interest_points,
    match_sparsely,
)
from solmap.products.reports.matching_figures import (
    GAP_PX,
    SHEET_PX,
    FigureImage,
    draw_candidates,
    draw_pair,
    draw_parallax,
    draw_parallax_curve,
    draw_residuals,
    draw_sheet,
    draw_ties,
    in_three_bands,
    misfits,
)


def test_accepted_candidates_are_white_and_rejected_ones_black(scene, ground):
    images = scene([ground]).images
    candidates = match_interest_points(images, SparseParams())
    candidates.accepted[:5] = False
    image = draw_candidates(images, candidates)
    assert image.shape == (256, 512, 3)
    for point, accepted in zip(candidates.left[-20:], candidates.accepted[-20:], strict=True):
        assert (image[point[1], point[0]] == (255 if accepted else 0)).all()


def test_unmatched_pixels_are_black_in_the_parallax_figure(scene, ground):
    parallax = match_densely(scene([ground]).images).parallax_px
    image = draw_parallax(parallax)
    assert (image[~np.isfinite(parallax)] == 0).all()
    assert (image[np.isfinite(parallax)].sum(axis=1) > 0).all()
    assert not draw_parallax(np.full((4, 5), np.nan, np.float32)).any()


def test_the_parallax_curve_is_drawn_through_the_candidates(scene, ground):
    candidates = match_interest_points(scene([ground]).images, SparseParams())
    image = draw_parallax_curve(candidates, SparseParams().verification)
    orange = (image == (0, 140, 255)).all(axis=2)
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


def test_matches_are_coloured_by_their_difference_from_dense_matching(scene, ground):
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
        image = draw_residuals(images, matches, parallax.astype(np.float32))
        drawn = (image[y, x] == colour).all(axis=1)
        assert drawn.mean() > 0.85


def test_a_sheet_shows_all_matches(scene, ground):
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


FITS = np.zeros(1)


def tie(ids, first_left, second_left):
    one = np.ones(1)
    return Ties(
        ids,
        np.array([0], np.int32),
        np.array([1], np.int32),
        np.array([first_left], float),
        np.array([second_left], float),
        *[one.copy() for _ in range(8)],
    )


def none(ties):
    return ties.select(np.zeros(len(ties), bool))


def test_a_tie_is_a_coloured_line_from_image_to_image(first_stop):
    one, other = map(FigureImage.of, first_stop.pairs[:2])
    ties = tie((one.name, other.name), (50, 100), (60, 100))
    plain = draw_ties(one, other, none(ties), FITS[:0])
    drawn = draw_ties(one, other, ties, FITS)
    assert plain.shape == (256, 2 * 256 + GAP_PX, 3)
    changed = (plain != drawn).any(axis=2)
    assert changed[100, 60:300].all()
    assert not changed[:90].any()
    assert not changed[:, :40].any()


def test_ties_that_fit_are_green_and_those_at_the_limit_red(first_stop):
    one, other = map(FigureImage.of, first_stop.pairs[:2])
    ties = tie((one.name, other.name), (50, 100), (60, 100))
    for share, band in ((0.0, 1), (1.0, 2), (3.0, 2)):  # blue, green, red
        line = draw_ties(one, other, ties, np.array([share]))[100, 258].astype(int)
        assert line[band] > 2 * max(line[k] for k in range(3) if k != band)


def test_a_line_has_the_right_direction_when_the_pairs_are_exchanged(first_stop):
    one, other = map(FigureImage.of, first_stop.pairs[:2])
    ties = tie((one.name, other.name), (50, 100), (60, 140))
    drawn = draw_ties(other, one, ties, FITS)
    plain = draw_ties(other, one, none(ties), FITS[:0])
    assert (plain != drawn).any(axis=2)[140, 55:66].any()  # the ring around the start


def test_a_pair_that_is_not_among_the_ties_is_named(first_stop):
    one, other = map(FigureImage.of, first_stop.pairs[:2])
    with pytest.raises(MatchingError, match="P001 is not among the images"):
        draw_ties(one, other, tie(("P000", "X"), (5, 5), (6, 6)), FITS)


def test_a_sheet_shows_every_couple_of_a_stop(first_stop):
    ties = tie_inter_stereo(first_stop, InterStereoParams()).ties
    geometries = {pair.pair_id: pair.geometry for pair in first_stop.pairs}
    rover = first_stop.stop.frame
    share = misfits(ties, geometries, Pose.identity(rover, rover), None, AlignmentParams())
    assert share.max() <= 1.0  # all that were kept agree
    assert np.median(share) < 0.7
    sheet = draw_sheet(map(FigureImage.of, first_stop.pairs), ties, share)
    assert sheet.shape[1] == SHEET_PX
    assert sheet[: sheet.shape[0] // 2, SHEET_PX // 2 :].any()  # two to a row
    assert sheet[sheet.shape[0] // 2 :, : SHEET_PX // 2].any()
    assert not sheet[sheet.shape[0] // 2 + 30 :, SHEET_PX // 2 :].any()  # three couples


def test_a_sheet_without_ties_is_black(first_stop):
    nothing = Ties.none(tuple(pair.pair_id for pair in first_stop.pairs))
    assert not draw_sheet(map(FigureImage.of, first_stop.pairs), nothing, np.zeros(0)).any()


def test_the_earlier_stop_stays_left_on_request(first_stop):
    one, other = map(FigureImage.of, first_stop.pairs[:2])
    ties = tie((one.name, other.name), (50, 100), (200, 100))  # side by side, `other` goes left
    fixed, free = (draw_sheet((one, other), ties, FITS, first_left=f) for f in (True, False))
    swapped = tie((other.name, one.name), (200, 100), (50, 100))
    np.testing.assert_array_equal(free, draw_sheet((one, other), swapped, FITS, first_left=True))
    assert (fixed != free).any()
