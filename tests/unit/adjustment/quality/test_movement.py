import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.adjustment.quality.movement import ReissueParams, ground_shift_m
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose

PAIR = Frame(FrameKind.PAIR, (10, 64, 0, 1))
vectors = arrays(np.float64, 3, elements=st.floats(-1.0, 1.0))


def pose(turn, shift, frame=PAIR) -> Pose:
    return Pose(LSL, frame, Rotation.from_rotvec(turn).as_matrix(), np.array(shift, dtype=float))


@given(vectors, vectors, vectors, vectors, st.floats(0.0, 50.0))
def test_no_ground_in_range_moves_further_than_the_bound(turn, other_turn, shift, other, range_m):
    before, after = pose(turn, shift), pose(other_turn, other)
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for metres in (range_m, range_m / 2):
        moved = np.linalg.norm(
            after.apply(metres * directions) - before.apply(metres * directions), axis=1
        )
        bound = ground_shift_m(before, after, range_m)
        assert moved.max() <= bound + 1e-12  # rounding of sums of metres


def test_a_rotation_across_the_line_of_sight_counts_in_full():
    angle = np.radians(0.1)
    shift = ground_shift_m(pose([0, 0, 0], [0, 0, 0]), pose([0, angle, 0], [0, 0, 0]), 10.0)
    assert shift == pytest.approx(2 * 10.0 * np.sin(angle / 2), rel=1e-12)


def test_poses_of_different_pairs_are_not_compared():
    other = pose([0, 0, 0], [0, 0, 0], Frame(FrameKind.PAIR, (10, 64, 0, 2)))
    with pytest.raises(AdjustmentError, match="not two poses of one pair"):
        ground_shift_m(pose([0, 0, 0], [0, 0, 0]), other, 10.0)


def test_a_negative_threshold_is_refused():
    with pytest.raises(AdjustmentError, match=r"shift_m must not be negative, but is -0\.1"):
        ReissueParams(shift_m=-0.1)
