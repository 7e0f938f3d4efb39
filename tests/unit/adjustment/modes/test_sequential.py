"""Stop after stop, and yet the simultaneous solution."""

import json
from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.collinearity import State
from solmap.photogrammetry.adjustment.model.small_matrices import rotation_of_vector
from solmap.photogrammetry.adjustment.modes.overall import adjust, adjust_overall
from solmap.photogrammetry.adjustment.modes.sequential import (
    _part,
    adjust_sequential,
    begin,
    extend,
)
from solmap.photogrammetry.adjustment.solver.marginal import Chart, Marginal
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.synthetic.networks import simulate_network
from solmap.products.formats.documents.adjusted_network import (
    network_document,
    network_of_document,
)

SMALL = {"pairs_per_stop": 6, "inter_ties": 8, "intra_ties": 2}


def along(network, params, count=None):
    """A traverse after its stops were added one by one, and the last report."""
    traverse = None
    for k, stop in enumerate(network.stop_ids[:count]):
        part = network.within(set(network.stop_ids[max(0, k - 12) : k + 1]))
        if traverse is None:
            traverse, report = begin(part, params)
        else:
            traverse, report = extend(traverse, part, [stop], params)
    return traverse, report


def in_sigmas(found, requested):
    """Greatest difference of poses in standard deviations, and relative one of those."""
    off, wider = [], []
    for a, b in zip(found, requested, strict=True):
        if not b.covariance.any():
            continue
        turn = a.lsl_from_rover.rotation @ b.lsl_from_rover.rotation.T - np.eye(3)
        moved = a.lsl_from_rover.translation_m - b.lsl_from_rover.translation_m
        e = np.array([turn[2, 1], turn[0, 2], turn[1, 0], *moved])
        sigma = np.sqrt(np.diagonal(b.covariance))
        off.append(np.abs(e / sigma).max())
        scale = np.outer(sigma, sigma)
        wider.append(np.abs((a.covariance - b.covariance) / scale).max())
    return max(off), max(wider)


@pytest.fixture(scope="module")
def network():
    return simulate_network(np.random.default_rng(1), stops=11, **SMALL)[0]


@pytest.fixture(scope="module")
def state():
    rng = np.random.default_rng(4)
    return State(
        rotation_of_vector(rng.normal(0, 1, (4, 3))), rng.normal(0, 20, (4, 3)),
        rng.normal(0, 0.01, (5, 3)), np.zeros((0, 3)),
    )  # fmt: skip


def shifted(state, x, stops, pairs):
    """The state after corrections in the LSL of some stops and pairs."""
    rotations, centres = state.rotations.copy(), state.centres.copy()
    pointings = state.pointings.copy()
    pose = x[: 6 * len(stops)].reshape(-1, 6)
    rotations[stops] = rotation_of_vector(pose[:, :3]) @ rotations[stops]
    centres[stops] += pose[:, 3:]
    pointings[pairs] += x[6 * len(stops) :].reshape(-1, 3)
    return State(rotations, centres, pointings, state.points)


def test_derivatives_of_the_coordinates_agree_with_differences(state):
    stops, pairs = np.array([0, 1, 3]), np.array([1, 4])
    chart = Chart.at(state, stops, pairs)
    rng = np.random.default_rng(5)
    here = shifted(state, rng.normal(0, 0.2, chart.size), stops, pairs)  # not where it was made
    J, h = np.eye(chart.size), 1e-6
    J[:18, :18] = chart.pose_partials(here, chart.coordinates(here))
    for k in range(chart.size):
        x = np.zeros(chart.size)
        x[k] = h
        there, back = shifted(here, x, stops, pairs), shifted(here, -x, stops, pairs)
        slope = (chart.coordinates(there) - chart.coordinates(back)) / (2 * h)
        np.testing.assert_allclose(J[:, k], slope, atol=1e-7)  # h^2 times third derivatives of 20 m


def test_a_common_motion_changes_only_the_anchor(state):
    stops = np.arange(4)
    chart = Chart.at(state, stops, np.arange(0))
    turn, shift = rotation_of_vector(np.array([0.1, -0.4, 1.0])), np.array([3.0, -8.0, 1.0])
    moved = State(
        turn @ state.rotations, state.centres @ turn.T + shift, state.pointings, state.points
    )
    np.testing.assert_allclose(chart.coordinates(moved)[:18], 0.0, atol=1e-12)


