"""Tie points taken out of their observations, and the coordinates that this is done in."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.adjustment.solver.elimination import orthonormalise
from solmap.photogrammetry.adjustment.solver.gauss_newton import solve
from solmap.photogrammetry.adjustment.solver.layout import Unknowns, tie_groups
from solmap.photogrammetry.adjustment.solver.normal_equations import (
    LinearisationPoint,
    linearise,
    normal_equations,
)
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.adjustment.solver.residuals import residuals
from solmap.photogrammetry.errors import AdjustmentError


@settings(deadline=None, max_examples=30)
@given(
    st.integers(2, 5),
    st.floats(0.0, 10.0).map(lambda power: 10.0**-power),
    st.integers(0, 99),
)
def test_columns_are_orthonormal_at_any_distance_of_the_point(k, feeble, seed):
    """The column of the range may be as small as that, and nearly along the others."""
    A_t = np.random.default_rng(seed).normal(size=(3, 3 * k, 4))
    A_t[2] = A_t[0] + feeble * A_t[2]
    Q, R = (columns.transpose(2, 1, 0) for columns in orthonormalise(A_t))
    np.testing.assert_allclose(Q @ R.mT, A_t.transpose(2, 1, 0), atol=1e-14 * k)
    np.testing.assert_allclose(Q.mT @ Q, np.tile(np.eye(3), (4, 1, 1)), atol=1e-14)


def test_a_direction_that_images_do_not_determine_is_not_changed():
    A_t = np.random.default_rng(1).normal(size=(3, 6, 1))
    A_t[2] = 0.0
    Q, R = orthonormalise(A_t)
    assert not Q[2].any()
    assert R[2, 2, 0] == 0


def test_a_common_motion_of_its_stops_does_not_change_a_tie_point(bent):
    network, observations, state = bent
    held, used = np.arange(3) == 0, np.ones(len(observations), dtype=bool)
    telemetry = Telemetry.of(network, AdjustmentParams())
    problem = Problem.of(observations, telemetry, held, used)
    ties = linearise(problem, LinearisationPoint.of(problem, state), None).ties
    turn, shift = np.array([0.1, -0.2, 0.3]), np.array([1.0, 2.0, -3.0])
    joining = [tie for tie in ties if tie.group.slots[-1]]
    assert joining
    for tie in joining:
        for n, stops in enumerate(tie.group.stops[tie.group.signature]):
            motion = [np.append(turn, shift + np.cross(turn, state.centres[s])) for s in stops]
            x = np.concatenate([*motion[1:], np.zeros(3 * tie.group.seen), motion[0]])
            for A in (tie.free[n, :, :-1], tie.along[n, :, :-1]):
                np.testing.assert_allclose(A @ x, 0.0, atol=1e-13 * np.abs(A).max())


def test_every_used_observation_of_a_shared_point_is_in_one_group(bent):
    _, observations, _ = bent
    unknowns = Unknowns.of(np.zeros(3, dtype=bool), observations.pair_stop)
    used = np.arange(len(observations)) % 7 > 0
    groups = tie_groups(observations, used, unknowns)
    rows = np.sort(np.concatenate([group.rows[group.counts] for group in groups]))
    counts = np.bincount(observations.point[used], minlength=observations.points)
    np.testing.assert_array_equal(rows, np.flatnonzero(used & (counts[observations.point] > 1)))
    for group in groups:
        assert (observations.point[group.rows] == observations.point[group.rows[0]]).all()
        stops = observations.stop[group.rows]
        expected = group.stops[group.signature][:, list(group.slots)].T
        np.testing.assert_array_equal(stops, expected)


def test_groups_that_fill_the_cache_lose_and_double_no_row(bent, monkeypatch):
    _, observations, _ = bent
    unknowns = Unknowns.of(np.zeros(3, dtype=bool), observations.pair_stop)
    used = np.ones(len(observations), dtype=bool)
    whole = tie_groups(observations, used, unknowns)
    monkeypatch.setattr("solmap.photogrammetry.adjustment.solver.layout.LEAST_POINTS", 3)
    monkeypatch.setattr("solmap.photogrammetry.adjustment.solver.layout.CACHED", 0)
    parts = tie_groups(observations, used, unknowns)
    assert len(parts) > 2 * len(whole)
    for k in {group.seen for group in whole}:
        rows = [
            np.concatenate([g.rows for g in some if g.seen == k], axis=1) for some in (whole, parts)
        ]
        np.testing.assert_array_equal(*rows)
    for group in parts:
        pairs = observations.pair[group.rows]
        np.testing.assert_array_equal(pairs, pairs[:, group.first[group.signature]])


def test_merging_points_with_those_seen_more_often_keeps_the_information(bent, monkeypatch):
    network, observations, state = bent
    telemetry, held = Telemetry.of(network, AdjustmentParams()), np.array([True, False, False])
    used = np.arange(len(observations)) % 7 > 0
    monkeypatch.setattr("solmap.photogrammetry.adjustment.solver.layout.OWN_GROUP", -1)
    apart = Problem.of(observations, telemetry, held, used)
    monkeypatch.undo()
    joined = Problem.of(observations, telemetry, held, used)
    assert len(joined.groups) < len(apart.groups)
    assert joined.redundancy == apart.redundancy
    for found, expected in zip(
        normal_equations(joined, state, None)[:2],
        normal_equations(apart, state, None)[:2],
        strict=True,
    ):
        np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())
    found, expected = (
        residuals(problem, now.ties, now.factor.inverse())
        for problem in (joined, apart)
        for now in [linearise(problem, LinearisationPoint.of(problem, state), None)]
    )
    np.testing.assert_allclose(found.test, expected.test, rtol=1e-6)
    np.testing.assert_allclose(found.redundancy, expected.redundancy, atol=1e-9)


def test_a_point_measured_twice_in_one_pair_is_named(bent):
    _, observations, _ = bent
    unknowns = Unknowns.of(np.zeros(3, dtype=bool), observations.pair_stop)
    twice = observations.select(np.append(np.arange(len(observations)), 5))
    with pytest.raises(AdjustmentError, match=rf"tie point {observations.point[5]} was .* twice"):
        tie_groups(twice, np.ones(len(twice), dtype=bool), unknowns)


def test_fixed_masts_equal_masts_with_a_great_weight(bent):
    """1e-8 rad is a hundred-thousandth of what a pixel sees, and its square is lost in the cost."""
    network, observations, state = bent
    systematic = np.zeros((0, 3, 0))
    telemetry = replace(Telemetry.of(network, AdjustmentParams()), mast=systematic)
    state = replace(state, pointings=np.zeros_like(state.pointings))
    fixed, free = (
        Problem.of(
            observations,
            replace(telemetry, pointing_weight=weight),
            np.array([True, False, False]),
            np.ones(len(observations), dtype=bool),
        )
        for weight in (np.inf, 1e8)
    )
    found, expected = (
        solve(problem, state, AdjustmentParams(), robust=False) for problem in (fixed, free)
    )
    assert found.converged
    assert fixed.unknowns.count == 12
    assert fixed.redundancy == free.redundancy
    np.testing.assert_allclose(found.state.centres, expected.state.centres, atol=1e-7)
    np.testing.assert_allclose(found.state.points, expected.state.points, atol=1e-6)
    assert not found.state.pointings.any()
