"""The stated standard deviations are true, and remaining blunders do no harm.

Harmful is a blunder that shifts the test of its own observation beyond what noise could hide
(`DETECTED`); and all blunders together may seldom move a pose by more than its standard deviation.
"""

import numpy as np
import pytest

from tests.support.adjustment.network_statistics import CASES, band, found

NETWORKS = 200
BOUNDS = band(100, level=0.995)
"""Where means of half as many networks lie by chance. Twice as many leave room for what is known:
with few ties NEES is 5 % too small, because factors of ties between stops are never below 1."""


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(CASES)))
def test_stated_sigmas_are_true_in_every_mode_and_no_harmful_blunder_remains(number):
    case = CASES[number]
    results = [found(case, 100_000 * (number + 1) + seed) for seed in range(NETWORKS)]
    low, high = BOUNDS
    stepwise, sequential, overall = np.mean([result.nees for result in results], axis=0)
    if_known = np.mean([result.nees_if_known for result in results])
    assert low < if_known < high  # with the sigmas that the networks were made with
    assert low < overall < high
    assert low < sequential < high
    # ties used twice correlate a step with the one before, which stepwise ignores
    assert 0.9 * low < stepwise < 1.1 * high
    cost, redundancy = (sum(getattr(r, name) for r in results) for name in ("cost", "redundancy"))
    # estimated, on the side of caution
    assert np.sqrt(cost / redundancy) == pytest.approx(0.95, abs=0.06)
    assert sum(result.harmful_left for result in results) == 0
    assert np.mean([result.moved > 1.0 for result in results]) < 0.1
