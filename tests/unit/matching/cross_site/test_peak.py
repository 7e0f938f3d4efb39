"""The pose by a clear peak of the bird's-eye search alone."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.frames import LSL, Pose, site_frame
from solmap.photogrammetry.matching.cross_site import peak
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    BirdsEyeParams,
    BirdsEyeView,
    PlaneFit,
)
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams, tie_cross_site
from solmap.photogrammetry.matching.cross_site.links import LinkTestParams
from solmap.photogrammetry.matching.cross_site.peak import (
    AZIMUTH,
    DOWN_M,
    OPPOSITE_SUNS_M,
    SHIFT_M,
    common_ground,
    peak_covariance,
)

UNREACHED = 10_000
WITHOUT_TIES = CrossSiteParams(
    birds_eye=BirdsEyeParams(radius_m=16.0),
    link_test=LinkTestParams(least_ties=UNREACHED, few_ties=UNREACHED),
)
PEAK_ALONE = replace(
    WITHOUT_TIES, surface_matching=replace(WITHOUT_TIES.surface_matching, enabled=False)
)


def linked(first_stop, second_stop, params):
    return tie_cross_site(StopViews.of(first_stop, params.birds_eye), second_stop, params)


def test_a_clear_peak_links_stops_that_neither_surfaces_nor_images_do(
    first_stop, second_stop, first_stand, second_stand
):
    link = linked(first_stop, second_stop, PEAK_ALONE)
    assert link.linked, link.reason
    assert "peak of" in link.reason
    assert "ties, 10000 are needed" in link.reason  # why the images do not
    assert link.figures.by_shape == len(link.ties) >= PEAK_ALONE.surface_matching.least
    assert link.ties.surface_matched.all()
    true = first_stand.true.inverse @ second_stand.true
    turn = link.earlier_from_later.rotation @ true.rotation.T
    error_m = np.linalg.norm(link.earlier_from_later.translation_m - true.translation_m)
    assert error_m < 3 * np.hypot(SHIFT_M, DOWN_M)
    assert abs(np.arctan2(turn[1, 0], turn[0, 0])) < 3 * AZIMUTH


@pytest.mark.parametrize(("sigma_m", "by_peak"), [(OPPOSITE_SUNS_M, False), (1e-5, True)])
def test_the_link_that_determines_the_position_better_is_used(
    first_stop, second_stop, monkeypatch, sigma_m, by_peak
):
    for name in ("SHIFT_M", "OPPOSITE_SUNS_M", "AZIMUTH"):
        monkeypatch.setattr(peak, name, sigma_m)
    link = linked(first_stop, second_stop, replace(PEAK_ALONE, link_test=LinkTestParams()))
    assert link.linked, link.reason
    assert ("peak of" in link.reason) is by_peak
    assert link.ties.surface_matched.any() == by_peak


def test_a_peak_that_could_be_random_does_not(first_stop, second_stop):
    higher = replace(PEAK_ALONE, link_test=replace(PEAK_ALONE.link_test, clear_z=1e3))
    link = linked(first_stop, second_stop, higher)
    assert not link.linked
    assert "ties, 10000 are needed" in link.reason


def test_one_of_several_significant_peaks_does_not(first_stop, second_stop):
    every_one = replace(PEAK_ALONE, link_test=replace(PEAK_ALONE.link_test, least_z=0.0))
    assert not linked(first_stop, second_stop, every_one).linked


def test_errors_are_independent_about_the_middle_of_the_ground():
    pose = Pose(LSL, site_frame(1), np.eye(3), np.array([28.0, 3.0, -1.0]))
    places = np.array([[14.0, 0.0, 0.0], [16.0, 2.0, 0.4]])
    covariance = peak_covariance(pose, places, 0.0)
    arm = places.mean(axis=0) - pose.translation_m
    by_motion = np.hstack([np.cross(np.eye(3), arm).T, np.eye(3)])  # of the middle: w x arm + t
    at_middle = by_motion @ covariance @ by_motion.T
    np.testing.assert_allclose(at_middle, np.diag([SHIFT_M, SHIFT_M, DOWN_M]) ** 2, atol=1e-9)
    # azimuth moves the rover, some 14 m away, across the way
    assert covariance[4, 4] > SHIFT_M**2 + (13 * AZIMUTH) ** 2


def test_opposite_suns_make_the_position_less_certain():
    pose, place = Pose(LSL, site_frame(1), np.eye(3), np.zeros(3)), np.zeros((1, 3))
    same, opposite = (np.sqrt(np.diag(peak_covariance(pose, place, suns))) for suns in (0.0, 1.0))
    np.testing.assert_allclose(opposite[3:5], np.hypot(SHIFT_M, OPPOSITE_SUNS_M))
    np.testing.assert_allclose(np.delete(opposite, [3, 4]), np.delete(same, [3, 4]))


def test_common_ground_has_a_point_of_each_block_that_both_views_show():
    nothing, size = np.nan, 40
    earlier, later = (np.full((size, size), nothing, np.float32) for _ in range(2))
    earlier[:20], later[10:] = -1.5, -1.5  # the northern half, and all but the northern quarter
    one, other = (BirdsEyeView(0.5, up, up) for up in (earlier, later))
    places = common_ground(one, other, PlaneFit(0.0, 2.0, 0.0, 0.0, 9.0, 50.0), 2.5)
    # the later view is 2 m further north: its ground begins at 7 m, the earlier one's ends at 0
    assert len(places) == 3 * 8
    assert (places[:, 0] > 0).all()
    assert (places[:, 0] < 7).all()
    np.testing.assert_allclose(places[:, 2], 1.5)
