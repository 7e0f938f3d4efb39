import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solmap.photogrammetry.errors import FrameError
from solmap.photogrammetry.frames import (
    LSL,
    FrameTree,
    Pose,
    quaternion_of_rotation,
    roll_pitch_yaw_of_rotation,
    rotation_of_quaternion,
    rotation_of_roll_pitch_yaw,
    rover_frame,
    site_frame,
)

angles = st.floats(-3.0, 3.0)
tilts = st.floats(-1.4, 1.4)


def test_the_quaternion_of_a_label_rotates_the_rover_into_its_site():
    case = np.array([0.994261, -0.095668, -0.0233068, 0.0418276])
    pose = Pose.of_quaternion(site_frame(137), rover_frame(137, 0), case, np.zeros(3))
    in_site = pose.apply(np.array([[10.0, 2.0, -1.0]]))
    np.testing.assert_allclose(in_site[0], [9.851062772, 2.644449445, -0.981554581], atol=1e-8)


@given(tilts, tilts, angles)
def test_roll_pitch_and_yaw_are_recovered(roll, pitch, yaw):
    rotation = rotation_of_roll_pitch_yaw(roll, pitch, yaw)
    np.testing.assert_allclose(roll_pitch_yaw_of_rotation(rotation), (roll, pitch, yaw), atol=1e-9)
    again = rotation_of_quaternion(quaternion_of_rotation(rotation))
    np.testing.assert_allclose(again, rotation, atol=1e-12)


def test_a_chain_of_poses_cancels_with_its_inverse():
    lsl_from_site = Pose(LSL, site_frame(3), np.eye(3), np.array([1.0, 2.0, 3.0]))
    there_and_back = lsl_from_site.inverse @ lsl_from_site
    np.testing.assert_allclose(there_and_back.translation_m, 0.0, atol=1e-15)


def test_poses_with_different_frames_are_refused():
    lsl_from_site = Pose.identity(LSL, site_frame(13))
    site_from_rover = Pose.identity(site_frame(12), rover_frame(12, 104))
    with pytest.raises(FrameError, match=r"site\[13\] and site\[12\] differ"):
        lsl_from_site @ site_from_rover


def test_a_quaternion_far_from_unit_length_is_refused():
    with pytest.raises(FrameError, match="is not a unit quaternion"):
        Pose.of_quaternion(LSL, site_frame(1), np.zeros(4), np.zeros(3))


def test_the_tree_connects_frames_through_a_common_ancestor():
    east, north = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    tree = FrameTree().with_poses(
        [
            Pose(LSL, site_frame(1), np.eye(3), east),
            Pose(LSL, site_frame(2), np.eye(3), north),
        ]
    )
    np.testing.assert_allclose(
        tree.pose(site_frame(2), site_frame(1)).translation_m, [-1.0, 1.0, 0.0]
    )


def test_frames_without_a_common_ancestor_are_named():
    tree = FrameTree().with_poses([Pose.identity(site_frame(1), rover_frame(1, 0))])
    with pytest.raises(FrameError, match=r"lsl and rover\[1, 0\] are not connected"):
        tree.pose(LSL, rover_frame(1, 0))


def test_a_circle_of_frames_is_an_error_and_ends():
    tree = FrameTree().with_poses(
        [
            Pose.identity(site_frame(1), site_frame(2)),
            Pose.identity(site_frame(2), site_frame(1)),
        ]
    )
    with pytest.raises(FrameError, match="forms a loop"):
        tree.pose(LSL, site_frame(1))


def test_many_poses_are_checked_like_one():
    rotations = np.array([rotation_of_roll_pitch_yaw(0.1 * k, -0.2, 3.0) for k in range(4)])
    places, ends = np.arange(12.0).reshape(4, 3), [(LSL, rover_frame(1, k)) for k in range(4)]
    for pose, (target, source), R, t in zip(
        Pose.many(ends, rotations, places), ends, rotations, places, strict=True
    ):
        one = Pose(target, source, R, t)
        assert (pose.target, pose.source) == (one.target, one.source)
        np.testing.assert_array_equal(pose.rotation, one.rotation)
        np.testing.assert_array_equal(pose.translation_m, one.translation_m)
        assert not pose.rotation.flags.writeable
        assert not pose.translation_m.flags.writeable
    rotations[2, 0] *= -1.0
    with pytest.raises(FrameError, match="not a proper rotation"):
        Pose.many(ends, rotations, places)
    places[3, 1] = np.nan
    with pytest.raises(FrameError, match="finite"):
        Pose.many(ends[3:], rotations[3:], places[3:])
