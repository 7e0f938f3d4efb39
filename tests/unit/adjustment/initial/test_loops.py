"""Loops are closed from telemetry that is far off."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.initial.alignment import RigidPoints, rigid_motion
from solmap.photogrammetry.adjustment.initial.loops import Edges, relax
from solmap.photogrammetry.adjustment.model.collinearity import State
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import (
    move_along_arcs,
    rotation_of_vector,
)
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.synthetic.networks import TelemetryErrors, simulate_network


def circle(count, radius_m=60.0):
    """True poses of stops on a circle, closed."""
    angle = 2 * np.pi * np.arange(count) / count
    turns = rotation_of_vector(np.column_stack([np.zeros((count, 2)), angle]))
    centres = radius_m * np.column_stack([np.sin(angle), 1 - np.cos(angle), 0.0 * angle])
    return State(turns, centres, np.zeros((0, 3)), np.zeros((0, 3)))


def edges_of(state, couples, *, loops):
    """Exact edges between some stops, good to a centimetre and a milliradian."""
    a, b = np.array(couples).T
    to_a = state.rotations[a].swapaxes(1, 2)
    apart = (to_a @ (state.centres[b] - state.centres[a])[:, :, None])[:, :, 0]
    N = np.diag([1e6, 1e6, 1e6, 1e4, 1e4, 1e4])
    return Edges(a, b, to_a @ state.rotations[b], apart, np.repeat(N[None], len(a), axis=0), loops)


def drifted(state, turn_rad):
    """The same drives, each with a turn of the azimuth too much."""
    count = len(state.centres)
    turns = rotation_of_vector(np.column_stack([np.zeros((count, 2)), turn_rad * np.arange(count)]))
    drives = np.diff(state.centres, axis=0)
    moved = (turns[:-1] @ drives[:, :, None])[:, :, 0]
    centres = np.vstack([np.zeros((1, 3)), np.cumsum(moved, axis=0)])
    return State(turns @ state.rotations, centres, state.pointings, state.points)


def loose(count):
    """Telemetry with large standard deviations, except for the tilt."""
    network, _ = simulate_network(np.random.default_rng(1), stops=2, inter_ties=1, intra_ties=0)
    weak = AdjustmentParams(slip=100.0, azimuth_step_deg=90.0)
    reported = Telemetry.of(network, weak).of_stops(np.ones(count, dtype=np.int64))
    return replace(
        reported,
        rotations=np.repeat(np.eye(3)[None], count, axis=0),
        centres=np.zeros((count, 3)),
    )


@pytest.mark.parametrize("turn_deg", [0.2, 1.5])
def test_a_loop_that_telemetry_leaves_open_is_closed(turn_deg):
    count = 40
    true, held = circle(count), np.arange(count) == 0
    start = drifted(true, np.radians(turn_deg))
    assert np.linalg.norm(start.centres - true.centres, axis=1).max() > 1.0
    chain = [(k, k + 1) for k in range(count - 1)]
    # the chain fits itself; two loops contradict it
    along = edges_of(start, chain, loops=np.zeros(len(chain), dtype=bool))
    closing = edges_of(true, [(0, count - 1), (1, count - 1)], loops=np.ones(2, dtype=bool))
    along = replace(along, information=0.01 * along.information)
    names = ("a", "b", "rotation", "translation", "information", "is_loop")
    both = Edges(*(np.concatenate([getattr(along, n), getattr(closing, n)]) for n in names))
    state, weights = relax(start, loose(count), held, both)
    assert (weights == 1.0).all()
    apart = state.rotations[0].T @ (state.centres[-1] - state.centres[0])
    np.testing.assert_allclose(apart, closing.translation[0], atol=0.05)
    gone = np.linalg.norm(start.centres - true.centres, axis=1).max()
    assert np.linalg.norm(state.centres - true.centres, axis=1).max() < 0.5 * gone


def test_a_loop_that_contradicts_the_others_gets_less_weight():
    count = 30
    true, held = circle(count), np.arange(count) == 0
    chain = [(k, k + 1) for k in range(count - 1)]
    couples = [*chain, (0, count - 1), (1, count - 1), (3, 20)]
    loops = np.array([b - a > 1 for a, b in couples])
    edges = edges_of(true, couples, loops=loops)
    edges.translation[-1] += [5.0, -3.0, 0.0]
    state, weights = relax(true, loose(count), held, edges)
    assert weights[-1] == 0.0
    assert (weights[:-1] == 1.0).all()
    np.testing.assert_allclose(state.centres, true.centres, atol=1e-3)  # an initial value


def test_a_rigid_motion_is_found_without_a_start_although_a_third_of_the_ties_are_wrong():
    rng = np.random.default_rng(3)
    Y = rng.uniform(-15, 15, (30, 3)) * [1, 1, 0.1]
    R, t = rotation_of_vector(np.array([0.05, -0.02, 2.5])), np.array([30.0, -12.0, 0.5])
    X = Y @ R.T + t + rng.normal(0, 0.05, Y.shape)
    X[:10] += rng.normal(0, 6.0, (10, 3))
    S = np.repeat(np.eye(3)[None] * 0.05**2 / 2, 30, axis=0)
    rotation, place, N, weights = rigid_motion(RigidPoints(X, S, Y, S), 4.0)
    assert (weights[:10] == 0).all()
    assert (weights[10:] == 1).sum() >= 19
    sigma = np.sqrt(np.diagonal(np.linalg.inv(N)))
    assert (np.abs(place - t) < 5 * sigma[3:]).all()
    assert np.abs(rotation - R).max() < 5 * sigma[:3].max()


def test_drives_turn_along_arcs_and_held_stops_stay():
    centres = np.column_stack([np.arange(4) * 10.0, np.zeros((4, 2))])
    quarter = np.tile([0.0, 0.0, np.pi / 2], (4, 1))
    shift = np.cross(quarter, centres)  # the tangent of a turn about the first stop
    moved = move_along_arcs(centres, quarter, shift, np.array([True, False, False, False]))
    np.testing.assert_allclose(moved, centres[:, [1, 0, 2]], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("slip", "blunders"), [(0.01, 0.0), (0.2, 0.1)])
def test_laps_converge_from_telemetry(slip, blunders):
    params = AdjustmentParams(slip=slip)
    network, truth = simulate_network(
        np.random.default_rng(1), stops=60, laps=2, loop=True, pairs_per_stop=6, cross_ties=7,
        far_cross_ties=0, inter_ties=6, intra_ties=0, blunders=blunders,
        errors=TelemetryErrors.assumed_by(params),
    )  # fmt: skip
    reported = np.array([stop.lsl_from_rover.translation_m for stop in network.stops])
    true = np.array([pose.translation_m for pose in truth.lsl_from_rover])
    adjusted, report = adjust_overall(network, params)
    found = np.array([stop.lsl_from_rover.translation_m for stop in adjusted.stops])
    assert report.is_usable
    assert (
        np.linalg.norm(found - true, axis=1).max()
        < 0.02 * np.linalg.norm(reported - true, axis=1).max()
    )
    sigma = np.array([stop.sigma_ned_m for stop in adjusted.stops[1:]])
    assert (np.abs(found[1:] - true[1:]) / sigma).max() < 4.0
