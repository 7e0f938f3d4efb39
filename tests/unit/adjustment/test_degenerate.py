"""Networks that determine less than they should: telemetry takes over, and says so."""

from dataclasses import replace

import numpy as np
import pytest

from photogrammetry.adjustment.adjust import adjust_overall, telemetry_network
from photogrammetry.adjustment.params import AdjustmentParams
from photogrammetry.adjustment.records import select
from photogrammetry.synthetic.networks import simulate_network


def stops_of(network):
    """Stop number of every observation."""
    numbers = {stop: k for k, stop in enumerate(network.stop_ids)}
    of_pair = {pair.pair_id: numbers[pair.stop] for pair in network.pairs}
    return np.array([of_pair[name] for name in network.ties.pair_ids])[network.ties.pair]


def cross_points(network, a, b):
    """Points that two stops see."""
    stop, point = stops_of(network), network.ties.point
    return np.intersect1d(point[stop == a], point[stop == b])


def with_cross_points(network, stop, kept):
    """The network in which `stop` shares no points with others but `kept`."""
    of, point = stops_of(network), network.ties.point
    shared = np.intersect1d(point[of == stop], point[of != stop])
    lost = (of == stop) & np.isin(point, np.setdiff1d(shared, kept))
    return replace(network, ties=select(network.ties, ~lost))


@pytest.fixture
def network():
    return simulate_network(
        np.random.default_rng(21), stops=3, far_cross_ties=0, inter_ties=10, intra_ties=2
    )[0]


def test_a_stop_tied_only_to_a_blunder_is_held_by_telemetry(network, params):
    (kept,) = cross_points(network, 1, 2)[:1]
    network = with_cross_points(network, 2, [kept])
    parallax = network.ties.parallax_px.copy()
    rows = (stops_of(network) == 2) & (network.ties.point == kept)
    parallax[rows] *= 0.25  # four times too far: ten times what the drive may be wrong by
    network = replace(network, ties=replace(network.ties, parallax_px=parallax))
    adjusted, report = adjust_overall(network, params)
    assert report.blunders >= 1
    assert report.untied == (network.stop_ids[2],)
    assert adjusted.stops[2].held_by.startswith("telemetry increment from")


def test_collinear_ties_leave_the_turn_about_their_line_to_telemetry(network, params):
    """Two ties make a line: the turn about it is known only as well as gravity tells."""
    few = with_cross_points(network, 2, cross_points(network, 1, 2)[:2])
    loose, _ = adjust_overall(few, params)
    tight, _ = adjust_overall(network, params)
    worst = [np.linalg.eigvalsh(n.stops[2].covariance[:3, :3])[-1] for n in (loose, tight)]
    assert worst[0] > 4 * worst[1]
    assert np.degrees(np.sqrt(worst[0])) < 2 * params.azimuth_step_deg


def test_stops_tied_among_themselves_but_not_to_the_datum_are_named(params):
    network, _ = simulate_network(
        np.random.default_rng(22), stops=4, far_cross_ties=0, inter_ties=10, intra_ties=2
    )
    of, point = stops_of(network), network.ties.point
    across = np.intersect1d(point[of <= 1], point[of >= 2])
    network = replace(network, ties=select(network.ties, ~(np.isin(point, across) & (of >= 2))))
    adjusted, report = adjust_overall(network, params)
    assert report.untied == network.stop_ids[2:]
    assert "ties do not reach the datum" in adjusted.stops[2].held_by
    # what they know of each other is better than what telemetry knows of either
    apart = adjusted.stops[3].sigma_ned_m - adjusted.stops[2].sigma_ned_m
    assert np.linalg.norm(apart) < 1.5


def test_two_stops_at_one_place_are_no_trouble(network, params):
    here = network.stops[1]
    again = replace(
        here,
        stop=replace(here.stop, drive=here.stop.drive + 5),
        lsl_from_rover=replace(
            here.lsl_from_rover, source=replace(here.stop, drive=here.stop.drive + 5).frame
        ),
    )
    both = replace(network, stops=(*network.stops[:2], again, *network.stops[2:]))
    adjusted, report = adjust_overall(both, params)
    assert report.converged
    apart = (
        adjusted.stops[2].lsl_from_rover.translation_m
        - adjusted.stops[1].lsl_from_rover.translation_m
    )
    assert np.linalg.norm(apart) < params.position_floor_m


def test_iterations_used_up_are_an_outcome_and_not_an_error(network):
    hasty = AdjustmentParams(max_iterations=1, tolerance=1e-30, max_rounds=1)
    adjusted, report = adjust_overall(network, hasty)
    assert not report.converged
    assert not report.is_usable
    assert "NOT CONVERGED" in str(report)
    assert "iterations used up" in report.message
    assert len(adjusted.stops) == 3


def test_the_telemetry_network_is_telemetry_with_its_uncertainty(network, params):
    told = telemetry_network(network, params)
    for stop, prior in zip(told.stops, network.stops, strict=True):
        np.testing.assert_allclose(
            stop.lsl_from_rover.translation_m, prior.lsl_from_rover.translation_m, atol=1e-9
        )
    assert told.stops[2].sigma_ned_m.min() > params.slip * 20.0
    assert len(told.ties.observations) == 0
