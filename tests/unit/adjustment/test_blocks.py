"""The block algebra against dense algebra."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photogrammetry.adjustment.blocks import BlockPattern, factorise
from photogrammetry.errors import AdjustmentError


@st.composite
def systems(draw):
    """A positive definite block matrix: (pattern, flat array, the same dense, offsets)."""
    n = draw(st.integers(1, 7))
    sizes = np.array(draw(st.lists(st.integers(0, 4), min_size=n, max_size=n)), dtype=np.int64)
    couples = draw(st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)), max_size=9))
    pattern = BlockPattern.of(sizes, couples)
    offsets = np.concatenate([[0], np.cumsum(sizes)])[:-1]
    total = int(sizes.sum())
    dense, flat = np.eye(total), np.zeros(pattern.length + 1)
    for clique in [(k,) for k in range(n)] + couples:
        columns = np.concatenate([offsets[k] + np.arange(sizes[k]) for k in sorted(set(clique))])
        part = np.sin(draw(st.integers(0, 99)) + np.arange(3.0 * len(columns)).reshape(3, -1) ** 1.3)
        dense[np.ix_(columns, columns)] += part.T @ part
    for (s, t), block in pattern.views(flat).items():
        block[:] = dense[
            offsets[s] : offsets[s] + sizes[s], offsets[t] : offsets[t] + sizes[t]
        ]
    return pattern, flat, dense, offsets


@settings(deadline=None, max_examples=60)
@given(systems())
def test_a_block_system_is_solved_like_a_dense_one(system):
    pattern, flat, dense, offsets = system
    right = np.arange(1.0, len(dense) + 1)
    x = factorise(pattern, flat).solve(right, offsets)
    np.testing.assert_allclose(dense @ x, right, atol=1e-9)


@settings(deadline=None, max_examples=60)
@given(systems())
def test_the_inverse_on_the_pattern_is_that_of_the_dense_matrix(system):
    pattern, flat, dense, offsets = system
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
