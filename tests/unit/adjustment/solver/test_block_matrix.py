"""The block algebra against dense algebra."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solmap.photogrammetry.adjustment.model.collinearity import Observations, State
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.adjustment.solver.block_matrix import BlockPattern, factorise
from solmap.photogrammetry.adjustment.solver.normal_equations import (
    LinearisationPoint,
    linearise,
    normal_equations,
)
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.synthetic.networks import simulate_network


@st.composite
def structures(draw):
    """Sizes of blocks, which of them are coupled, and a seed for the numbers."""
    n = draw(st.integers(1, 7))
    sizes = draw(st.lists(st.integers(0, 4), min_size=n, max_size=n))
    couples = draw(st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)), max_size=9))
    return np.array(sizes, dtype=np.int64), couples, draw(st.integers(0, 99))


def system_of(structure):
    """A positive definite block matrix: pattern, flat array, the same dense, offsets."""
    sizes, couples, seed = structure
    rng = np.random.default_rng(seed)
    pattern = BlockPattern.of(sizes, couples)
    offsets = np.concatenate([[0], np.cumsum(sizes)])[:-1]
    total = int(sizes.sum())
    dense, flat = np.eye(total), np.zeros(pattern.length + 1)
    for clique in [(k,) for k in range(len(sizes))] + couples:
        columns = np.concatenate([offsets[k] + np.arange(sizes[k]) for k in sorted(set(clique))])
        part = rng.normal(size=(3, len(columns)))
        dense[np.ix_(columns, columns)] += part.T @ part
    for (s, t), block in pattern.views(flat).items():
        rows = slice(offsets[s], offsets[s] + sizes[s])
        block[:] = dense[rows, offsets[t] : offsets[t] + sizes[t]]
    return pattern, flat, dense, offsets


@settings(deadline=None, max_examples=40)
@given(structures())
def test_a_block_system_has_the_solution_of_the_dense_one(structure):
    pattern, flat, dense, offsets = system_of(structure)
    right = np.arange(1.0, len(dense) + 1)
    x = factorise(pattern, flat).solve(right, offsets)
    np.testing.assert_allclose(dense @ x, right, atol=1e-9)


@settings(deadline=None, max_examples=40)
@given(structures())
def test_the_inverse_on_the_pattern_equals_that_of_the_dense_matrix(structure):
    pattern, flat, dense, offsets = system_of(structure)
    inverse = np.linalg.inv(dense)
    sparse = pattern.views(factorise(pattern, flat).inverse())
    for (s, t), block in sparse.items():
        rows = slice(offsets[s], offsets[s] + pattern.sizes[s])
        columns = slice(offsets[t], offsets[t] + pattern.sizes[t])
        np.testing.assert_allclose(block, inverse[rows, columns], atol=1e-10)


def test_a_singular_block_is_named_with_advice():
    pattern = BlockPattern.of(np.array([2, 2]), [(0, 1)])
    flat = np.zeros(pattern.length + 1)
    with pytest.raises(AdjustmentError, match=r"singular at block 0.*hold one stop fixed"):
        factorise(pattern, flat)


def test_a_chain_of_stops_has_no_fill():
    sizes = np.full(50, 3)
    pattern = BlockPattern.of(sizes, [(k, k + 1) for k in range(49)])
    assert len(pattern.keys) == 50 + 2 * 49


@pytest.mark.usefixtures("unchecked")
def test_covariances_far_along_a_traverse_equal_those_of_the_dense_inverse():
    """Their asymmetry by rounding, if it were kept, would grow tenfold every eight stops."""
    network, truth = simulate_network(
        np.random.default_rng(1), stops=180, pairs_per_stop=4, inter_ties=2, intra_ties=0
    )
    observations = Observations.of(network)
    state = State(
        np.array([pose.rotation for pose in truth.lsl_from_rover]),
        np.array([pose.translation_m for pose in truth.lsl_from_rover]),
        truth.pointings,
        truth.points,
    )
    problem = Problem.of(
        observations,
        Telemetry.of(network, AdjustmentParams()),
        np.arange(180) == 0,
        np.ones(len(observations), dtype=bool),
    )
    now, flat = (
        linearise(problem, LinearisationPoint.of(problem, state), None),
        normal_equations(problem, state, None)[0],
    )
    offsets, sizes = problem.unknowns.offsets, problem.unknowns.sizes
    dense = np.zeros((problem.unknowns.count,) * 2)
    for (s, t), block in problem.pattern.views(flat).items():
        dense[offsets[s] : offsets[s] + sizes[s], offsets[t] : offsets[t] + sizes[t]] = block
    variances = np.diagonal(np.linalg.inv(dense))
    views = problem.pattern.views(now.factor.inverse())
    ours = np.concatenate([np.diagonal(views[k, k]) for k in range(181)])  # the mast is last
    np.testing.assert_allclose(ours, variances, rtol=1e-5)  # condition 1e10, squared unit 1e-16
