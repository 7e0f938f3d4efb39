"""Stops that cannot be true are found; none that a rover can have been at is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.archive.tables.places import parse_locations
from solmap.photogrammetry.frames import LSL, Pose, rotation_of_roll_pitch_yaw, site_frame
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.mars import MARS_RADIUS_M
from solmap.photogrammetry.traverse.plausibility import (
    TelemetryStop,
    implausible_poses,
    implausible_stops,
)
from solmap.photogrammetry.traverse.records import Traverse
from solmap.photogrammetry.traverse.sources import parse_mission_table, traverse_of_vectors

LEVEL = np.eye(3)


def stop_at(number: int, place: Sequence[float], sol: int, turn: np.ndarray = LEVEL):
    stop = StopId("MER2", 10, 2 * number)
    return TelemetryStop(stop, Pose(LSL, stop.frame, turn, np.array(place, dtype=float)), (sol,))


def drive(count: int = 6) -> list[TelemetryStop]:
    """Forty metres a sol."""
    return [stop_at(k, (40.0 * k, 3.0 * k, 0.2 * k), 155 + k) for k in range(count)]


def moved(stops: list[TelemetryStop], number: int, by_m: Sequence[float]) -> list[TelemetryStop]:
    pose = stops[number].lsl_from_rover
    there = Pose(LSL, pose.source, pose.rotation, pose.translation_m + np.array(by_m))
    return [
        replace(one, lsl_from_rover=there) if k == number else one for k, one in enumerate(stops)
    ]


@pytest.mark.parametrize("number", range(6))
@pytest.mark.parametrize(
    "by_m", [(1e12, 0, 0), (0, -5000.0, 0), (3500.0, 3600.0, 0), (0, 0, 6000.0), (1e300, 0, 0)]
)
def test_a_stop_far_from_its_neighbours_is_set_aside_alone(number, by_m):
    found = implausible_stops(moved(drive(), number, by_m))
    assert list(found) == [StopId("MER2", 10, 2 * number)]
    (reason,) = found.values()
    assert " m from " in reason
    assert "\n" not in reason


@pytest.mark.parametrize("number", [0, 1])
def test_of_two_contradicting_stops_the_nearer_to_the_origin_stays(number):
    found = implausible_stops(moved(drive(2), number, (5000.0, 0, 0)))
    assert list(found) == [StopId("MER2", 10, 2 * number)]


def test_consecutive_displaced_stops_are_set_aside_each_with_a_reason():
    stops = drive(9)
    for number in (3, 4):
        stops = moved(stops, number, (0, 20_000.0, 0))
    found = implausible_stops(stops)
    assert [stop.drive for stop in found] == [6, 8]
    assert all("mer2-site0010-drive0004" in reason for reason in found.values())


def test_an_overturned_rover_is_left_out_and_one_on_a_steep_slope_is_not():
    frame = StopId("MER2", 10, 0).frame
    for degrees, is_out in ((35.0, False), (45.0, False), (75.0, True), (180.0, True)):
        turn = rotation_of_roll_pitch_yaw(np.radians(degrees), 0.0, 1.0)
        poses = [Pose(site_frame(10), frame, turn, np.zeros(3))] * 2
        assert [reason is not None for reason in implausible_poses(poses)] == [is_out] * 2


def test_of_two_images_of_a_stop_that_disagree_by_metres_the_first_counts():
    frame = StopId("MER2", 10, 6).frame

    def label(east_m: float) -> Pose:
        return Pose(site_frame(10), frame, LEVEL, np.array([0.0, east_m, 0.0]))

    for apart_m, is_out in ((0.4, False), (4.0, False), (60.0, True), (1e9, True)):
        first, second = implausible_poses([label(1.0), label(1.0 + apart_m)])
        assert first is None
        assert (second is not None) == is_out


def test_an_image_that_disagrees_with_most_of_its_stop_is_identified():
    frame = StopId("MER2", 10, 0).frame

    def label(east_m: float = 0.0, yaw_deg: float = 0.0, roll_deg: float = 0.0) -> Pose:
        turn = rotation_of_roll_pitch_yaw(np.radians(roll_deg), 0.0, np.radians(yaw_deg))
        return Pose(site_frame(10), frame, turn, np.array([0.0, east_m, 0.0]))

    good = [label(0.1 * k, 2.0 * k) for k in range(4)]
    for odd in (label(60.0), label(-1e5), label(yaw_deg=90.0), label(roll_deg=180.0)):
        for place in range(5):
            found = implausible_poses([*good[:place], odd, *good[place:]])
            assert [k for k, reason in enumerate(found) if reason] == [place]
    for poses in (good, good[:1], [label(), label(60.0)], [label(), label(60.0), label(-60.0)]):
        assert not implausible_poses(poses)[0]
    divided = implausible_poses(
        [label(), label(60.0)] * 3
    )  # the first was taken before its place was corrected
    assert [reason is None for reason in divided] == [True, False] * 3


def test_total_wheel_slip_and_long_waits_are_accepted():
    rng = np.random.default_rng(3)
    place, sol, stops = np.zeros(3), 1, []
    for k in range(400):
        place = place + rng.normal(0.0, 100.0, 3) * (1, 1, 0.05)  # as the wheels count
        sol += int(rng.integers(0, 30))
        stops.append(stop_at(k, place, sol))
    assert implausible_stops(stops) == {}
    apart = [stop_at(0, (0, 0, 0), 100), stop_at(1, (11_000.0, 0, 0), 500)]
    assert implausible_stops(apart) == {}  # nothing of 400 sols was delivered


def test_no_stop_gives_no_reason_and_one_stop_is_tested_alone():
    assert implausible_stops([]) == {}
    assert implausible_stops([stop_at(0, (4e4, 0, 0), 5)]) == {}
    assert list(implausible_stops([stop_at(0, (1e12, 0, 0), 5)])) == [StopId("MER2", 10, 0)]


def stops_of(traverse: Traverse, places_m: np.ndarray, every: int = 1) -> list[TelemetryStop]:
    """A traverse, or every n-th of its stops, as telemetry ordered by site and drive."""
    ned = np.nan_to_num(places_m)[:, [1, 0, 2]] * (1, 1, -1)
    names = [StopId("MER2", *map(int, name.split("/")[:2])) for name in traverse.stops]
    stops = [
        TelemetryStop(name, Pose(LSL, name.frame, LEVEL, place), (int(sol),))
        for name, place, sol in list(zip(names, ned, traverse.sols, strict=True))[::every]
    ]
    return sorted(stops, key=lambda one: (one.stop.site, one.stop.drive))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("every", [60, pytest.param(1, marks=pytest.mark.slow)])
def test_the_whole_traverse_of_spirit_is_kept(shared_data, every):
    path = shared_data / "traverse" / "mer_spirit" / "MERA-MER2-Spirit_traverse_path.csv"
    table = parse_mission_table(path.read_text(), path.name)
    telemetry = table.telemetry()
    east, north = np.radians(table.localised_deg - table.localised_deg[0]).T * MARS_RADIUS_M
    east *= np.cos(np.radians(table.localised_deg[:, 1]))
    localised_m = np.column_stack([east, north, np.zeros(len(east))])
    assert len(telemetry) > 3000
    for places_m in (telemetry.places_m, localised_m):
        stops = stops_of(telemetry, places_m, every)
        for some in (stops, stops[len(stops) // 3 :], stops[::37]):
            assert implausible_stops(some) == {}
    for first in (1000, 2500):  # localised up to there, then telemetry again
        is_later = np.arange(len(telemetry))[:, None] >= first
        mixed_m = np.where(is_later, telemetry.places_m, localised_m)
        assert implausible_stops(stops_of(telemetry, mixed_m, every)) == {}


def test_the_traverse_of_curiosity_is_kept(shared_data):
    path = shared_data / "traverse" / "msl" / "locations.xml"
    file = parse_locations(path.read_text(), path.name, mission="MSL", keep_without_attitude=True)
    traverse = traverse_of_vectors([file])
    assert len(traverse) > 100
    assert implausible_stops(stops_of(traverse, traverse.places_m)) == {}
