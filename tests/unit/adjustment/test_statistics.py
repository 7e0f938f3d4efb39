"""The stated standard deviations are true, and what is left of blunders does no harm."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from photogrammetry.adjustment.adjust import adjust_overall
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.records import USED, select
from photogrammetry.adjustment.sequential import begin, extend
from photogrammetry.adjustment.stepwise import adjust_stepwise
from photogrammetry.synthetic.networks import simulate_network

NETWORKS = 100
STOPS = 5
PARAMS = AdjustmentParams(window_stops=2)
"""So short a window that stops leave it although the networks are small."""


def error(stop, pose):
    """Rotation vector in the LSL and position, adjusted minus true."""
    turn = Rotation.from_matrix(stop.lsl_from_rover.rotation @ pose.rotation.T).as_rotvec()
    return np.array([*turn, *(stop.lsl_from_rover.translation_m - pose.translation_m)])


def nees(stop, pose):
    e = error(stop, pose)
    return e @ np.linalg.solve(stop.covariance, e)


def last_of_each_mode(network):
    """The last stop as the three modes have it, and sigma0 and redundancy of the overall one."""
    traverse, step = None, None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[: k + 1]))
        traverse, _ = begin(part, PARAMS) if k == 0 else extend(traverse, part, [stop], PARAMS)
        step, _ = adjust_stepwise(step, part, [stop], PARAMS)
    overall, report = adjust_overall(network, PARAMS)
    stops = step.stops[-1], traverse.window.stops[-1], overall.stops[-1]
    return stops, (report.sigma0**2 * report.redundancy, report.redundancy)


@pytest.mark.slow
def test_stated_sigmas_are_true_in_every_mode():
    sums, cost = np.zeros(3), np.zeros(2)
    for seed in range(NETWORKS):
        network, truth = simulate_network(
            np.random.default_rng(7000 + seed), stops=STOPS, pairs_per_stop=5, cross_ties=8,
            far_cross_ties=3, inter_ties=4, intra_ties=0,
        )  # fmt: skip
        stops, found = last_of_each_mode(network)
        sums += [nees(stop, truth.lsl_from_rover[-1]) for stop in stops]
        cost += found
    low, high = chi2.ppf([0.025, 0.975], 6 * NETWORKS)
    stepwise, sequential, overall = sums
    assert low < overall < high
    assert low < sequential < high
    assert 0.9 * low < stepwise < 1.1 * high  # ties used twice correlate a step with the one before
    assert np.sqrt(cost[0] / cost[1]) == pytest.approx(1.0, abs=0.02)  # 300 redundant a network


@pytest.mark.slow
@pytest.mark.parametrize(("fraction", "harmful"), [(0.05, 1.0), (0.2, 3.0)])
def test_no_harmful_blunder_is_left(fraction, harmful):
    """Harmful: without the blunders a pose would be elsewhere by so many standard deviations.

    What stays are errors of 5 to 8 px in pairs with one or two ties, where the mast pointing (2.2
    px) takes them up; with a fifth of all ties wrong that can add up to 2.5 sigma.
    """
    params = AdjustmentParams()
    left, shifts = 0, []
    for seed in range(6):
        network, truth = simulate_network(
            np.random.default_rng(500 + seed), stops=5, pairs_per_stop=6, cross_ties=20,
            far_cross_ties=4, inter_ties=6, intra_ties=0, blunders=fraction,
        )  # fmt: skip
        adjusted, _ = adjust_overall(network, params)
        still = (truth.blunders != 0) & (adjusted.ties.status == USED)
        left += int(still.sum())
        clean = replace(network, ties=select(network.ties, truth.blunders == 0))
        without, _ = adjust_overall(clean, params)
        for a, b in zip(adjusted.stops[1:], without.stops[1:], strict=True):
            apart = error(a, b.lsl_from_rover)
            shifts.append(np.abs(apart / np.sqrt(np.diagonal(a.covariance))).max())
    print(f"{fraction:.0%}: {left} blunders left, worst shift {max(shifts):.2f} sigma")  # noqa: T201
    assert max(shifts) < harmful
