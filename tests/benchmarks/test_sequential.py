"""How long one step of the sequential adjustment takes, early and late along a traverse.

Ten pairs and 300 ties a stop, as in the network of 500 stops. The times are of processor time, with
BLAS on one thread (OPENBLAS_NUM_THREADS=1: matrices are small, and waiting threads count): all that
a step does; the same without its report (consistency, and tie points with their covariances), that
is from the ties to poses with their covariances, blunders, and what the next step needs; and of
that what follows the initial values.
"""

import time

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes import overall as adjust
from solmap.photogrammetry.adjustment.modes.sequential import begin, extend
from solmap.photogrammetry.adjustment.solver import results as result
from solmap.photogrammetry.adjustment.solver.marginalisation import (
    SolvedNetwork,
    coupling_of,
    marginalise,
)
from solmap.photogrammetry.synthetic.networks import simulate_network

PARAMS = AdjustmentParams()
RECENT = 10
ROUNDS = 10
EARLY_AND_LATE = (10, 60)


@pytest.fixture(scope="module")
def steps():
    """By number of stops: the traverse before the last step, its network, and the new stop."""
    network, _ = simulate_network(
        np.random.default_rng(1), stops=max(EARLY_AND_LATE), inter_ties=100, intra_ties=180
    )
    found, traverse = {}, None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[max(0, k - RECENT) : k + 1]))
        if k + 1 in EARLY_AND_LATE:
            found[k + 1] = (traverse, part, [stop], PARAMS)
        traverse, _ = begin(part, PARAMS) if k == 0 else extend(traverse, part, [stop], PARAMS)
    return found


def timed(benchmark, act):
    """Benchmark in processor time: other processes do not count."""
    benchmark.extra_info["clock"] = "process_time"
    benchmark._timer = time.process_time
    return benchmark.pedantic(act, rounds=ROUNDS, warmup_rounds=2)


@pytest.mark.parametrize("stops", EARLY_AND_LATE)
def test_adding_a_stop_sequentially(benchmark, steps, stops):
    traverse, report = timed(benchmark, lambda: extend(*steps[stops]))
    assert report.is_usable
    assert len(traverse.window) == PARAMS.window_stops


@pytest.mark.parametrize("stops", EARLY_AND_LATE)
def test_a_step_without_its_report(benchmark, steps, stops, monkeypatch):
    spent = [0.0]
    for owner, name in (
        (adjust, "_agreement"),
        (result, "_ties"),
        (result.Outcome, "with_all_points"),
    ):
        monkeypatch.setattr(owner, name, counted(getattr(owner, name), spent))
    benchmark.extra_info["clock"] = "process_time without the report's"
    benchmark._timer = lambda: time.process_time() - spent[0]
    args = (lambda: extend(*steps[stops]),)
    _, report = benchmark.pedantic(*args, rounds=ROUNDS, warmup_rounds=2)
    assert report.is_usable


def counted(act, spent):
    """The same function, its processor time added up."""

    def timed_act(*args):
        begun = time.process_time()
        try:
            return act(*args)
        finally:
            spent[0] += time.process_time() - begun

    return timed_act


@pytest.mark.parametrize("stops", EARLY_AND_LATE)
def test_adding_and_marginalising_without_the_report(benchmark, steps, stops, monkeypatch):
    begun, whole = [], adjust.estimate
    monkeypatch.setattr(
        adjust, "estimate", lambda start, params: whole(begun.append(start) or start, params)
    )
    extend(*steps[stops])
    start = begun[-1]

    def act():
        outcome = whole(start, PARAMS)
        network = SolvedNetwork.of_outcome(outcome, np.ones(len(start.held), dtype=bool))
        return outcome, marginalise(network, coupling_of(network, 0))

    outcome, _ = timed(benchmark, act)
    assert outcome.solution.converged
