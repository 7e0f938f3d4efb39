import numpy as np
import pytest

from solmap.photogrammetry.frames import LSL, Pose, rotation_of_roll_pitch_yaw
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.birds_eye import BirdsEyeParams, draw_birds_eye
from solmap.photogrammetry.matching.cross_site.candidates import CandidateParams
from solmap.photogrammetry.matching.cross_site.linking import (
    CrossSiteParams,
    TrialParams,
    tie_cross_site,
)
from solmap.photogrammetry.matching.cross_site.links import LinkTestParams
from solmap.photogrammetry.matching.cross_site.parts import Part, merge_ground, parts_to_link
from tests.support.rolling_stops import elevation, photographed, stand

PARAMS = CrossSiteParams(
    birds_eye=BirdsEyeParams(radius_m=16.0),
    trials=TrialParams(candidates=CandidateParams(cell_m=0.5), decoys=1),
    link_test=LinkTestParams(least_spread_m=0.5),  # narrow panoramas share a strip of ground
)
A, B, C, D = (StopId("MER2", 1, drive) for drive in (0, 2, 4, 6))
PLACES = {
    stop: Pose(LSL, stop.frame, rotation_of_roll_pitch_yaw(0.0, 0.0, turn), np.array([*at, 0.0]))
    for stop, at, turn in (
        (A, (0, 0), 0.1),
        (B, (9, 1), 0.7),
        (C, (20, -3), 1.5),
        (D, (48, 5), 3.0),
    )
}


def linked(*ends):
    return {(one, other): PLACES[one].inverse @ PLACES[other] for one, other in ends}


def sets(parts):
    return [(one.stop, set(one.stops), other.stop, set(other.stops)) for one, other in parts]


def test_a_part_places_its_stops_by_their_links():
    part = Part.of(B, linked((A, B), (A, C)))
    assert part.stops == [B, A, C]
    for stop, pose in part.beside.items():
        true = PLACES[B].inverse @ PLACES[stop]
        np.testing.assert_allclose(pose.translation_m, true.translation_m, atol=1e-9)
        np.testing.assert_allclose(pose.rotation, true.rotation, atol=1e-9)


def test_an_unlinked_stop_is_tried_with_the_merged_ground_of_linked_stops():
    found = parts_to_link([A, B, C, D], PLACES, linked((A, B), (B, C)), 50.0)
    assert sets(found) == [(C, {A, B, C}, D, {D})]  # C is the nearest to D


def test_the_part_of_a_new_stop_is_tried_with_each_other_part():
    found = parts_to_link([A, B, C, D], PLACES, linked((C, D)), 50.0)
    assert sets(found) == [(A, {A}, C, {C, D}), (B, {B}, C, {C, D})]


@pytest.mark.parametrize("ends", [[(A, B), (B, D)], [(A, D), (B, D)]])
def test_linked_stops_need_no_merged_ground(ends):
    assert list(parts_to_link([A, B, D], PLACES, linked(*ends), 50.0)) == []


def test_two_single_stops_are_not_tried_again():
    assert list(parts_to_link([A, D], PLACES, {}, 50.0)) == []


def test_stops_out_of_reach_of_the_other_part_are_left_out():
    among = linked((A, B), (B, C))
    assert sets(parts_to_link([A, B, C, D], PLACES, among, 45.0)) == [(C, {B, C}, D, {D})]
    assert list(parts_to_link([A, B, C, D], PLACES, among, 35.0)) == []


def test_links_to_other_stops_do_not_connect_a_part():
    found = parts_to_link([A, B, D], PLACES, linked((A, B), (A, C), (C, D)), 50.0)
    assert sets(found) == [(B, {A, B}, D, {D})]


def test_merged_ground_has_its_true_coordinates():
    one, other = stand(0, 0.0, 0.0, 0.3), stand(2, 3.0, -4.0, 2.0)
    looks = np.radians([20.0, 140.0])
    first, second = (photographed(there, looks) for there in (one, other))
    merged = merge_ground(first, [(second, one.true.inverse @ other.true)])
    assert [pair.pair_id for pair in merged.pairs] == ["P000", "P001", "P020", "P021"]
    alone, both = (
        draw_birds_eye(stop, BirdsEyeParams(radius_m=12.0, cell_m=0.16), [0.16])[0].elevation
        for stop in (first, merged)
    )
    row, col = np.nonzero(np.isfinite(both) & ~np.isfinite(alone))
    half = (both.shape[0] - 1) / 2
    north, east = (half - row) * 0.16, (col - half) * 0.16
    near = np.hypot(north - 3.0, east + 4.0) < 5.0
    assert near.sum() > 200
    error = both[row, col][near] - elevation(north[near], east[near])
    assert np.median(np.abs(error)) < 0.02  # cells of 0.16 m on slopes of 10 %


def test_a_stop_alone_is_its_own_part():
    stop = photographed(stand(0, 0.0, 0.0, 0.3), [0.0])
    assert merge_ground(stop, []).pairs == stop.pairs


def test_a_stop_with_little_ground_is_linked_through_its_neighbour(second_stop):
    one, beside = stand(0, 0.0, 0.0, 0.3), stand(2, -1.0, 1.5, 1.0)
    alone = photographed(one, np.radians([-22.0]), pointing=0.001)
    others = photographed(beside, np.radians([-45.0, -15.0, 15.0]), pointing=0.001)
    merged = merge_ground(alone, [(others, one.true.inverse @ beside.true)])
    seen_alone, seen = (tie_cross_site(stop, second_stop, PARAMS) for stop in (alone, merged))
    assert not seen_alone.linked
    assert seen.linked, seen.reason
    first = np.array(seen.ties.pair_ids)[seen.ties.first]
    assert {name[:3] for name in first} == {"P00", "P02"}
