"""Single images of a panorama whose pointing errors are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.conjugates import View
from solmap.photogrammetry.matching.single.search import MonoParams, SingleView
from solmap.photogrammetry.matching.single.two_views import (
    TwoViews,
    check_conjugates,
    relative_turn,
)
from solmap.photogrammetry.matching.single.tying import tie_single_images
from solmap.photogrammetry.matching.stereo.verification import VerificationParams


@pytest.fixture(scope="module")
def views(first_stop):
    """The left images of the panorama's pairs, without their right images."""
    return [
        SingleView(p.pair_id, p.geometry, View.of(p.left, p.left_mask)) for p in first_stop.pairs
    ]


@pytest.fixture(scope="module")
def tied(views, first_stop):
    return tie_single_images(first_stop.stop, views, MonoParams())


@pytest.fixture
def two_views(first_stop):
    return TwoViews(*(pair.geometry for pair in first_stop.pairs[:2]))


@pytest.fixture
def ground(two_views, rng):
    """(points in the first image, the same in the second) of points 2 to 20 m away."""
    points = rng.uniform([128, 20], [250, 250], (400, 2))
    inverse = 1 / rng.uniform(2, 20, 400)
    return points, two_views.project(points, inverse), inverse


def test_only_neighbouring_images_are_tied(tied):
    assert [(link.first_id, link.second_id) for link in tied.links] == [
        ("P000", "P001"),
        ("P001", "P002"),
        ("P002", "P003"),
    ]
    assert min(link.ties for link in tied.links) > 30
    assert np.isnan(tied.ties.first_parallax_px).all()


def test_ties_show_the_same_ground(tied, first_stop):
    """The parallax of the pair, which single images lack, gives their true positions."""
    offsets = []
    geometries = [pair.geometry for pair in first_stop.pairs]
    for k in range(len(tied.ties)):
        one, other = tied.ties.first[k], tied.ties.second[k]
        left = tied.ties.first_left[k]
        col, row = np.round(left).astype(int)
        parallax = first_stop.pairs[one].parallax[row, col]
        if not np.isfinite(parallax):
            continue
        two_views = TwoViews(geometries[one], geometries[other])
        depth = geometries[one].focal_px * geometries[one].base_m / parallax
        seen = two_views.project(left[None], np.array([1.0 / float(depth)]))[0]
        offsets.append(tied.ties.second_left[k] - seen)
    offsets = np.array(offsets)
    assert len(offsets) > 100
    # 1 mrad of pointing is 0.3 px an axis and image; five standard deviations of two images
    assert np.linalg.norm(offsets, axis=1).max() < 5 * 0.32 * np.sqrt(2)


def test_matches_of_a_pair_are_found_in_a_neighbouring_single_image(first_stop, views):
    pair = first_stop.pairs[0]
    found = tie_single_images(first_stop.stop, views[1:2], MonoParams(), [pair])
    (link,) = found.links
    assert (link.first_id, link.second_id) == ("P000", "P001")
    assert link.ties > 30
    ties = found.ties
    assert np.isfinite(ties.first_parallax_px).all()  # the pair's own
    assert np.isnan(ties.second_parallax_px).all()
    two_views = TwoViews(pair.geometry, views[1].geometry)
    depth = 320.0 * 0.4 / ties.first_parallax_px
    off = ties.second_left - two_views.project(ties.first_left, 1.0 / depth)
    assert np.linalg.norm(off, axis=1).max() < 5 * 0.32 * np.sqrt(2)  # 1 mrad of pointing each
    spread = np.median(np.abs(off - np.median(off, axis=0)))
    assert spread < 0.2  # one turn explains them


def test_images_from_one_place_are_not_tied(first_stop, views):
    """The same exposure through two filters: no base, no depth, no tie."""
    twin = replace(views[0], image_id="twin")
    assert tie_single_images(first_stop.stop, [views[0], twin], MonoParams()).links == ()


