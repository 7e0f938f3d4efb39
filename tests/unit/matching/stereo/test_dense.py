from dataclasses import replace

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Frame, FrameKind, Pose, rover_frame
from solmap.photogrammetry.matching.parallax_planes import fit_robust_plane
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.stereo import dense
from solmap.photogrammetry.matching.stereo.dense import (
    DenseParams,
    RefinementParams,
    match_densely,
)
from solmap.photogrammetry.matching.stereo.orientation import vertical_parallax
from solmap.photogrammetry.matching.stereo.semi_global import (
    GRAZING,
    LEVEL,
    GroundView,
    view_of_ground,
)
from solmap.photogrammetry.matching.stereo.sparse import match_sparsely
from tests.support.plain_stereo import plainly_wrong_at, wrong_and_filled
from tests.support.textured_planes import Plane


def test_parallax_of_sloping_ground_is_found_to_a_tenth_of_a_pixel(scene, ground):
    world = scene([ground])
    parallax = match_densely(world.images).parallax_px
    error = (parallax - world.parallax_px)[np.isfinite(parallax)]
    assert np.isfinite(parallax)[world.seen_by_both].mean() > 0.98
    assert np.median(np.abs(error)) < 0.05  # noise of 10 in a contrast of 200
    assert (np.abs(error) > 0.3).mean() < 0.005


def test_parallaxes_are_not_biased_to_whole_pixels(scene, ground):
    world = scene([ground])
    error = match_densely(world.images).parallax_px - world.parallax_px
    phase = world.parallax_px % 1
    for quarter in range(4):
        here = (np.floor(phase * 4) == quarter) & (np.abs(error) < 0.5)
        assert abs(error[here].mean()) < 0.01


@pytest.mark.parametrize("noise", [10.0, 20.0, 40.0])
def test_the_stated_sigma_is_that_of_the_errors(scene, ground, noise):
    world = scene([ground], noise=noise)
    found = match_densely(world.images)
    known = np.isfinite(found.parallax_px)
    normalised = (found.parallax_px - world.parallax_px)[known] / found.sigma_px[known]
    assert 1.4826 * np.median(np.abs(normalised)) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("density", [1e-4, 5e-4])
def test_the_density_of_relief_is_found_under_noise(rng, density):
    frequency = 2 * np.pi * np.hypot(*np.meshgrid(*(np.fft.fftfreq(1024),) * 2))
    frequency[0, 0] = np.inf
    amplitude = np.sqrt(density) * frequency ** -(1 + dense.ROUGHNESS)
    relief = 30 + np.fft.ifft2(np.fft.fft2(rng.normal(size=(1024, 1024))) * amplitude).real
    noise = cv2.blur(rng.normal(size=relief.shape) * 0.5, (5, 5))  # 0.1 px, as windows leave it
    ground = GroundView(LEVEL, np.ones(1024, np.float32))
    clean, noisy = (
        dense.relief_density(parallax.astype(np.float32), ground)
        for parallax in (relief, relief + noise)
    )
    assert clean == pytest.approx(density, rel=0.3)  # waves longer than the image are missing
    assert noisy == pytest.approx(clean, rel=0.1)


def test_relief_without_distances_between_pixels_has_the_usual_density():
    ground = GroundView(LEVEL, np.ones(8, np.float32))
    found = dense.relief_density(np.full((8, 40), np.nan, np.float32), ground)
    assert found == pytest.approx(dense.DENSITY_OF_VARIANCE * dense.USUAL_RELIEF_PX**2)


def test_relief_is_moved_down_by_a_part_of_a_line_and_the_ground_is_not():
    line = np.arange(60, dtype=np.float32)[:, None] * np.ones(3, np.float32)

    def parallax(moved):
        return 0.13 * line + 0.2 * np.sin((line - moved) / 5)

    moved = dense.moved_down(parallax(0.0), np.full(60, 0.2, np.float32), np.float32(0.13))
    assert moved[1:-1] == pytest.approx(parallax(0.2)[1:-1], abs=5e-4)


