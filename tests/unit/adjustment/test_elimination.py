"""Tie points taken out of their observations, and the coordinates that this is done in."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from photogrammetry.adjustment.elimination import inverse_of, orthonormal
from photogrammetry.adjustment.layout import Unknowns, tie_groups


@settings(deadline=None, max_examples=30)
@given(
    st.integers(2, 5),
    st.floats(0.0, 10.0).map(lambda power: 10.0**-power),
    st.integers(0, 99),
)
def test_columns_are_orthonormal_however_far_the_point(k, feeble, seed):
    """The column of the range may be as small as that, and nearly along the others."""
    A_t = np.random.default_rng(seed).normal(size=(3, 3 * k, 4))
    A_t[2] = A_t[0] + feeble * A_t[2]
    Q, R = (columns.transpose(2, 1, 0) for columns in orthonormal(A_t))
    np.testing.assert_allclose(Q @ R.mT, A_t.transpose(2, 1, 0), atol=1e-14 * k)
    np.testing.assert_allclose(Q.mT @ Q, np.tile(np.eye(3), (4, 1, 1)), atol=1e-14)


def test_a_direction_that_the_images_do_not_feel_is_left_alone():
    A_t = np.random.default_rng(1).normal(size=(3, 6, 1))
    A_t[2] = 0.0
    Q, R = orthonormal(A_t)
    assert not Q[2].any()
    assert R[2, 2, 0] == 0
    assert np.isnan(inverse_of(R.transpose(2, 0, 1))).all()


def test_a_common_motion_of_its_stops_is_none_to_a_tie_point(bent):
    _, observations, state = bent
    unknowns = Unknowns.of(np.zeros(3, dtype=bool), observations.pair_stop)
    groups = tie_groups(observations, np.ones(len(observations), dtype=bool), unknowns)
    turn, shift = np.array([0.1, -0.2, 0.3]), np.array([1.0, 2.0, -3.0])
    for group in groups:
        T = group.to_relative(state.centres)
        for signature, stops in enumerate(group.stops):
            motion = [np.append(turn, shift + np.cross(turn, state.centres[s])) for s in stops]
            pairs = np.zeros(3 * group.seen)
            x = np.concatenate([*motion[1:], pairs, motion[0]])
            np.testing.assert_allclose(T[signature] @ x, 0.0, atol=1e-12)


def test_every_used_observation_of_a_shared_point_is_in_one_group(bent):
    _, observations, _ = bent
    unknowns = Unknowns.of(np.zeros(3, dtype=bool), observations.pair_stop)
    used = np.arange(len(observations)) % 7 > 0
    groups = tie_groups(observations, used, unknowns)
    rows = np.sort(np.concatenate([group.rows.ravel() for group in groups]))
    counts = np.bincount(observations.point[used], minlength=observations.points)
    np.testing.assert_array_equal(rows, np.flatnonzero(used & (counts[observations.point] > 1)))
    for group in groups:
        assert (observations.point[group.rows] == observations.point[group.rows[0]]).all()
        stops = observations.stop[group.rows]
        expected = group.stops[group.signature][:, list(group.slots)].T
        np.testing.assert_array_equal(stops, expected)
