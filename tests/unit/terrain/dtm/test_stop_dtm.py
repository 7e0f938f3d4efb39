"""The terrain model of views of known surfaces."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.height_bias import HeightBias
from solmap.photogrammetry.matching.records import SharedSigma
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, MapGrid
from solmap.photogrammetry.terrain.dtm.records import GroundClass
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams, build_dtm

UNSEEN, MEASURED, INTERPOLATED, OCCLUDED = GroundClass
PARAMS = DtmParams(max_relative_sigma=0.05)  # the small test camera has little parallax


def on_map(dtm):
    return np.meshgrid(*dtm.grid.centres())


@pytest.fixture(scope="module")
def tilted_dtm(scenes):
    return build_dtm([scenes.view_of(scenes.tilted)], PARAMS)


@pytest.fixture(scope="module")
def boulder_dtm(scenes):
    return build_dtm([scenes.view_of(scenes.with_boulder)], PARAMS)


def test_a_plane_is_mapped_exactly(scenes, tilted_dtm):
    seen = tilted_dtm.ground != UNSEEN
    error = np.abs(tilted_dtm.elevation - scenes.tilted(*on_map(tilted_dtm)))
    # a cell's points may all lie at its corner: half a cell along the slope of 0.11
    assert error[seen].max() < 0.5 * tilted_dtm.grid.cell_m * 0.15 + 1e-4
    assert np.median(error[seen]) < 1e-3


def test_a_model_is_lowered_by_the_height_bias_of_its_views(scenes):
    view = scenes.view_of(scenes.level)
    drawn = build_dtm([view], PARAMS)
    dtm = build_dtm([replace(view, height_bias=HeightBias(0.5, 0.2))], PARAMS)
    seen = drawn.ground != UNSEEN
    away_m = np.hypot(*on_map(dtm))
    mast_m = -view.lsl_from_pair.translation_m[2]
    line_m = np.hypot(away_m, mast_m) / view.geometry.focal_px
    expected_m = line_m * (0.1 / (mast_m / away_m)) ** 0.5
    clear = cv2.erode(seen.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    lowered_m = drawn.elevation - dtm.elevation
    np.testing.assert_allclose(lowered_m[clear], 0.5 * expected_m[clear], rtol=0.05)
    more_m = np.sqrt(dtm.sigma_m**2 - drawn.sigma_m**2)
    np.testing.assert_allclose(more_m[clear], 0.2 * expected_m[clear], rtol=0.05)


def test_cells_between_lines_of_continuous_ground_are_interpolated(tilted_dtm):
    east, north = on_map(tilted_dtm)
    ahead = (np.abs(east) < 0.3) & (north > 5.0) & (north < 8.0)
    classes = tilted_dtm.ground[ahead]
    assert (classes != UNSEEN).all()
    assert (classes == INTERPOLATED).sum() > (classes == MEASURED).sum()
    assert (tilted_dtm.observations[ahead][classes == INTERPOLATED] == 0).all()
    assert (tilted_dtm.observations[ahead][classes == MEASURED] >= 1).all()


def test_only_seen_cells_have_values(boulder_dtm):
    seen = np.isin(boulder_dtm.ground, (MEASURED, INTERPOLATED))
    for layer in (boulder_dtm.elevation, boulder_dtm.sigma_m):
        np.testing.assert_array_equal(np.isfinite(layer), seen)
    assert (boulder_dtm.sigma_m[seen] > 0).all()
    assert (boulder_dtm.observations[~seen] == 0).all()


def test_ground_behind_a_boulder_is_occluded(boulder_dtm):
    east, north = on_map(boulder_dtm)
    hidden = (np.abs(east) < 0.4) & (north > 6.3) & (north < 8.5)
    assert (boulder_dtm.ground[hidden] == OCCLUDED).all()


def test_a_boulder_keeps_its_top(boulder_dtm):
    east, north = on_map(boulder_dtm)
    top = (np.abs(east) < 0.45) & (north > 5.05) & (north < 5.9)
    assert np.nanmin(boulder_dtm.elevation[top]) > 0.45
    front = (np.abs(east) < 0.4) & (north > 5.0) & (north < 5.04)
    assert np.nanmin(boulder_dtm.elevation[front]) > 0.3  # its whole face falls into these cells


def test_a_gap_wider_than_allowed_is_not_bridged(scenes):
    view = scenes.view_of(scenes.level)
    wide = build_dtm([view], PARAMS)
    narrow = build_dtm([view], DtmParams(max_relative_sigma=0.05, max_gap_m=0.1), wide.grid)
    assert np.sqrt(np.square(on_map(wide))[1][wide.ground != UNSEEN]).max() > 8.0
    # lines are Z^2 / (f h) apart on level ground: 0.1 m at 6.7 m
    assert on_map(narrow)[1][narrow.ground != UNSEEN].max() < 7.0


def test_a_single_blunder_makes_no_cell(scenes):
    view = scenes.view_of(scenes.level)
    clean = build_dtm([view], PARAMS)
    view.parallax[150, 100] *= 0.8
    view.parallax[200:202, 60:62] *= 1.3
    damaged = build_dtm([view], PARAMS)
    assert np.nanmax(np.abs(damaged.elevation)) < 1e-3
    assert (damaged.ground != UNSEEN).sum() > 0.99 * (clean.ground != UNSEEN).sum()


def test_the_standard_deviation_agrees_with_the_noise(scenes, rng):
    params = DtmParams(max_relative_sigma=0.05, correlation_px=1.0)  # this noise is independent
    view = scenes.view_of(scenes.level)
    view.parallax[:] += rng.normal(0, params.sigma_parallax_px, view.parallax.shape)
    dtm = build_dtm([view], params)
    far = (on_map(dtm)[1] > 4.0) & (dtm.ground == MEASURED)
    z = dtm.elevation[far] / dtm.sigma_m[far]
    assert 0.6 < np.mean(np.abs(z) < 1) < 0.85  # 0.68 for Gaussian errors
    assert np.mean(np.abs(z) < 3) > 0.98


def test_sigma_follows_the_stereo_formula(scenes):
    view = scenes.view_of(scenes.level)
    dtm = build_dtm([view], DtmParams(max_relative_sigma=0.05, sigma_image_px=0.0))
    row, col = dtm.grid.cells_of(np.array([[6.0, 0.0, 0.0]]))
    place = (slice(int(row[0]) - 3, int(row[0]) + 4), slice(int(col[0]) - 3, int(col[0]) + 4))
    measured = dtm.sigma_m[place][dtm.ground[place] == MEASURED]
    # level ground: sigma_p / p times the height of the camera, with p = f B / Z
    depth = 6.0 * np.cos(np.radians(20)) + 1.5 * np.sin(np.radians(20))
    assert np.median(measured) == pytest.approx(0.25 * depth / (300 * 0.2) * 1.5, rel=0.05)


def test_ground_seen_at_a_grazing_angle_is_less_certain_than_the_stereo_formula_states(scenes):
    def falling(east, north):
        return -0.15 * np.maximum(0, north - 3.0) + 0.0 * east

    dtm = build_dtm([scenes.view_of(falling)], PARAMS)
    east, north = on_map(dtm)
    place = (np.abs(east) < 0.3) & (np.abs(north - 4.5) < 0.1) & (dtm.ground == MEASURED)
    # the falling plane passes 1.05 m below the camera and here lies 1.725 m below it
    depth = 4.5 * np.cos(np.radians(20)) + 1.725 * np.sin(np.radians(20))
    formula = 0.25 * depth / (300 * 0.2) * 1.05
    unresolved = 9 * depth / 300 * (1 - 1.05 / 1.725)
    expected = np.hypot(formula, unresolved / np.sqrt(12))
    assert np.median(dtm.sigma_m[place]) == pytest.approx(expected, rel=0.1)
    assert expected > 1.2 * formula


def test_two_views_make_a_cell_more_certain_and_their_disagreement_less(scenes):
    views = [scenes.view_of(scenes.level, pair=k, azimuth_deg=a) for k, a in enumerate((-10, 10))]
    raised = scenes.view_of(lambda e, n: scenes.level(e, n) + 0.3, pair=2, azimuth_deg=10)
    one, two = build_dtm(views[:1], PARAMS), build_dtm(views, PARAMS)
    odd = build_dtm([views[0], raised], PARAMS, two.grid)
    shared = (np.abs(on_map(two)[0]) < 0.1) & (np.abs(on_map(two)[1] - 4) < 0.1)
    alone = (np.abs(on_map(one)[0]) < 0.1) & (np.abs(on_map(one)[1] - 4) < 0.1)
    assert np.median(two.sigma_m[shared]) < 0.8 * np.median(one.sigma_m[alone])
    assert np.median(odd.sigma_m[shared]) > 3 * np.median(two.sigma_m[shared])


def test_the_order_of_the_views_does_not_matter(scenes):
    views = [scenes.view_of(scenes.tilted, pair=k, azimuth_deg=a) for k, a in enumerate((0, 15))]
    there, back = build_dtm(views, PARAMS), build_dtm(views[::-1], PARAMS)
    np.testing.assert_allclose(there.elevation, back.elevation, atol=1e-6)
    np.testing.assert_array_equal(there.ground, back.ground)


def test_the_grid_consists_of_whole_blocks_around_the_seen_cells(tilted_dtm):
    grid = tilted_dtm.grid
    assert grid.rows % BLOCK == 0
    assert grid.cols % BLOCK == 0
    assert grid.west / (BLOCK * grid.cell_m) == pytest.approx(
        round(grid.west / (BLOCK * grid.cell_m))
    )
    seen = tilted_dtm.ground != UNSEEN
    east, north = (place[seen] for place in on_map(tilted_dtm))
    bounds = (float(east.min()), float(north.min()), float(east.max()), float(north.max()))
    assert grid == MapGrid.covering(bounds, grid.cell_m)


def test_a_given_grid_is_kept(scenes, tilted_dtm):
    grid = MapGrid.covering((-2.0, 3.0, 2.0, 6.0), 0.04)
    dtm = build_dtm([scenes.view_of(scenes.tilted)], PARAMS, grid)
    assert dtm.grid == grid
    row = round((grid.north - tilted_dtm.grid.north) / -0.04)
    col = round((grid.west - tilted_dtm.grid.west) / 0.04)
    common = tilted_dtm.elevation[max(row, 0) :, max(col, 0) :][:256, :256]
    own = dtm.elevation[max(-row, 0) :, max(-col, 0) :][: common.shape[0], : common.shape[1]]
    np.testing.assert_allclose(own, common, atol=1e-6)


def test_far_from_the_landing_site_no_precision_is_lost(scenes):
    camera = (4321.09, -1234.56, 201.5)
    view = scenes.view_of(
        lambda e, n: scenes.tilted(e - camera[0], n - camera[1]) + 200.0, camera=camera
    )
    dtm = build_dtm([view], PARAMS)
    east, north = on_map(dtm)
    error = dtm.elevation - (scenes.tilted(east - camera[0], north - camera[1]) + 200.0)
    assert np.nanmax(np.abs(error)) < 0.01


def test_the_absence_of_trusted_parallaxes_is_an_error_that_names_the_limit(scenes):
    view = scenes.view_of(scenes.level)
    view.parallax[:] = np.nan
    with pytest.raises(TerrainError, match=r"none of the 1 views has a parallax above 5\.0 px"):
        build_dtm([view], PARAMS)


def test_ground_outside_the_grid_is_an_error(scenes):
    elsewhere = MapGrid.covering((500.0, 500.0, 510.0, 510.0), 0.04)
    with pytest.raises(TerrainError, match="no measured ground lies in the grid"):
        build_dtm([scenes.view_of(scenes.level)], PARAMS, elsewhere)


def test_masked_pixels_are_not_used(scenes):
    view = scenes.view_of(scenes.level)
    view.mask[:, :128] = False
    dtm = build_dtm([view], PARAMS)
    assert on_map(dtm)[0][dtm.ground != UNSEEN].min() > -0.05


def test_a_precise_parallax_makes_a_precise_elevation(scenes):
    view = scenes.view_of(scenes.level)
    sigmas = []
    for sigma_px in (0.05, 0.25):
        stated = replace(view, sigma_px=np.full(view.parallax.shape, sigma_px, np.float32))
        sigmas.append(build_dtm([stated], DtmParams(cell_m=0.08)).sigma_m)
    whole = build_dtm([view], DtmParams(cell_m=0.08)).sigma_m
    np.testing.assert_array_equal(sigmas[1], whole)  # assumed where none is stated
    ratio = np.nanmedian(sigmas[0]) / np.nanmedian(sigmas[1])
    assert 0.1 < ratio < 0.9  # the image coordinate and what is not resolved remain


def test_common_errors_of_a_view_do_not_average_out(scenes):
    view = scenes.view_of(scenes.level)
    sigma_px = np.full(view.parallax.shape, 0.25, np.float32)
    params = DtmParams(cell_m=0.32, correlation_px=1.0, max_relative_sigma=0.05)
    own, both = (
        build_dtm([replace(view, sigma_px=sigma_px, shared=shared)], params)
        for shared in (None, SharedSigma(offset_px=0.25))
    )
    np.testing.assert_allclose(own.elevation, both.elevation, atol=1e-6)
    assert (both.sigma_m > 0.999 * own.sigma_m)[own.ground != UNSEEN].all()
    east, north = on_map(both)
    place = (np.abs(east) < 0.5) & (np.abs(north - 6.0) < 0.5)
    assert both.observations[place].min() > 10
    depth = north[place] * np.cos(np.radians(20)) + 1.5 * np.sin(np.radians(20))
    formula = 0.25 * depth / (300 * 0.2) * 1.5  # as of a single point
    np.testing.assert_allclose(both.sigma_m[place], formula, rtol=0.1)
    assert (own.sigma_m[place] < 0.5 * formula).all()


@pytest.mark.usefixtures("unchecked")
def test_pose_errors_within_their_covariance_are_within_the_stated_sigma(scenes, rng):
    view = scenes.view_of(scenes.tilted)
    sigmas = np.r_[np.radians([0.3, 0.4, 0.5]), 0.02, 0.03, 0.04]
    reported = replace(view, covariance=np.diag(sigmas**2))
    stated = build_dtm([reported], PARAMS)
    off = []
    for _ in range(40):  # draw poses from the covariance, and measure how far cells move
        turn, shift = np.split(rng.normal(0, sigmas), 2)
        pose = view.lsl_from_pair
        moved = Pose(
            pose.target,
            pose.source,
            Rotation.from_rotvec(turn).as_matrix() @ pose.rotation,
            pose.translation_m + shift,
        )
        there = build_dtm([replace(view, lsl_from_pair=moved)], PARAMS, stated.grid)
        off.append((there.elevation - scenes.tilted(*on_map(there))) / stated.pose_sigma_m)
    off = np.array(off)
    seen = (stated.ground == MEASURED) & (np.isfinite(off).sum(axis=0) > 30)
    spread = np.sqrt(np.nanmean(np.square(off[:, seen]), axis=0))
    assert np.median(spread) == pytest.approx(1.0, abs=0.15)
    assert (stated.sigma_m >= stated.pose_sigma_m)[seen].all()


def test_exact_poses_add_no_uncertainty(tilted_dtm):
    assert np.nanmax(tilted_dtm.pose_sigma_m) == 0


def test_pose_uncertainty_does_not_average_out_over_the_views_of_a_stop(scenes):
    covariance = np.diag([0, 0, 0, 0, 0, 0.2**2])
    views = [
        replace(scenes.view_of(scenes.level, pair=k, azimuth_deg=a), covariance=covariance)
        for k, a in enumerate((-10, 10))
    ]
    dtm = build_dtm(views, PARAMS)
    np.testing.assert_allclose(dtm.pose_sigma_m[dtm.ground != UNSEEN], 0.2, rtol=1e-4)