def test_information_of_marginalised_stops_is_kept_exactly(network, stated):
    """Linearised where the overall adjustment ended, the window alone gives what that gave.

    Iterated to the end: covariances are those where the last step but one led.
    """
    stated = replace(stated, tolerance=1e-12)
    overall, report = adjust_overall(network, stated)
    window, _ = begin(network, stated)
    assert window.memory.window == network.stop_ids[-stated.window_stops :]
    part = _part(network, window.window, ())
    inherited = Marginal.of(window.memory, part)
    again, alone = adjust(part, frozenset(), stated, window, inherited=inherited)
    assert report.is_usable
    assert alone.redundancy == report.redundancy
    off, wider = in_sigmas(again.stops, overall.stops[-stated.window_stops :])
    assert off < 1e-4  # remainder of the last step: 1e-10 in squared standard deviations
    assert wider < 1e-7
    for pair in again.pairs:
        whole = overall.pair(pair.pair_id)
        sigma = np.sqrt(np.diagonal(whole.pointing_covariance))
        assert (np.abs(pair.pointing - whole.pointing) < 1e-4 * sigma).all()
        np.testing.assert_allclose(
            pair.pointing_covariance, whole.pointing_covariance, rtol=1e-5,
            atol=1e-7 * sigma.max() ** 2,
        )  # fmt: skip


def test_sequential_adjustment_of_the_last_stop_equals_simultaneous(network, stated):
    traverse, report = along(network, stated)
    overall, together = adjust_overall(network, stated)
    assert report.redundancy == together.redundancy
    assert report.sigma0 == pytest.approx(together.sigma0, rel=1e-4)
    off, wider = in_sigmas(traverse.stops, overall.stops[-len(traverse.stops) :])
    assert off < 0.01  # linearised where stops left: second order in the corrections since
    assert wider < 0.01


def test_sequential_adjustment_has_the_stepwise_interface_and_is_stored_as_a_document(
    network, params
):
    previous = None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[: k + 1]))
        previous, report = adjust_sequential(previous, part, [stop], params)
        previous = network_of_document(json.loads(json.dumps(network_document(previous))))
    traverse, other = along(network, params)
    assert report.sigma0 == pytest.approx(other.sigma0, rel=1e-12)
    for stop in traverse.stops:
        np.testing.assert_array_equal(
            previous.stop(stop.stop).lsl_from_rover.translation_m,
            stop.lsl_from_rover.translation_m,
        )
    assert [stop.stop for stop in previous.stops] == list(network.stop_ids)
    assert np.isfinite(previous.ties.points).all()
    assert all(stop.is_tied for stop in previous.stops)
    assert any("the marginal of earlier stops" in stop.held_by for stop in previous.stops[-7:])


def test_a_loop_reopens_the_traverse(params):
    network, _ = simulate_network(np.random.default_rng(2), stops=12, loop=True, **SMALL)
    previous = None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[: k + 1]))
        previous, report = adjust_sequential(previous, part, [stop], params)
    assert report.name.startswith("re-opened")
    overall, together = adjust_overall(network, params)
    assert abs(report.redundancy - together.redundancy) <= 6  # a tie at the critical value or two
    assert in_sigmas(previous.stops, overall.stops)[0] < 1.0


def test_a_loop_without_its_earlier_pairs_stays_open_and_is_reported(params):
    network, _ = simulate_network(np.random.default_rng(2), stops=12, loop=True, **SMALL)
    previous = None
    for k, stop in enumerate(network.stop_ids):
        recent = set(network.stop_ids[max(0, k - 9) : k + 1]) | (
            {network.stop_ids[0]} if k > 10 else set()
        )
        part = replace(network.within(recent), stops=network.stops[: k + 1])
        previous, report = adjust_sequential(previous, part, [stop], params)
    assert "reach back beyond the window" in report.message
    assert len(previous.stops) == 12


def test_a_missing_stop_of_the_window_is_named(network, params):
    traverse, _ = along(network, params, 10)
    lost = network.within(set(network.stop_ids[-3:]))
    with pytest.raises(AdjustmentError, match=r"contains test-site.*pass all stops"):
        extend(traverse, lost, network.stop_ids[-1:], params)


def test_an_adjustment_that_has_not_converged_marginalises_nothing(network, params):
    traverse, _ = along(network, params, 10)
    hasty = replace(params, max_iterations=1, tolerance=1e-30, max_rounds=1)
    after, report = extend(traverse, network, network.stop_ids[10:], hasty)
    assert not report.converged
    assert after.memory is traverse.memory


def test_a_traverse_keeps_only_its_window(network, params):
    traverse, _ = along(network, params)
    assert traverse.window == network.stop_ids[-params.window_stops :]
    assert len(traverse.stops) == params.window_stops + 1  # one left after the last step


def test_a_gap_of_several_drives_without_ties_is_passed(stated):
    """On both sides of it stops leave with nothing that others have seen."""
    network, _ = simulate_network(
        np.random.default_rng(3), stops=11, untied={4, 5, 6}, cross_ties=8, **SMALL
    )
    traverse, report = along(network, stated)
    overall, _ = adjust_overall(network, stated)
    assert report.converged
    now = traverse.stop(network.stop_ids[-1])
    off, wider = in_sigmas([now], [overall.stop(network.stop_ids[-1])])
    assert off < 0.05
    assert wider < 0.05
