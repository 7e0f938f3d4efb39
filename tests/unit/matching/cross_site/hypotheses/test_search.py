from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.frames import Pose, rotation_of_roll_pitch_yaw
from solmap.photogrammetry.matching.cross_site.birds_eye import BirdsEyeParams, draw_birds_eye
from solmap.photogrammetry.matching.cross_site.gate import GateParams, search_stages
from solmap.photogrammetry.matching.cross_site.hypotheses.search import find_hypotheses

BIRDS_EYE = BirdsEyeParams(radius_m=16.0)
LEAST_Z = 6.5


def found_between(one, other):
    first, second = (draw_birds_eye(s, BIRDS_EYE, [BIRDS_EYE.cell_m])[0] for s in (one, other))
    stages = search_stages(one, other, GateParams(), BIRDS_EYE.radius_m)
    return find_hypotheses(first, second, stages, BIRDS_EYE, LEAST_Z)


def reported(stop, north_m=0.0, east_m=0.0, turned=0.0):
    """A stop with this error of telemetry."""
    pose = stop.lsl_from_rover
    turn = rotation_of_roll_pitch_yaw(0.0, 0.0, turned)
    place = pose.translation_m + np.array([north_m, east_m, 0.0])
    return replace(stop, lsl_from_rover=Pose(pose.target, pose.source, turn @ pose.rotation, place))


def assert_right(found, one, other, first_stand, second_stand):
    level, best = one.lsl_from_rover.rotation, found.fits[0]
    true = first_stand.true.inverse @ second_stand.true
    place, turn = (
        level @ true.translation_m,
        level @ true.rotation @ other.lsl_from_rover.rotation.T,
    )
    assert np.hypot(best.north_m - place[0], best.east_m - place[1]) < 0.2
    assert best.down_m == pytest.approx(place[2], abs=0.15)
    assert best.azimuth == pytest.approx(np.arctan2(turn[1, 0], turn[0, 0]), abs=0.0175)
    assert found.highest > 2 * found.fits[1].z


def test_a_stop_facing_back_is_found_in_the_narrow_gate(
    first_stop, second_stop, first_stand, second_stand
):
    found = found_between(first_stop, second_stop)
    assert_right(found, first_stop, second_stop, first_stand, second_stand)
    assert found.gate == search_stages(first_stop, second_stop, GateParams(), 16.0)[0].gate


@pytest.mark.parametrize(("north_m", "east_m"), [(9.0, 3.0), (-3.0, 17.0)])
def test_the_gate_widens_after_wheel_slip_and_heading_errors(
    first_stop, second_stop, first_stand, second_stand, north_m, east_m
):
    off = reported(second_stop, north_m, east_m, np.deg2rad(6.0))
    found = found_between(first_stop, off)
    assert_right(found, first_stop, off, first_stand, second_stand)
    narrow = search_stages(first_stop, off, GateParams(), 16.0)[0]
    assert np.trace(found.prior) > 4 * np.trace(narrow.prior)


def test_different_ground_has_no_distinct_peak_in_any_gate(first_stop, foreign_stop):
    found = found_between(first_stop, foreign_stop)
    assert len(found.fits) <= BIRDS_EYE.peaks
    assert found.highest < LEAST_Z
    last = search_stages(first_stop, foreign_stop, GateParams(), BIRDS_EYE.radius_m)[-1]
    assert found.gate == last.gate
