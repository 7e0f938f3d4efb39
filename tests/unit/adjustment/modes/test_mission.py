"""What a mode does with new stops, with new images of old stops, and when nothing converges."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.network import select
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.photogrammetry.adjustment.modes.mission import advance
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.synthetic.networks import simulate_network


@pytest.fixture(scope="module")
def network():
    return simulate_network(
        np.random.default_rng(1), stops=5, far_cross_ties=8, inter_ties=10, intra_ties=2
    )[0]


def along(mode, network, params):
    states, previous = [], None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[: k + 1]))
        previous, report = advance(mode, previous, part, [stop], params)
        assert report.converged
        states.append(previous)
    return states


def places(adjusted):
    return np.array([stop.lsl_from_rover.translation_m for stop in adjusted.stops])


def test_a_sequential_traverse_ends_where_the_overall_adjustment_does(network, params):
    last = along(AdjustmentMode.SEQUENTIAL, network, replace(params, window_stops=3))[-1]
    overall, _ = advance(AdjustmentMode.OVERALL, None, network, (), params)
    sigma = np.array([stop.sigma_ned_m for stop in overall.stops[1:]])
    off = np.abs(places(last) - places(overall))[1:] / sigma
    # what is frozen when a stop leaves is its linearisation: a fraction of what is uncertain
    assert off[-3:].max() < 0.1


def test_after_an_overall_adjustment_a_step_continues_exactly(network, params):
    short = replace(params, window_stops=2, sigma_freedoms=np.inf)
    earlier = network.within(set(network.stop_ids[:-1]))
    before, _ = advance(AdjustmentMode.OVERALL, None, earlier, (), short)
    assert before.memory is not None
    assert before.memory.window == network.stop_ids[-3:-1]
    after, report = advance(
        AdjustmentMode.SEQUENTIAL, before, network, network.stop_ids[-1:], short
    )
    assert report.name.startswith("sequential step")
    overall, together = advance(AdjustmentMode.OVERALL, before, network, (), short)
    assert report.redundancy == together.redundancy
    off = np.abs(places(after) - places(overall))[1:]
    assert (off[-3:] < 0.05 * np.array([stop.sigma_ned_m for stop in overall.stops[-3:]])).all()


def test_stepwise_keeps_stops_that_sequential_moves(network, params):
    for mode, moves in ((AdjustmentMode.STEPWISE, False), (AdjustmentMode.SEQUENTIAL, True)):
        states = along(mode, network, params)
        seconds = np.array([places(state)[1] for state in states[1:]])
        assert (np.ptp(seconds[1:], axis=0) > 0).any() == moves


@pytest.mark.usefixtures("unchecked")
def test_new_images_of_a_known_stop_keep_the_information_about_the_stops(network, params):
    late = network.pairs[-1].pair_id
    seen = np.array([name != late for name in network.ties.pair_ids])[network.ties.pair]
    short = replace(network, pairs=network.pairs[:-1], ties=select(network.ties, seen))
    for mode in (AdjustmentMode.STEPWISE, AdjustmentMode.SEQUENTIAL):
        before = along(mode, short, replace(params, window_stops=3))[-1]
        after, report = advance(mode, before, network, (), params)
        assert report.name == "pointing at known stops"
        for stop, other in zip(before.stops, after.stops, strict=True):
            assert stop is other
        assert after.memory is before.memory
        new = after.pair(late)
        old = after.pair(network.pairs[-2].pair_id)
        stop = after.stops[-1]
        for pair in (new, old):  # both carry the uncertainty of their stop
            assert np.sqrt(np.diagonal(pair.covariance)[3:]) == pytest.approx(
                stop.sigma_ned_m, rel=0.2
            )


def test_an_overall_adjustment_that_fails_is_refused_and_a_step_that_fails_is_reported(
    network, params
):
    hasty = replace(params, max_iterations=1)
    with pytest.raises(AdjustmentError, match="the previous network is kept"):
        advance(AdjustmentMode.OVERALL, None, network, (), hasty)
    two = network.within(set(network.stop_ids[:2]))
    first, _ = adjust_overall(network.within({network.stop_ids[0]}), params)
    adjusted, report = advance(AdjustmentMode.STEPWISE, first, two, two.stop_ids[1:], hasty)
    assert not report.converged
    assert "its stops remain at telemetry" in report.message
    reported = [prior.lsl_from_rover.translation_m for prior in two.stops]
    for (old, new), (was, now) in zip(pairwise(reported), pairwise(places(adjusted)), strict=True):
        assert np.linalg.norm(now - was) == pytest.approx(np.linalg.norm(new - old), rel=1e-6)
