"""Errors along the ground, seen in an image."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import StereoMatches
from solmap.photogrammetry.matching.conjugates import TieView
from solmap.photogrammetry.matching.cross_site import image_matching as ground_spread
from solmap.photogrammetry.matching.cross_site.birds_eye import BirdsEyeView
from solmap.photogrammetry.matching.cross_site.ground_views import GroundSurface, GroundView
from solmap.photogrammetry.matching.cross_site.image_matching import ground_sigmas
from solmap.photogrammetry.matching.records import EpipolarImages, MatchedPair

HEIGHT_M = 1.5
ROVER, PAIR = Frame(FrameKind.ROVER, (1, 0)), Frame(FrameKind.PAIR, (1, 0, 0, 0))


@pytest.fixture
def view():
    """A level camera above level ground."""
    level = Pose(ROVER, PAIR, np.eye(3), np.zeros(3))
    geometry = EpipolarPair(level, 0.2, 1200.0, (511.5, 300.0), 1024, 1024)
    row = np.arange(1024.0)[:, None] - geometry.centre_px[1]
    ground = np.where(row > 0, row * geometry.base_m / HEIGHT_M, np.nan)
    parallax = np.broadcast_to(ground, (1024, 1024)).astype(np.float32).copy()
    grey, mask = np.zeros((1024, 1024), np.float32), np.ones((1024, 1024), bool)
    images = EpipolarImages(geometry, grey, mask, grey, mask)
    return TieView(MatchedPair.of("a", "NAVCAM", images, StereoMatches.none("a"), parallax))


def seen(view, places):
    """(sample, line, parallax) of level places (right, ahead) in metres."""
    points = np.column_stack([places[:, 0], np.full(len(places), HEIGHT_M), places[:, 1]])
    left, parallax = view.geometry.project(points)
    return np.column_stack([left, parallax])


@pytest.mark.parametrize("range_m", [5.0, 15.0])
def test_matches_beside_their_predicted_place_have_the_stated_errors(
    view, rng, range_m, monkeypatch
):
    monkeypatch.setattr(ground_spread, "RELIEF_M", 1e-9)
    place, sigma_m = np.array([[1.0, range_m]]), 0.02
    at = seen(view, place)
    P = np.stack([(seen(view, place + d) - at)[0, :2] / 0.01 for d in 0.01 * np.eye(2)], axis=1)
    sample, line, parallax = ground_sigmas(
        view, at[:, :2], at[:, 2], np.full(1, 0.03), sigma_m * P[None]
    )
    found = seen(view, place + sigma_m * rng.normal(size=(4000, 2)))
    found[:, 2] += 0.03 * rng.normal(size=4000)
    np.testing.assert_allclose([sample[0], line[0], parallax[0]], found.std(axis=0), rtol=0.05)
    assert sample[0] > 3 * line[0]  # what equal weights of both would deny


def test_no_patch_is_located_better_than_its_relief_allows(view):
    points, parallax = np.array([[500.0, 420.0]]), np.array([16.0])
    nothing = np.zeros((1, 2, 2))
    sample, line, of_parallax = ground_sigmas(view, points, parallax, np.full(1, 0.1), nothing)
    range_m = 1200.0 * 0.2 / 16.0
    np.testing.assert_allclose([sample, line], 1200.0 * ground_spread.RELIEF_M / range_m)
    assert of_parallax[0] == pytest.approx(0.1)


@pytest.mark.parametrize("corner", [(500.3, 410.7), (-9.4, 3.2), (1010.1, 1002.6), (-90.0, 40.0)])
@pytest.mark.parametrize("level", [(0, 0), (1, 0), (2, 3)])
def test_a_patch_is_averaged_as_the_whole_image_would_be(view, rng, corner, level):
    grey = rng.normal(500.0, 60.0, (1024, 1024)).astype(np.float32)
    surface = GroundSurface.of(BirdsEyeView(0.1, *np.zeros((2, 20, 20), np.float32)))
    pair = view.pair
    view = TieView(replace(pair, left=grey))
    step = 2.0 ** np.array(level)
    points = corner + step * np.stack(np.meshgrid(*[np.arange(9.0)] * 2), axis=-1)
    drawn = GroundView.of(view, surface, np.eye(3))._sample(points, level)
    x, y = (points + np.where(np.array(level) > 0, 0.5, 0.0)).astype(np.float32).transpose(2, 0, 1)
    whole = cv2.blur(grey, (2 ** level[0], 2 ** level[1]))
    nothing = float("nan")
    expected = cv2.remap(
        whole, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=nothing
    )
    np.testing.assert_allclose(drawn, expected, rtol=1e-6)
