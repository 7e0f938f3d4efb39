"""How long one step of the sequential adjustment takes, early and late along a traverse."""

import numpy as np
import pytest

from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.sequential import begin, extend
from photogrammetry.adjustment.smoothing import smoothed
from photogrammetry.synthetic.networks import simulate_network

PARAMS = AdjustmentParams()
RECENT = 10


def after(stops):
    """A traverse of so many stops but one, with the network of its next step."""
    network, _ = simulate_network(
        np.random.default_rng(1), stops=stops, inter_ties=100, intra_ties=180
    )
    traverse = None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[max(0, k - RECENT) : k + 1]))
        if k == stops - 1:
            return traverse, part, stop
        traverse, _ = begin(part, PARAMS) if k == 0 else extend(traverse, part, [stop], PARAMS)
    raise AssertionError


@pytest.mark.parametrize("stops", [10, 60])
def test_adding_a_stop_sequentially(benchmark, stops):
    traverse, part, stop = after(stops)
    _, report = benchmark.pedantic(extend, (traverse, part, [stop], PARAMS), rounds=3)
    assert report.is_usable
    assert len(traverse.departures) == stops - 1 - PARAMS.window_stops


def test_carrying_back_along_sixty_stops(benchmark):
    traverse, part, stop = after(60)
    traverse, _ = extend(traverse, part, [stop], PARAMS)
    back = benchmark.pedantic(smoothed, (traverse, part, PARAMS), rounds=3)
    assert len(back.stops) == 60
