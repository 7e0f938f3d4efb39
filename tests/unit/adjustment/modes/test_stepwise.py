"""The mission's mode: one stop after another, the earlier ones held."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.adjusted_network import USED
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.modes.stepwise import adjust_stepwise
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.synthetic.networks import simulate_network


def along(network, params):
    """Adjusted networks after each stop, with the reports."""
    states, reports, previous = [], [], None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[: k + 1]))
        previous, report = adjust_stepwise(previous, part, [stop], params)
        states.append(previous)
        reports.append(report)
    return states, reports


def position(network, stop):
    return network.stop(stop).lsl_from_rover.translation_m


def test_without_ties_beyond_the_last_stop_all_earlier_stops_stay(params):
    network, truth = simulate_network(
        np.random.default_rng(1), stops=5, far_cross_ties=0, inter_ties=10, intra_ties=2
    )
    states, reports = along(network, params)
    assert all(report.is_usable for report in reports)
    for earlier, later in pairwise(states):
        for stop in earlier.stops:
            np.testing.assert_array_equal(
                stop.lsl_from_rover.translation_m, position(later, stop.stop)
            )
    last = network.stop_ids[-1]
    off = np.linalg.norm(position(states[-1], last) - truth.lsl_from_rover[-1].translation_m)
    reported = network.stops[-1].lsl_from_rover.translation_m
    assert off < 0.2 * np.linalg.norm(reported - truth.lsl_from_rover[-1].translation_m)


def test_ties_to_the_stop_before_last_let_the_last_one_move_again(params):
    network, _ = simulate_network(
        np.random.default_rng(1), stops=4, far_cross_ties=6, inter_ties=10, intra_ties=2
    )
    states, reports = along(network, params)
    third, fourth = network.stop_ids[2:]
    assert (position(states[2], third) != position(states[3], third)).any()
    second = network.stop_ids[1]
    np.testing.assert_array_equal(position(states[2], second), position(states[3], second))
    assert f"with {second}" in states[3].stop(fourth).held_by
    assert reports[3].stops == 4  # the first stop is in as well, held, for its ties to the third


def test_stepwise_and_overall_agree_within_their_uncertainty(params):
    network, _ = simulate_network(
        np.random.default_rng(2), stops=5, far_cross_ties=0, inter_ties=10, intra_ties=2
    )
    step = along(network, params)[0][-1]
    overall, _ = adjust_overall(network, params)
    for a, b in zip(step.stops[1:], overall.stops[1:], strict=True):
        apart = a.lsl_from_rover.translation_m - b.lsl_from_rover.translation_m
        assert (np.abs(apart) < 3 * a.sigma_ned_m).all()
        # it ignores that errors of the mast are those of the steps before
        assert (a.sigma_ned_m > 0.85 * b.sigma_ned_m).all()


def test_uncertainty_grows_along_the_traverse(params):
    network, _ = simulate_network(
        np.random.default_rng(3), stops=5, far_cross_ties=0, inter_ties=10, intra_ties=2
    )
    stops = along(network, params)[0][-1].stops
    sigmas = [np.linalg.norm(stop.sigma_ned_m) for stop in stops]
    assert sigmas == sorted(sigmas)
    assert sigmas[0] == 0.0


def test_every_step_returns_the_ties_of_the_whole_traverse(params):
    network, truth = simulate_network(
        np.random.default_rng(4), stops=5, far_cross_ties=3, inter_ties=10, intra_ties=4
    )
    last = along(network, params)[0][-1]
    assert len(last.ties.observations) == len(network.ties)
    assert (last.ties.status == USED).mean() > 0.99
    assert np.isfinite(last.ties.points).all()
    assert [pair.pair_id for pair in last.pairs] == [pair.pair_id for pair in network.pairs]
    assert np.median(np.linalg.norm(last.ties.points - truth.points, axis=1)) < 0.5


def test_two_new_stops_may_be_added_at_once(params):
    network, _ = simulate_network(np.random.default_rng(5), stops=4, inter_ties=10, intra_ties=2)
    first, _ = adjust_stepwise(
        None, network.within(set(network.stop_ids[:2])), network.stop_ids[:2], params
    )
    both, report = adjust_stepwise(first, network, network.stop_ids[2:], params)
    assert report.converged
    assert [stop.stop for stop in both.stops] == list(network.stop_ids)


def test_a_gap_in_the_traverse_is_refused_with_advice(params):
    network, _ = simulate_network(np.random.default_rng(5), stops=5, inter_ties=4, intra_ties=2)
    first, _ = adjust_stepwise(
        None, network.within({network.stop_ids[0]}), network.stop_ids[:1], params
    )
    with pytest.raises(AdjustmentError, match="adjust the traverse in order, or overall"):
        adjust_stepwise(first, network, [network.stop_ids[4]], params)


def test_an_unknown_stop_is_not_in_the_adjusted_network(params):
    network, _ = simulate_network(np.random.default_rng(5), stops=1, inter_ties=4, intra_ties=2)
    adjusted, _ = adjust_overall(network, params)
    with pytest.raises(AdjustmentError, match="test-site0007-drive0001 is not in the adjusted"):
        adjusted.stop(StopId("TEST", 7, 1))
    assert replace(adjusted).stop(network.stop_ids[0]).held


def test_ties_keep_earlier_estimates_under_new_numbers(params):
    network, _ = simulate_network(
        np.random.default_rng(3), stops=3, far_cross_ties=0, inter_ties=10, intra_ties=2
    )
    two = network.within(set(network.stop_ids[:2]))
    before, _ = adjust_stepwise(None, two.within({network.stop_ids[0]}), two.stop_ids[:1], params)
    before, _ = adjust_stepwise(before, two, two.stop_ids[1:], params)
    turned = network.ties.point.max() - network.ties.point
    renumbered = replace(network, ties=replace(network.ties, point=turned.astype(np.int32)))
    after, _ = adjust_stepwise(before, renumbered, network.stop_ids[2:], params)
    of_first = {p.pair_id for p in network.pairs if p.stop == network.stop_ids[0]}

    def seen_there(ties):
        return np.flatnonzero([ties.pair_ids[k] in of_first for k in ties.pair])

    old, new = seen_there(before.ties.observations), seen_there(after.ties.observations)
    assert (before.ties.status[old] == USED).sum() > 40
    np.testing.assert_array_equal(after.ties.status[new], before.ties.status[old])
    np.testing.assert_array_equal(
        after.ties.points[turned[new]], before.ties.points[two.ties.point[old]]
    )
