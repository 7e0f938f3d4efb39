import numpy as np
import pytest

from solmap.photogrammetry.robust import geman_mcclure_weights, robust_sigma


def test_the_spread_of_normal_residuals_is_their_sigma_despite_blunders(rng):
    residuals = rng.normal(0.0, 0.3, 20_000)
    assert robust_sigma(residuals) == pytest.approx(0.3, rel=0.03)  # 1.2 % of 20 000, 2.5 times
    residuals[:400] = 1e6
    assert robust_sigma(residuals) == pytest.approx(0.3, rel=0.06)  # 2 % of blunders: 2.6 % more


def test_no_residuals_have_no_spread():
    assert robust_sigma(np.zeros(0)) == 0.0


def test_weights_are_one_without_residual_and_a_quarter_at_twice_the_scale():
    weights = geman_mcclure_weights(np.array([0.0, 0.6, -0.6, 60.0]), 0.3)
    np.testing.assert_allclose(weights[:3], [1.0, 0.25, 0.25])
    assert weights[3] < 1e-7
