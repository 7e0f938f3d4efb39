from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import LSL, Pose, rotation_of_roll_pitch_yaw
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.birds_eye import PlaneFit
from solmap.photogrammetry.matching.cross_site.gate import (
    GateParams,
    between_levels,
    gate_between,
    pose_of,
)
from solmap.photogrammetry.matching.cross_site.links import SiteLinkFigures, VerdictParams, verdict
from solmap.photogrammetry.matching.records import MatchedStop

GOOD = SiteLinkFigures(
    distance_m=20.0,
    peak_z=15.0,
    overlap_m2=500.0,
    measured=60,
    ties=50,
    by_chance=4,
    rms_px=1.0,
    sigma0=1.0,
    spread_m=4.0,
)


def judged(**changes):
    return verdict(replace(GOOD, **changes), VerdictParams())


def stop(drive, position, turn=(0.0, 0.0, 0.0), sigma_m=0.0):
    name = StopId("MER2", 1, drive)
    pose = Pose(LSL, name.frame, rotation_of_roll_pitch_yaw(*turn), np.array(position, float))
    return MatchedStop(name, (), pose, np.eye(6) * sigma_m**2)


def test_many_ties_far_above_chance_and_spread_out_are_a_link():
    linked, reason = judged()
    assert linked
    assert reason == "50 ties of 60 conjugates, rms 1.00 px, 4 by chance"


def test_fewer_ties_than_hold_the_drift_are_no_link():
    assert judged(ties=19) == (False, "19 ties, 20 are needed")


@pytest.mark.parametrize("by_chance", [26, 40])
def test_ties_that_chance_could_have_found_are_no_link(by_chance):
    linked, reason = judged(by_chance=by_chance)
    assert not linked
    assert f"a wrong place gets {by_chance} by chance" in reason


def test_of_few_ties_twice_chance_does_not_do():
    assert not judged(ties=24, measured=30, by_chance=11)[0]  # 11 + 4 sqrt(11) = 24.3
    assert judged(ties=24, measured=30, by_chance=8)[0]


def test_conjugates_that_do_not_agree_in_space_are_no_link():
    assert "only 25% of 200 conjugates agree" in judged(measured=200)[1]


def test_ties_along_a_line_are_no_link():
    assert judged(spread_m=0.4) == (False, "the ties lie on a line, 0.4 m wide")


def test_the_gate_opens_with_the_distance():
    near, _ = gate_between(stop(0, (0, 0, 0)), stop(1, (8, 0, 0)), GateParams())
    far, _ = gate_between(stop(0, (0, 0, 0)), stop(1, (0, 40, 0)), GateParams())
    assert (near.north_m, near.east_m) == (8.0, 0.0)
    assert near.reach_m == pytest.approx(3 * (0.08 * 8 + 0.3))
    assert far.reach_m == pytest.approx(3 * (0.08 * 40 + 0.3))


def test_a_covariance_that_grows_more_than_a_drive_explains_opens_the_gate():
    gate, prior = gate_between(
        stop(0, (0, 0, 0), sigma_m=1.0), stop(1, (8, 0, 0), sigma_m=3.0), GateParams()
    )
    assert gate.reach_m == pytest.approx(3 * np.sqrt(9.0 - 1.0))
    assert np.sqrt(prior[4, 4]) == pytest.approx(np.sqrt(8.0))


def test_the_prior_is_turned_into_the_axes_of_the_earlier_rover():
    _, prior = gate_between(
        stop(0, (0, 0, 0), turn=(0.0, np.pi / 2, 0.0)), stop(1, (8, 0, 0)), GateParams()
    )
    params = GateParams()
    # nose up: the rover's x axis points up, and turning about it is turning in azimuth
    assert np.sqrt(prior[0, 0]) == pytest.approx(params.azimuth_sigma)
    assert np.sqrt(prior[2, 2]) == pytest.approx(params.tilt_sigma)


def test_a_fit_is_a_pose_with_the_tilt_of_telemetry():
    earlier, later = stop(0, (0, 0, 0), (0.1, 0.05, 0.4)), stop(1, (9, 2, -1), (0.02, -0.1, 2.0))
    pose = pose_of(earlier, later, PlaneFit(0.03, 8.0, 3.0, 0.5, 9.0, 100.0))
    level = between_levels(earlier, later, pose)
    np.testing.assert_allclose(level.translation_m, [8.0, 3.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(
        level.rotation, rotation_of_roll_pitch_yaw(0.0, 0.0, 0.03), atol=1e-12
    )


def test_a_gate_without_width_is_refused():
    with pytest.raises(MatchingError, match="as wide as telemetry is uncertain"):
        GateParams(tilt_sigma=0.0)
