import numpy as np
import pytest

from solmap.photogrammetry.archive.tables.places import PlacedStop, parse_places, places_text
from solmap.photogrammetry.archive.tables.vector_files import (
    Solution,
    VectorFile,
    best_poses,
    parse_vector_file,
    vector_text,
)
from solmap.photogrammetry.frames import (
    LSL,
    FrameKind,
    Pose,
    rotation_of_roll_pitch_yaw,
    rover_frame,
)
from solmap.photogrammetry.imagery import StopId


def a_pose(site=10, drive=33):
    rotation = rotation_of_roll_pitch_yaw(0.1, -0.05, 2.1)
    return Pose(LSL, rover_frame(site, drive), rotation, np.array([12.3456, -7.5, 0.25]))


def test_a_vector_file_is_read_back_as_written():
    pose = a_pose()
    counter = (10, 33, 0, 0, 0)
    one = Solution(
        "adjusted", FrameKind.ROVER, counter, 10, pose.translation_m, pose.quaternion, ""
    )
    file = VectorFile("", "MER2", "rvf", ("adjusted", "telemetry"), (one,))
    back = parse_vector_file(vector_text(file), "own.rvf")
    assert (back.mission, back.kind, back.priority) == ("MER2", "rvf", ("adjusted", "telemetry"))
    assert back.solutions[0].counter == counter
    np.testing.assert_allclose(back.solutions[0].offset_m, pose.translation_m, atol=1e-9)
    (read,) = best_poses([back])
    assert read.source == rover_frame(10, 33)
    np.testing.assert_allclose(read.rotation, pose.rotation, atol=1e-8)


def test_a_places_table_is_read_back_as_written():
    placed = PlacedStop(StopId("MER2", 10, 33), a_pose(), 175.47301, -14.56921, 1.4e8, 156)
    text = places_text([placed])
    back = parse_places(text, "places.csv", mission="MER2", solution_id="adjusted").solutions[0]
    assert back.counter[:2] == (10, 33)
    np.testing.assert_allclose(back.offset_m, a_pose().translation_m, atol=1e-4)
    np.testing.assert_allclose(back.pose.rotation, a_pose().rotation, atol=1e-8)
    head, row = (line.split(",") for line in text.splitlines())
    fields = dict(zip(head, row, strict=True))
    assert float(fields["yaw"]) == pytest.approx(np.degrees(2.1), abs=1e-4)
    assert (fields["sol"], fields["longitude"]) == ("156", "175.473010000")


def test_an_unknown_clock_stays_empty():
    placed = PlacedStop(StopId("MER2", 10, 33), a_pose(), 175.5, -14.5, None, 156)
    head, row = (line.split(",") for line in places_text([placed]).splitlines())
    assert dict(zip(head, row, strict=True))["sclk"] == ""