@pytest.mark.parametrize("noise", [10.0, 40.0])
def test_the_membrane_averages_noise_beyond_windows(scene, ground, noise, monkeypatch):
    world = scene([ground], noise=noise)
    error = []
    for sweeps in (dense.SWEEPS, 0):
        monkeypatch.setattr(dense, "SWEEPS", sweeps)
        off = np.abs(match_densely(world.images).parallax_px - world.parallax_px)
        error.append(np.nanmedian(off))
    assert error[0] < (0.85 if noise < 20 else 0.75) * error[1]


def test_the_sky_has_no_terrain(scene, ground, sky):
    world = scene([ground, sky])
    parallax = match_densely(world.images).parallax_px
    assert np.isfinite(parallax[:57]).mean() < 0.002  # the horizon may be two rows thick
    assert np.isfinite(parallax[64:][world.seen_by_both[64:]]).mean() > 0.97


def test_half_occluded_ground_has_no_parallax(scene, ground, rock):
    world = scene([ground, rock])
    hidden = ~world.seen_by_both & (np.arange(256) > 60)  # not the left border
    assert hidden.sum() > 500
    assert np.isfinite(match_densely(world.images).parallax_px[hidden]).mean() < 0.03


def test_the_edge_of_a_rock_is_not_smeared(scene, ground, rock):
    world = scene([ground, rock])
    error = np.abs(match_densely(world.images).parallax_px - world.parallax_px)
    known = np.isfinite(error)
    between = (error > 2.0) & (error < 0.8 * (45.0 - 4.0 - 0.14 * 140))
    assert (between & known).sum() < 5  # neither on the rock nor on the ground
    assert (error[known] > 1).mean() < 0.01


@pytest.mark.parametrize("seed", [1, 2])
def test_among_boxes_fewer_are_wrong_than_with_opencv_at_equal_fill(scene, seed):
    rng = np.random.default_rng(seed)
    boxes = [
        Plane(within(rng), at=12.0 + 4 * k, contrast=contrast, seed=10 + k)
        for k, contrast in enumerate([20.0, 200.0, 60.0, 600.0] * 3)
    ]
    wall = Plane(lambda _, y: y >= 0, at=12.0, contrast=40.0, seed=9)
    world = scene([wall, *boxes], size=384)
    visible = world.seen_by_both & (np.arange(384) > 100)
    parallax = match_densely(world.images).parallax_px
    wrong, filled = wrong_and_filled(parallax, world.parallax_px, visible)
    assert filled > 0.92
    assert wrong < plainly_wrong_at(filled, world.images, world.parallax_px, visible, 2.5)


def within(rng):
    """Whether points lie in a box somewhere in an image of 384 pixels."""
    x, y, wide, high = (rng.uniform(*ends) for ends in ((90, 370), (20, 360), (8, 40), (8, 40)))
    return lambda u, v: (np.abs(u - x) < wide) & (np.abs(v - y) < high)


@pytest.mark.parametrize("noise", [10.0, 20.0])
def test_far_ground_above_a_crest_is_not_raised_by_it(scene, ground, noise):
    behind = replace(ground, inside=lambda _, y: y < 128)
    crest = replace(ground, inside=lambda _, y: y >= 128, at=ground.at + 0.8, seed=2)
    world = scene([behind, crest], noise=noise)
    error = match_densely(world.images).parallax_px - world.parallax_px
    assert np.nanmean(error[125:128]) < 0.13  # 0.17 with windows as high as wide
    assert abs(np.nanmean(error[119:125])) < 0.015
    assert np.nanmedian(np.abs(error)) < 0.019 * noise / 10 + 0.002


def test_rows_are_marked_far_where_the_ground_is_seen_at_a_grazing_angle():
    still = Pose(rover_frame(1, 0), Frame(FrameKind.PAIR, (1,)), np.eye(3), np.zeros(3))
    geometry = EpipolarPair(still, 0.2, 1200.0, (127.5, 511.5), 256, 1024)
    y, x = np.mgrid[0:1024, 0:256].astype(np.float32)
    level = 0.2 / 1.5 * (y - 100)  # ground 1.5 m below, horizon in row 100
    ground = view_of_ground(np.where(y > 130, level, np.nan).astype(np.float32), geometry)
    horizon = np.arctan(411.5 / 1200.0)  # above the axis of the camera
    at_angle = 511.5 + 1200.0 * np.tan(np.arcsin(GRAZING) - horizon)
    assert abs(ground.far_lines - at_angle) <= 2
    assert ground.gradient == pytest.approx((0, 0.2 / 1.5), abs=1e-5)
    wall = (20.0 + 0.001 * x).astype(np.float32)
    for no_ground in (wall, np.full_like(wall, np.nan)):
        assert view_of_ground(no_ground, geometry).far_lines == 0


