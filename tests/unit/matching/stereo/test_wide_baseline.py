"""Two stops as one instrument: correction of its orientation, and far ground it resolves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.cameras.epipolar import EpipolarPair, epipolar_pair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.resampling import epipolar_images
from solmap.photogrammetry.matching.stereo.dense import (
    DenseParams,
    match_about,
    match_densely,
)
from solmap.photogrammetry.matching.stereo.orientation import (
    MeasuredOffsets,
    OrientationParams,
    VerticalParallax,
    relative_orientation,
)
from solmap.photogrammetry.matching.stereo.wide_baseline import (
    InstrumentLimits,
    WideBaselineImage,
    match_wide_baseline,
    search_area,
    select_wide_pairs,
)
from solmap.photogrammetry.synthetic.render import View, first_hits, photograph, rotate_rays
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.photogrammetry.synthetic.truth import _pair_rays

PAIR = Frame(FrameKind.PAIR, (0,))


def points_seen_by(turn: np.ndarray, shift: np.ndarray, rng) -> MeasuredOffsets:
    """Points of uneven ground, seen by a right camera that stands off its model by turn and shift.

    `shift` is in units of the base; the images are projected exactly, not to first order.
    """
    base_m, f = 10.0, 1200.0
    geometry = EpipolarPair(
        Pose(LSL, PAIR, np.eye(3), np.zeros(3)), base_m, f, (511.5, 511.5), 1024, 1024
    )
    z = rng.uniform(20, 200, 400)
    points = np.column_stack([rng.uniform(-0.3, 0.3, 400) * z, rng.uniform(-0.3, 0.3, 400) * z, z])
    left = f * points[:, :2] / z[:, None] + 511.5
    seen = points - base_m * (np.array([1.0, 0, 0]) + shift)
    seen = Rotation.from_rotvec(-turn).apply(seen)
    right = f * seen[:, :2] / seen[:, 2:] + 511.5
    offset = right - left
    rows = VerticalParallax(left, offset[:, 1], -offset[:, 0], geometry)
    return MeasuredOffsets(rows, f * base_m / z, rig_ratio=50.0)


def test_a_rotation_and_a_shift_of_the_right_camera_are_found(rng):
    turn, shift = np.array([1e-3, -2e-3, 1.5e-3]), np.array([0.0, 3e-3, -2e-3])
    loose = OrientationParams(rotation_sigma=0.1, position_sigma_m=1.0, rig_sigma_px=1e-3)
    found = relative_orientation(points_seen_by(turn, shift, rng), loose)
    np.testing.assert_allclose(found.rotation, turn, atol=3e-5)  # second order of 2 mrad, and noise
    np.testing.assert_allclose(found.shift, shift, atol=3e-4)


def test_undetermined_parameters_stay_as_adjusted(rng):
    """Without a trusted bar, a turn about the vertical and an error of the bar look alike."""
    turn = np.array([0.0, 2e-3, 0.0])
    measured = points_seen_by(turn, np.zeros(3), rng)
    rigid = OrientationParams(rotation_sigma=1e-6, rig_sigma_px=1.0)
    found = relative_orientation(measured, rigid)
    assert np.abs(found.rotation).max() < 1e-5
    again = relative_orientation(measured, OrientationParams(), found)
    assert again.rotation[1] == pytest.approx(2e-3, abs=1e-3)


def test_displaced_windows_are_found_in_both_directions(scene, ground):
    world = scene([ground])
    offsets = search_area(world.images, 45)
    x, y = offsets.left.astype(int).T
    error = offsets.parallax_px - world.parallax_px[y, x]
    assert len(error) > 100
    assert np.median(np.abs(error)) < 0.1
    assert np.median(np.abs(offsets.vertical_px)) < 0.1


def test_predicted_matching_agrees_with_unrestricted_matching(scene, ground):
    world = scene([ground])
    y, x = np.mgrid[0:256, 0:256].astype(np.float32)
    predicted = 4.0 + 0.13 * y + 3.0 * np.sin(x / 40) + 2.0
    dense = match_about(world.images, predicted.astype(np.float32), 8, DenseParams())
    error = np.abs(dense.parallax_px - world.parallax_px)
    known = np.isfinite(error)
    assert known[:, 60:].mean() > 0.9
    assert np.median(error[known]) < 0.1  # the sine bends windows by some hundredths
    assert (error[known] > 1).mean() < 0.01
    at_large = match_densely(world.images).parallax_px
    assert np.nanmedian(np.abs(dense.parallax_px - at_large)) < 0.1


@pytest.fixture(scope="module")
def hills():
    """Two stops 9.2 m apart below a hillside, under one sun, and the pairs that face it."""
    traverse = TraverseParams(stops=2, spacing_m=(9.0, 10.0), local_solar_hours=(11.0, 11.3))
    return make_world(WorldParams("hills", traverse=traverse), 8)


def eye_of(world, stop: int, pair: int, turn: np.ndarray, shift_m: np.ndarray) -> WideBaselineImage:
    """A matched pair, oriented as adjustment would leave it: turned and shifted a little."""
    shot = world.shot(stop, pair)
    lsl_from_rover = world.true_lsl_from_label_rover(shot)
    lsl_from_rover = Pose(
        LSL,
        lsl_from_rover.source,
        Rotation.from_rotvec(turn).as_matrix() @ lsl_from_rover.rotation,
        lsl_from_rover.translation_m + shift_m,
    )
    cameras = [world.exposure(shot, eye).camera for eye in (Eye.LEFT, Eye.RIGHT)]
    bitmaps = [photograph(world, shot, eye).astype(np.float32) for eye in (Eye.LEFT, Eye.RIGHT)]
    whole = np.ones(bitmaps[0].shape, dtype=bool)
    size = bitmaps[0].shape[::-1]
    bar = epipolar_pair(*cameras, size, size, world.stops[stop].id.frame, PAIR)
    images = epipolar_images(bar, *((p, whole, c) for p, c in zip(bitmaps, cameras, strict=True)))
    return WideBaselineImage(
        f"{stop}-{pair}",
        bitmaps[0],
        whole,
        cameras[0].transform(lsl_from_rover),
        bar,
        lsl_from_rover @ bar.rover_from_pair,
        match_densely(images).parallax_px,
    )


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_stops_resolve_far_ground_that_one_rig_does_not(hills):
    nothing = np.zeros(3)
    one = eye_of(hills, 0, 1, np.array([1e-3, -0.5e-3, 1e-3]), np.array([0.02, -0.02, 0.02]))
    other = eye_of(hills, 1, 2, nothing, nothing)
    left, right = select_wide_pairs([one], [other], InstrumentLimits())[0]
    assert (
        left is other
    )  # whose orientation is exact, so that truth can be looked up along its rays
    wide = match_wide_baseline(left, right)
    assert abs(wide.rows_before.median_px) > 0.5
    assert abs(wide.rows_after.median_px) < 0.05
    geometry = wide.images.geometry
    view = View.of_rays(
        wide.lsl_from_pair.translation_m,
        rotate_rays(wide.lsl_from_pair, _pair_rays(geometry)),
        1 / geometry.focal_px,
    )
    hits = wide.lsl_from_pair.inverse.apply(first_hits(hills.ground(1), view))
    true_m = hits[:, 2].reshape(geometry.lines, geometry.samples)
    error_px = wide.dense.parallax_px - geometry.focal_px * geometry.base_m / true_m
    for low, high, percent in ((100, 200, 4.0), (200, 300, 6.0)):
        here = (true_m > low) & (true_m < high) & np.isfinite(error_px)
        assert here.sum() > 5000
        range_m = geometry.focal_px * geometry.base_m / wide.dense.parallax_px[here]
        off = np.median(np.abs(range_m - true_m[here]) / true_m[here])
        assert off < percent / 100  # 0.05 degrees of w_y are 1.1 px of 75 and of 45
    known = np.isfinite(error_px)
    assert (np.abs(error_px[known]) < 3 * wide.dense.sigma_px[known]).mean() > 0.9


def test_pairs_along_the_baseline_or_facing_away_are_not_combined(scene, ground):
    images = scene([ground]).images
    cameras = images.geometry.cameras()
    whole = images.left_mask
    eyes = [
        WideBaselineImage(
            str(k),
            images.left,
            whole,
            camera.transform(Pose(LSL, LSL, np.eye(3), np.array(place))),
            images.geometry,
            Pose(LSL, PAIR, np.eye(3), np.zeros(3)),
            np.ones_like(images.left),
        )
        for k, (camera, place) in enumerate(
            [(cameras[0], [0.0, 0, 0]), (cameras[0], [0.0, 0, 10]), (cameras[0], [0.5, 0, 0])]
        )
    ]
    assert select_wide_pairs(eyes[:1], eyes[1:], InstrumentLimits()) == []
    with pytest.raises(MatchingError, match=r"0 and 1 are not a wide pair: a view 0 degrees from"):
        match_wide_baseline(eyes[0], eyes[1])
    with pytest.raises(MatchingError, match=r"a base of 0\.5 m"):
        match_wide_baseline(eyes[0], eyes[2])
    aside = replace(
        eyes[2], camera=cameras[0].transform(Pose(LSL, LSL, np.eye(3), np.array([8.0, 0, 0])))
    )
    assert len(select_wide_pairs(eyes[:1], [aside], InstrumentLimits())) == 1
