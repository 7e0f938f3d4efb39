import numpy as np
import pytest

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import LSL, Pose, rotation_of_roll_pitch_yaw
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.birds_eye import PlaneFit
from solmap.photogrammetry.matching.cross_site.gate import (
    GateParams,
    LinkParams,
    level_pose,
    link_candidates,
    pose_from_fit,
    search_gate,
    search_stages,
)
from solmap.photogrammetry.matching.records import MatchedStop


def stop(drive, position, turn=(0.0, 0.0, 0.0), sigma_m=0.0):
    name = StopId("MER2", 1, drive)
    pose = Pose(LSL, name.frame, rotation_of_roll_pitch_yaw(*turn), np.array(position, float))
    return MatchedStop(name, (), pose, np.eye(6) * sigma_m**2)


def test_the_gate_grows_with_the_distance():
    near, _ = search_gate(stop(0, (0, 0, 0)), stop(1, (8, 0, 0)), GateParams())
    far, _ = search_gate(stop(0, (0, 0, 0)), stop(1, (0, 40, 0)), GateParams())
    assert (near.north_m, near.east_m) == (8.0, 0.0)
    assert near.reach_m == pytest.approx(3 * (0.08 * 8 + 0.3))
    assert far.reach_m == pytest.approx(3 * (0.08 * 40 + 0.3))


def test_a_covariance_that_grows_more_than_a_drive_explains_widens_the_gate():
    gate, prior = search_gate(
        stop(0, (0, 0, 0), sigma_m=1.0), stop(1, (8, 0, 0), sigma_m=3.0), GateParams()
    )
    assert gate.reach_m == pytest.approx(3 * np.sqrt(9.0 - 1.0))
    assert np.sqrt(prior[4, 4]) == pytest.approx(np.sqrt(8.0))


def test_the_gate_widens_to_a_drive_without_motion_and_then_to_all_common_ground():
    params = GateParams()
    stages = search_stages(stop(0, (0, 0, 0)), stop(1, (0, 38, 0)), params, 30.0)
    narrow, spinning, anywhere = (stage.gate for stage in stages)
    assert narrow.reach_m == pytest.approx(3 * (0.08 * 38 + 0.3))
    assert spinning.reach_m > 38.0
    assert spinning.azimuth_reach == pytest.approx(2 * narrow.azimuth_reach)
    assert (anywhere.north_m, anywhere.east_m, anywhere.reach_m) == (0.0, 0.0, 60.0)
    sigmas = [np.sqrt(stage.prior[4, 4]) for stage in stages]
    assert sigmas == pytest.approx([sigmas[0], 4 * sigmas[0], 16 * sigmas[0]])


def test_stops_without_common_ground_in_the_narrow_gate_are_searched_in_wider_ones():
    far = search_stages(stop(0, (0, 0, 0)), stop(1, (0, 90, 0)), GateParams(), 30.0)
    assert len(far) == 2
    assert np.hypot(far[0].gate.north_m, far[0].gate.east_m) < 60.0 + far[0].gate.reach_m


def test_the_prior_is_rotated_into_the_axes_of_the_earlier_rover():
    _, prior = search_gate(
        stop(0, (0, 0, 0), turn=(0.0, np.pi / 2, 0.0)), stop(1, (8, 0, 0)), GateParams()
    )
    params = GateParams()
    # nose up: the rover's x axis points up, and turning about it is turning in azimuth
    assert np.sqrt(prior[0, 0]) == pytest.approx(params.azimuth_sigma)
    assert np.sqrt(prior[2, 2]) == pytest.approx(params.tilt_sigma)


def test_a_fit_is_a_pose_with_the_tilt_of_telemetry():
    earlier, later = stop(0, (0, 0, 0), (0.1, 0.05, 0.4)), stop(1, (9, 2, -1), (0.02, -0.1, 2.0))
    pose = pose_from_fit(earlier, later, PlaneFit(0.03, 8.0, 3.0, 0.5, 9.0, 100.0))
    level = level_pose(earlier, later, pose)
    np.testing.assert_allclose(level.translation_m, [8.0, 3.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(
        level.rotation, rotation_of_roll_pitch_yaw(0.0, 0.0, 0.03), atol=1e-12
    )


def test_a_gate_without_width_is_refused():
    with pytest.raises(MatchingError, match="standard deviations of a gate must be above zero"):
        GateParams(tilt_sigma=0.0)


def at(drive: int, north: float) -> tuple[StopId, Pose]:
    stop = StopId("MER2", 1, drive)
    return stop, Pose(LSL, stop.frame, np.eye(3), np.array([north, 0.0, 0.0]))


def test_the_nearest_earlier_stops_within_reach_are_tried_first():
    earlier = dict([at(1, 0.0), at(2, 30.0), at(3, 40.0), at(4, 200.0)])
    _, here = at(5, 45.0)
    tried = link_candidates(
        here, earlier, LinkParams(max_distance_m=50.0, max_earlier=2), GateParams()
    )
    assert [stop.drive for stop in tried] == [3, 2]


def test_a_stop_far_from_all_others_is_tried_with_none():
    assert link_candidates(at(2, 900.0)[1], dict([at(1, 0.0)]), LinkParams(), GateParams()) == []


def test_a_stop_within_the_usual_error_of_telemetry_is_tried():
    tried = link_candidates(at(2, 60.0)[1], dict([at(1, 0.0)]), LinkParams(), GateParams())
    assert [stop.drive for stop in tried] == [1]


def test_the_gate_grows_to_the_observed_errors_and_never_shrinks():
    params = GateParams()
    assert params.opened(1.3, 0.4, 1.0) == params
    wide = params.opened(3.1, 1.6, 1.0)
    assert wide.slip_sigma == 4 * params.slip_sigma
    assert wide.position_sigma_m == 4 * params.position_sigma_m
    assert wide.azimuth_sigma == 2 * params.azimuth_sigma
    assert wide.tilt_sigma == params.tilt_sigma
