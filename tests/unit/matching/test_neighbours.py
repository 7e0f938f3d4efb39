import numpy as np

from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.gate import LinkParams, link_candidates


def at(drive: int, north: float) -> tuple[StopId, Pose]:
    stop = StopId("MER2", 1, drive)
    return stop, Pose(LSL, stop.frame, np.eye(3), np.array([north, 0.0, 0.0]))


def test_the_nearest_earlier_stops_within_reach_are_tried_first():
    earlier = dict([at(1, 0.0), at(2, 30.0), at(3, 40.0), at(4, 200.0)])
    _, here = at(5, 45.0)
    tried = link_candidates(here, earlier, LinkParams(max_distance_m=50.0, max_earlier=2))
    assert [stop.drive for stop in tried] == [3, 2]


def test_a_stop_far_from_all_others_is_tried_with_none():
    assert link_candidates(at(2, 900.0)[1], dict([at(1, 0.0)]), LinkParams()) == []
