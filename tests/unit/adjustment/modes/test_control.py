"""Places of stops in orbital images whose own place is an unknown of the network."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from solmap.photogrammetry.adjustment.model.collinearity import State
from solmap.photogrammetry.adjustment.model.control_equations import Control
from solmap.photogrammetry.adjustment.model.datum import with_control
from solmap.photogrammetry.adjustment.model.network import (
    MAP,
    ControlFrame,
    Network,
    StopControl,
    select,
)
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode, AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import rotation_of_vector
from solmap.photogrammetry.adjustment.modes.mission import advance
from solmap.photogrammetry.adjustment.modes.overall import adjust, adjust_overall
from solmap.photogrammetry.adjustment.modes.sequential import _part, adjust_sequential, begin
from solmap.photogrammetry.adjustment.solver.marginal import Marginal
from solmap.photogrammetry.arrays import Vector3
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.synthetic.mission import simulate_control
from solmap.photogrammetry.synthetic.networks import (
    TelemetryErrors,
    simulate_network,
)
from solmap.products.formats.documents.adjusted_network import (
    network_document,
    network_of_document,
)

SMALL = {"pairs_per_stop": 5, "inter_ties": 8, "intra_ties": 0}
PARAMS = AdjustmentParams(window_stops=2)
STATED = replace(PARAMS, sigma_freedoms=np.inf)
GAP = 3
"""The stop that no image ties to those before it."""


def simulated(seed, *, stops=8, shown=(0, 2, 4, 5, 7), gap=0, **control):
    """A network with control, its truth, and the control with its truth."""
    rng = np.random.default_rng(seed)
    network, truth = simulate_network(rng, stops=stops, **SMALL)
    network = with_first_attitude_unsure(rng, network)
    if gap:
        network = without_ties_across(network, gap)
    orbit = simulate_control(rng, network, truth, shown, **control)
    return with_control(network, [orbit.frame], orbit.control, PARAMS), truth, orbit


def without_ties_across(network, gap):
    """The network without tie points that stops before and after the gap share."""
    order = {stop: k for k, stop in enumerate(network.stop_ids)}
    after = np.array([order[pair.stop] >= gap for pair in network.pairs])[network.ties.pair]
    seen = np.zeros((2, network.ties.point.max() + 1), dtype=bool)
    seen[0, network.ties.point[~after]] = True
    seen[1, network.ties.point[after]] = True
    return replace(network, ties=select(network.ties, ~seen.all(axis=0)[network.ties.point]))


def errors(adjusted, truth):
    """Errors (stops, 6) of rotation and place."""
    found = []
    for stop, true in zip(adjusted.stops, truth.lsl_from_rover, strict=True):
        pose = stop.lsl_from_rover
        turn = pose.rotation @ true.rotation.T
        vector = np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
        found.append([*vector / 2, *(pose.translation_m - true.translation_m)])
    return np.array(found)


def test_derivatives_agree_with_differences():
    network, _, _ = simulated(1, shown=(1, 2), sigma_up_m=0.3, sigma_azimuth_deg=0.5)
    control = Control.of(network)
    rng = np.random.default_rng(2)
    n = len(network.stops)
    state = State(
        rotation_of_vector(rng.normal(0, 0.5, (n, 3))), rng.normal(0, 20, (n, 3)),
        np.zeros((0, 3)), np.zeros((0, 3)), rng.normal(0, 0.1, (2, 5)),
    )  # fmt: skip
    of_stop, of_frame = control.partials(state)
    h = 1e-6
    for c in range(11):
        both = []
        for sign in (1, -1):
            turn, shift, dp = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((2, 5))
            if c < 3:
                turn[:, c] = sign * h
            elif c < 6:
                shift[:, c - 3] = sign * h
            else:
                dp[:, c - 6] = sign * h
            moved = replace(
                state, rotations=rotation_of_vector(turn) @ state.rotations,
                centres=state.centres + shift, frames=state.frames + dp,
            )  # fmt: skip
            both.append(-control.whitened_misclosures(moved))  # computed minus observed
        slope = (both[0] - both[1]) / (2 * h)
        requested = of_stop[:, :, c] if c < 6 else of_frame[:, :, c - 6]
        np.testing.assert_allclose(slope, requested, rtol=1e-6, atol=1e-4)


def test_the_georeference_of_the_image_is_estimated_with_the_stops():
    network, truth, orbit = simulated(4)
    adjusted, report = adjust_overall(network, PARAMS)
    assert report.converged
    assert report.control == 5
    assert not report.control_refused
    (found,) = (frame for frame in adjusted.frames if frame.frame.name == "orbit")
    off = (found.place - orbit.place)[[0, 1, 3, 4]]  # no heights were seen
    C = found.covariance[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])]
    assert off @ np.linalg.solve(C, off) < chi2.ppf(0.999, 4)
    assert found.covariance[2, 2] == pytest.approx(orbit.frame.covariance[2, 2], rel=1e-6)
    e = errors(adjusted, truth)
    for k, stop in enumerate(adjusted.stops):
        assert e[k] @ np.linalg.solve(stop.covariance, e[k]) < chi2.ppf(0.9999, 6)


def test_with_control_the_first_stop_keeps_its_position_and_its_azimuth_is_free():
    """Its telemetry is turned by degrees; held, it would turn the traverse with it."""
    network, truth, _ = simulated(4, sigma_m=0.02)
    frame = ControlFrame.from_sigmas("orbit", (0.0, 0.0), rotation_deg=0.02)
    rng = np.random.default_rng(4)
    orbit = simulate_control(rng, network, truth, range(8), frame=frame, sigma_m=0.02)
    network = replace(network, control=(), frames=())
    controlled = with_control(network, [frame], orbit.control, PARAMS)
    held, _ = adjust_overall(network, PARAMS)
    free, _ = adjust_overall(controlled, PARAMS)
    place = network.stops[0].lsl_from_rover.translation_m
    np.testing.assert_allclose(free.stops[0].lsl_from_rover.translation_m, place, atol=2e-3)
    turned = np.degrees(np.abs(errors(held, truth)[-1, 2]))
    assert turned > 1.0
    assert np.degrees(np.abs(errors(free, truth)[-1, 2])) < 0.17  # two standard deviations
    assert not free.stops[0].held
    assert free.stops[0].held_by.startswith("datum by its position")


def test_a_gap_without_ties_is_bridged_by_control_on_both_sides():
    network, truth, _ = simulated(6, shown=(0, 1, 2, 3, 5, 7), gap=GAP, sigma_azimuth_deg=0.3)
    bare = replace(network, control=network.control[:1], frames=(MAP,))
    alone, without = adjust_overall(bare, PARAMS)
    adjusted, report = adjust_overall(network, PARAMS)
    assert set(without.untied) == set(network.stop_ids[GAP:])
    assert not report.untied
    apart = [
        np.linalg.norm(errors(one, truth)[GAP, 3:5] - errors(one, truth)[GAP - 1, 3:5])
        for one in (alone, adjusted)
    ]
    assert apart[1] < 0.3  # precision of the image on either side: 0.1 m per coordinate
    assert apart[0] > 2 * apart[1]
    sigma = [one.stops[GAP].sigma_ned_m[:2].max() for one in (alone, adjusted)]
    assert sigma[1] < 0.5 * sigma[0]
    assert "control: its position in orbit" in adjusted.stops[GAP].held_by
    reported = {finding.stop: finding.text for finding in report.findings}
    assert "control" in reported[network.stop_ids[GAP]]


def test_a_wrong_control_point_is_found_named_and_not_used():
    network, truth, orbit = simulated(7, shown=(0, 2, 3, 5, 6, 7))
    wrong = orbit.control[3]
    bent = tuple(
        replace(one, north_m=one.north_m + 2.0) if one.is_same(wrong) else one
        for one in network.control
    )
    without = tuple(one for one in network.control if not one.is_same(wrong))
    adjusted, report = adjust_overall(replace(network, control=bent), PARAMS)
    requested, _ = adjust_overall(replace(network, control=without), PARAMS)
    (refused,) = report.control_refused
    assert refused.startswith(f"{wrong.stop} in orbit")
    (found,) = (one for one in adjusted.control if not one.used)
    assert found.residual[1] == pytest.approx(2.0, abs=0.5)  # noise, and the image that turns
    assert f"REFUSED: {wrong.stop}" in str(report)
    np.testing.assert_allclose(errors(adjusted, truth), errors(requested, truth), atol=1e-5)
    assert [one.control.stop for one in adjusted.control if not one.used] == [wrong.stop]


def test_two_contradicting_control_points_are_both_set_aside():
    """The image lies anywhere; each of its two places alone would fit."""
    network, _, orbit = simulated(8, shown=(2, 6))
    moved = replace(orbit.control[1], east_m=orbit.control[1].east_m + 30.0)
    far = ControlFrame.from_sigmas("orbit", orbit.frame.centre_m, shift_m=1e4, rotation_deg=0.1)
    network = replace(
        network,
        frames=(MAP, far),
        control=(*network.control[:1], orbit.control[0], moved),
    )
    _, report = adjust_overall(network, PARAMS)
    assert len(report.control_refused) == 2
    assert report.control == 0


def test_sequential_equals_simultaneous_adjustment_with_control():
    network, _, _ = simulated(1, stops=9, shown=(1, 3, 4, 6, 8), sigma_azimuth_deg=0.5)
    previous = None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[: k + 1]))
        previous, report = adjust_sequential(previous, part, [stop], STATED)
    overall, together = adjust_overall(network, STATED)
    assert report.redundancy == together.redundancy
    assert previous.memory.frames == ("orbit",)
    for a, b in zip(previous.stops[-2:], overall.stops[-2:], strict=True):
        sigma = np.sqrt(np.diagonal(b.covariance))
        off = a.lsl_from_rover.translation_m - b.lsl_from_rover.translation_m
        assert (np.abs(off) / sigma[3:]).max() < 0.02
        # linearised where stops left, while the first azimuth was known to two degrees only
        np.testing.assert_allclose(np.sqrt(np.diagonal(a.covariance)), sigma, rtol=1e-2)
    found, requested = (
        next(frame for frame in one.frames if frame.frame.name == "orbit")
        for one in (previous, overall)
    )
    sigma = np.sqrt(np.diagonal(requested.covariance))
    assert (np.abs(found.place - requested.place) / sigma).max() < 0.02
    np.testing.assert_allclose(np.sqrt(np.diagonal(found.covariance)), sigma, rtol=1e-2)


def test_control_of_marginalised_stops_is_kept_exactly():
    network, _, _ = simulated(2, stops=7, shown=(0, 1, 3, 6), sigma_up_m=0.2)
    overall, _ = adjust_overall(network, STATED)
    window, _ = begin(network, STATED)
    part = _part(network, window.window, ())
    inherited = Marginal.of(window.memory, part)
    again, _ = adjust(part, frozenset(), STATED, window, inherited=inherited)
    assert len(again.stops) == 2
    for a, b in zip(again.stops, overall.stops[-2:], strict=True):
        sigma = np.sqrt(np.diagonal(b.covariance))
        off = a.lsl_from_rover.translation_m - b.lsl_from_rover.translation_m
        assert (np.abs(off) / sigma[3:]).max() < 1e-5
        scale = np.outer(sigma, sigma)
        assert (np.abs(a.covariance - b.covariance) / scale).max() < 1e-5


def test_later_control_reopens_the_traverse():
    network, _, _ = simulated(3, shown=(1, 2, 5))
    bare = replace(network, control=(), frames=())
    before = None
    for k, stop in enumerate(bare.stop_ids[:-1]):
        part = bare.within(set(bare.stop_ids[: k + 1]))
        before, _ = adjust_sequential(before, part, [stop], PARAMS)
    after, report = adjust_sequential(before, network, network.stop_ids[-1:], PARAMS)
    assert report.name.startswith("re-opened")
    overall, _ = adjust_overall(network, PARAMS)
    for a, b in zip(after.stops, overall.stops, strict=True):
        sigma = np.maximum(b.sigma_ned_m, 1e-4)
        off = a.lsl_from_rover.translation_m - b.lsl_from_rover.translation_m
        assert (np.abs(off) / sigma).max() < 0.02


def test_revoked_control_keeps_its_effect_on_marginalised_stops():
    network, _, _ = simulated(3, stops=6, shown=(0, 1, 2))
    before = None
    for k, stop in enumerate(network.stop_ids[:-1]):
        part = network.within(set(network.stop_ids[: k + 1]))
        before, _ = adjust_sequential(before, part, [stop], PARAMS)
    assert before.memory.frames == ("orbit",)
    bare = replace(network, control=(), frames=())
    recent = bare.within(set(network.stop_ids[-3:]))
    recent = replace(recent, stops=bare.stops)  # all stops, the pairs of the window alone
    after, report = adjust_sequential(before, recent, network.stop_ids[-1:], PARAMS)
    assert report.converged
    assert "control of marginalised stops is new or changed" in report.message
    assert "adjust overall" in report.message
    assert len(after.stops) == 6


def test_stepwise_adjustment_uses_control_for_new_stops():
    network, truth, _ = simulated(5, shown=range(8), gap=GAP, sigma_azimuth_deg=0.3)
    previous = None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[: k + 1]))
        previous, report = advance(AdjustmentMode.STEPWISE, previous, part, [stop], PARAMS)
        assert report.converged
    assert len(previous.control) == 9
    e = errors(previous, truth)
    for k, stop in enumerate(previous.stops):
        # stepwise holds what it should not: sigmas are true to a factor only
        assert e[k] @ np.linalg.solve(stop.covariance, e[k]) < 2 * chi2.ppf(0.9999, 6)


def test_a_network_with_control_is_read_back_bit_for_bit():
    network, _, _ = simulated(2, stops=5, shown=(0, 1, 3), sigma_azimuth_deg=0.5)
    adjusted = begin(network, PARAMS)[0]
    document = json.dumps(network_document(adjusted))
    back = network_of_document(json.loads(document))
    assert json.dumps(network_document(back)) == document
    assert back.memory.frames == ("orbit",)
    both = zip(back.control, adjusted.control, strict=True)
    assert [one.control.is_same(other.control) for one, other in both] == [True] * 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"covariance": np.eye(3)}, "gives 2 values, its covariance must be 2 x 2, not 3 x 3"),
        ({"covariance": -np.eye(2)}, "standard deviations above zero"),
        ({"covariance": np.array([[1.0, 0.5], [0.0, 1.0]])}, "symmetric"),
    ],
)
def test_control_without_a_usable_weight_is_refused(change, message):
    stop = simulate_network(np.random.default_rng(0), stops=1, **SMALL)[0].stop_ids[0]
    with pytest.raises(AdjustmentError, match=message):
        StopControl(**{"stop": stop, "frame": "orbit", "east_m": 1.0, "north_m": 2.0,
                       "covariance": np.eye(2), **change})  # fmt: skip


@pytest.mark.slow
def test_stated_sigmas_are_true_with_control_and_a_gap():
    """NEES of all stops of 60 networks, overall and stop by stop."""
    networks, sums = 60, np.zeros(2)
    last = np.zeros(2)
    for seed in range(networks):
        network, truth, _ = simulated(500 + seed, stops=6, shown=(0, 1, 3, 4, 5), gap=GAP)
        overall, _ = adjust_overall(network, PARAMS)
        step = None
        for k, stop in enumerate(network.stop_ids):
            part = network.within(set(network.stop_ids[: k + 1]))
            step, _ = adjust_sequential(step, part, [stop], PARAMS)
        for m, adjusted in enumerate((overall, step)):
            e = errors(adjusted, truth)
            each = [e[k] @ np.linalg.solve(s.covariance, e[k]) / 6
                    for k, s in enumerate(adjusted.stops) if k]  # fmt: skip
            sums[m] += np.mean(each)
            last[m] += each[-1]
    low, high = (chi2.ppf(q, 6 * networks) / (6 * networks) for q in (0.001, 0.999))
    assert low < last[0] / networks < high
    assert low < last[1] / networks < high
    assert 0.85 < sums[0] / networks < 1.15  # errors of neighbours belong together


def with_first_attitude_unsure(
    rng: np.random.Generator, network: Network, errors: TelemetryErrors | None = None
) -> Network:
    """The network with an error in the first attitude that telemetry reports.

    Its tilt alone; its azimuth with those of all stops up to the next that is measured (FINE),
    because they were propagated from it. What wheels measured stays.
    """
    errors = errors or TelemetryErrors()
    tilt = rng.normal(0, np.radians(errors.tilt_deg), 2)
    first = errors.azimuth_fine_deg if network.stops[0].is_fine else errors.azimuth_step_deg
    azimuth = rng.normal(0, np.radians(first))
    rotations = [stop.lsl_from_rover.rotation for stop in network.stops]
    turned = [_about_down(azimuth) @ rotation_of_vector(np.array([*tilt, 0.0])) @ rotations[0]]
    for stop, rotation in zip(network.stops[1:], rotations[1:], strict=True):
        azimuth = 0.0 if stop.is_fine else azimuth
        turned.append(_about_down(azimuth) @ rotation)
    places: list[Vector3] = [network.stops[0].lsl_from_rover.translation_m]
    for k in range(1, len(turned)):
        before, here = network.stops[k - 1].lsl_from_rover, network.stops[k].lsl_from_rover
        step = before.rotation.T @ (here.translation_m - before.translation_m)
        places.append(places[-1] + turned[k - 1] @ step)
    stops = tuple(
        replace(stop, lsl_from_rover=Pose(pose.target, pose.source, turned[k], places[k]))
        for k, (stop, pose) in enumerate((stop, stop.lsl_from_rover) for stop in network.stops)
    )
    return replace(network, stops=stops)


def _about_down(angle: float) -> np.ndarray:
    return rotation_of_vector(np.array([0.0, 0.0, angle]))