def test_masked_pixels_and_their_partners_stay_empty(scene, ground):
    world = scene([ground])
    left_mask, right_mask = world.images.left_mask.copy(), world.images.right_mask.copy()
    left_mask[100:120, 150:200] = False
    right_mask[180:200, 100:150] = False
    images = replace(world.images, left_mask=left_mask, right_mask=right_mask)
    parallax = match_densely(images).parallax_px
    assert not np.isfinite(parallax[100:120, 150:200]).any()
    partner = np.arange(256) - world.parallax_px[190]
    assert not np.isfinite(parallax[190][(partner > 102) & (partner < 147)]).any()
    assert np.isfinite(parallax).mean() > 0.7


def test_brightness_and_contrast_may_differ_between_the_eyes(scene, ground):
    world = scene([ground])
    images = replace(world.images, right=(1.3 * world.images.right - 250.0).astype(np.float32))
    error = match_densely(images).parallax_px - world.parallax_px
    assert np.median(np.abs(error[np.isfinite(error)])) < 0.06


def test_unrelated_images_have_no_parallaxes(scene, ground):
    first, second = scene([ground]), scene([replace(ground, seed=99)])
    images = replace(first.images, right=second.images.right)
    assert np.isfinite(match_densely(images).parallax_px).mean() < 0.02


def test_images_without_any_usable_pixel_have_no_parallaxes(scene, ground):
    world = scene([ground])
    nothing = np.zeros_like(world.images.left_mask)
    images = replace(world.images, left_mask=nothing, right_mask=nothing.copy())
    assert not np.isfinite(match_densely(images).parallax_px).any()


@pytest.mark.parametrize("shape", [(1, 200), (3, 30), (12, 12)])
def test_images_smaller_than_a_window_have_no_parallaxes(scene, ground, shape):
    whole = scene([ground]).images
    lines, samples = shape
    images = EpipolarImages(
        replace(whole.geometry, lines=lines, samples=samples),
        *(
            np.ascontiguousarray(array[:lines, :samples])
            for array in (whole.left, whole.left_mask, whole.right, whole.right_mask)
        ),
    )
    assert not np.isfinite(match_densely(images).parallax_px).any()
    assert len(match_sparsely("pair", images)) == 0
    assert "0 points: too few" in str(vertical_parallax(images))


def test_an_image_without_texture_has_no_parallaxes(scene, ground):
    images = scene([replace(ground, contrast=0.0)], noise=0.0).images
    assert not np.isfinite(match_densely(images).parallax_px).any()


def test_a_stricter_limit_of_sigma_leaves_out_more(scene, ground):
    world = scene([ground], noise=60.0)
    strict = DenseParams(refinement=RefinementParams(largest_sigma_px=0.1))
    assert (
        np.isfinite(match_densely(world.images, strict).parallax_px).sum()
        < np.isfinite(match_densely(world.images).parallax_px).sum()
    )


def test_the_parallax_plane_is_that_of_the_ground_despite_objects(rng):
    points = rng.uniform(0, 1000, (2000, 2))
    parallax = 3.0 + 0.01 * points[:, 0] + 0.13 * points[:, 1] + rng.normal(size=2000) * 0.3
    parallax[:600] += rng.uniform(5, 60, 600)  # rocks, nearer than the ground
    plane = fit_robust_plane(points, parallax)
    assert plane.per_sample == pytest.approx(0.01, abs=2e-3)
    assert plane.per_line == pytest.approx(0.13, abs=2e-3)
    assert plane.parallax_px(np.array([500.0]), np.array([500.0]))[0] == pytest.approx(
        73.0, abs=0.5
    )
