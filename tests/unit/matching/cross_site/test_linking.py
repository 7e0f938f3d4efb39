from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.birds_eye import BirdsEyeParams
from solmap.photogrammetry.matching.cross_site.candidates import CandidateParams
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.linking import (
    CrossSiteParams,
    TrialParams,
    tie_cross_site,
)
from solmap.photogrammetry.matching.cross_site.links import LinkTestParams

PARAMS = CrossSiteParams(
    birds_eye=BirdsEyeParams(radius_m=16.0),
    trials=TrialParams(candidates=CandidateParams(cell_m=0.5), decoys=1),
    link_test=LinkTestParams(least_spread_m=0.5),  # two narrow panoramas share a strip of ground
)


@pytest.fixture(scope="module")
def first(first_stop):
    return StopViews.of(first_stop, PARAMS.birds_eye)


@pytest.fixture(scope="module")
def link(first, second_stop):
    return tie_cross_site(first, second_stop, PARAMS)


@pytest.fixture(scope="module")
def foreign(first, foreign_stop):
    return tie_cross_site(first, foreign_stop, PARAMS)


def claimed_elsewhere(stop, north, east):
    pose = stop.lsl_from_rover
    moved = Pose(
        pose.target, pose.source, pose.rotation, pose.translation_m + np.array([north, east, 0.0])
    )
    return replace(stop, lsl_from_rover=moved)


def test_two_stops_that_face_each_other_are_linked_under_another_sun(link):
    assert link.linked, link.reason
    assert link.state == "linked"
    assert link.figures.handed_on >= PARAMS.link_test.least_ties
    assert len(link.ties) == link.figures.handed_on + link.figures.by_shape
    assert link.figures.handed_on <= link.figures.ties  # those that hardly share their ground


def test_where_no_peak_is_clear_the_hypothesis_with_most_ties_is_linked(first, second_stop, link):
    unclear = replace(
        PARAMS,
        surface_matching=replace(PARAMS.surface_matching, enabled=False),
        link_test=replace(PARAMS.link_test, clear_z=1e3),
    )
    found = tie_cross_site(first, second_stop, unclear)
    assert found.linked, found.reason
    apart_m = found.earlier_from_later.translation_m - link.earlier_from_later.translation_m
    assert np.linalg.norm(apart_m) < 0.1


def test_the_link_finds_the_position_of_the_rover(link, first_stand, second_stand):
    true = first_stand.true.inverse @ second_stand.true
    reported = first_stand.reported.inverse @ second_stand.reported
    error_m = np.linalg.norm(link.earlier_from_later.translation_m - true.translation_m)
    assert np.linalg.norm(reported.translation_m - true.translation_m) > 0.7
    # labels point 1 mrad wrong: 1 cm at 9 m; ranges of 5 cm average out over the ties
    assert error_m < 0.08
    turn = Rotation.from_matrix(link.earlier_from_later.rotation @ true.rotation.T).magnitude()
    assert np.degrees(turn) < 0.6


def test_the_covariance_of_a_link_covers_its_error(link, first_stand, second_stand):
    true = first_stand.true.inverse @ second_stand.true
    turn = Rotation.from_matrix(true.rotation @ link.earlier_from_later.rotation.T).as_rotvec()
    shift = true.translation_m - link.earlier_from_later.translation_m
    error = np.concatenate([turn, shift])
    assert (
        error @ np.linalg.solve(link.covariance, error) < 22.5
    )  # 99.9 % of chi-square, 6 freedoms


def test_ties_of_a_link_run_from_the_earlier_stop_to_the_later(link):
    ids = np.array(link.ties.pair_ids)
    assert all(name.startswith("P00") for name in ids[link.ties.first])
    assert all(name.startswith("P01") for name in ids[link.ties.second])


def test_different_ground_at_the_predicted_place_is_not_linked(foreign):
    assert not foreign.linked
    assert foreign.state == "not linked"
    assert "no significant peak" in foreign.reason
    assert len(foreign.ties) == 0


def test_a_stop_is_linked_at_any_error_of_telemetry(first, second_stop, first_stand, second_stand):
    link = tie_cross_site(first, claimed_elsewhere(second_stop, -9.0, 6.0), PARAMS)
    assert link.linked
    true = first_stand.true.inverse @ second_stand.true
    assert np.linalg.norm(link.earlier_from_later.translation_m - true.translation_m) < 0.08


def test_stops_too_far_apart_to_share_ground_are_not_searched(first, second_stop):
    link = tie_cross_site(first, claimed_elsewhere(second_stop, 200.0, 0.0), PARAMS)
    assert not link.linked
    assert "no common ground in reach" in link.reason


def test_an_unlinked_stop_keeps_the_pose_of_telemetry(foreign, first, foreign_stop):
    reported = first.stop.lsl_from_rover.inverse @ foreign_stop.lsl_from_rover
    np.testing.assert_allclose(foreign.earlier_from_later.translation_m, reported.translation_m)


def test_fewer_ties_than_unknowns_are_not_a_link():
    with pytest.raises(MatchingError, match="a link needs more than"):
        LinkTestParams(least_ties=3)