def test_a_rotation_of_the_second_camera_is_found_despite_blunders(two_views, ground, rng):
    points, seen, inverse = ground
    turn = np.array([0.002, -0.001, 0.003])
    seen = two_views.project(points, inverse, turn) + rng.normal(0, 0.1, seen.shape)
    wrong = rng.random(len(seen)) < 0.3
    seen[wrong] += rng.uniform(-10, 10, (wrong.sum(), 2))
    found = relative_turn(two_views, points, seen, pointing_sigma=0.0026)
    left = two_views.epipolar_distance(points[~wrong], seen[~wrong], found)
    assert np.median(np.abs(left)) < 0.1  # as measured
    nothing = two_views.epipolar_distance(points[~wrong], seen[~wrong], np.zeros(3))
    assert np.median(np.abs(nothing)) > 0.4


def test_points_off_the_line_or_off_the_ground_are_rejected(two_views, ground, rng):
    points = ground[0]
    inverse = 0.05 + points[:, 1] / 256 * 0.3  # a plane
    seen = two_views.project(points, inverse) + rng.normal(0, 0.1, points.shape)
    deep, aside = np.zeros((2, len(points)), dtype=bool)
    deep[::9], aside[4::9] = True, True
    on_the_line = two_views.project(points, inverse + 0.5)
    moved = np.linalg.norm(on_the_line - seen, axis=1)
    deep &= moved > 5.0  # nearer to the epipole than this, depth shows too little
    seen[deep] = on_the_line[deep]
    seen[aside] += 5.0 * normals(two_views, points[aside])
    checked = check_conjugates(two_views, points, seen, 0.5, 0.0026, VerificationParams())
    assert deep.sum() > 20
    assert not checked.agrees[deep | aside].any()
    assert checked.agrees[~(deep | aside)].mean() > 0.95


def normals(two_views, points):
    """Across the epipolar lines in the second image."""
    far = two_views.project(points, np.zeros(len(points)))
    near = two_views.project(points, np.full(len(points), 0.01))
    across = (near - far)[:, ::-1] * [-1.0, 1.0]
    return across / np.linalg.norm(across, axis=1, keepdims=True)


def test_across_and_along_are_measured_from_the_epipolar_line(two_views, ground):
    points, seen, _ = ground
    np.testing.assert_allclose(
        two_views.epipolar_distance(points, seen, np.zeros(3)), 0.0, atol=1e-9
    )
    far = two_views.project(points, np.zeros(len(points)))
    aside = two_views.epipolar_distance(points, far + 2.0 * normals(two_views, points), np.zeros(3))
    np.testing.assert_allclose(np.abs(aside), 2.0, atol=1e-6)
    assert (two_views.epipolar_parallax(points, seen, np.zeros(3)) > 0).all()


def test_images_of_different_ground_are_not_tied(first_stop, foreign_stop, views):
    """Two images that should overlap by their labels, and show different soil."""
    other = foreign_stop.pairs[0]
    label = views[1].geometry.rover_from_pair
    geometry = replace(
        views[1].geometry,
        rover_from_pair=Pose(label.target, label.source, label.rotation, label.translation_m),
    )
    unrelated = SingleView("X", geometry, View.of(other.left, other.left_mask))
    found = tie_single_images(first_stop.stop, [views[0], unrelated], MonoParams())
    assert len(found.ties) == 0
    assert [link.ties for link in found.links] == [0]


def test_images_with_a_large_roll_between_them_are_tied(first_stop, views):
    """Elevation changes turn the image about the view; patches are turned with it."""
    one = first_stop.pairs[1]
    roll = Rotation.from_euler("z", np.pi / 2).as_matrix()
    label = views[1].geometry.rover_from_pair
    turned = Pose(label.target, label.source, label.rotation @ roll, label.translation_m)
    grey, mask = np.rot90(one.left).copy(), np.rot90(one.left_mask).copy()
    # x of the turned image runs along y of the original
    view = SingleView("R", replace(views[1].geometry, rover_from_pair=turned), View.of(grey, mask))
    found = tie_single_images(first_stop.stop, [views[0], view], MonoParams())
    assert len(found.ties) > 30


@pytest.mark.parametrize("wrong", [{"least_ties": 2}, {"first_points": 5}, {"nearest_m": 0.0}])
def test_invalid_parameters_are_refused(wrong):
    with pytest.raises(MatchingError, match=r"must be above zero|single images need"):
        MonoParams(**wrong)
