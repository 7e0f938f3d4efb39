"""A bar bent by a known amount is straightened, and what cannot be seen is not claimed."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.network import Network
from solmap.photogrammetry.adjustment.model.small_matrices import rotation_of_vector
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.quality.rig import (
    RigParams,
    calibrate_rig,
    parallax_partials,
    with_rig,
)
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.synthetic.networks import NetworkTruth, TelemetryErrors, simulate_network

BENT = np.radians([0.02, 0.05, -0.03])
LONGER_M = 0.001


def in_pairs(network: Network, truth: NetworkTruth) -> np.ndarray:
    """Every observed point in the frame of its pair, as it truly stood."""
    stops = dict(zip(network.stop_ids, truth.lsl_from_rover, strict=True))
    found = np.zeros((len(network.ties), 3))
    for k, pair in enumerate(network.pairs):
        rows = np.flatnonzero(network.ties.pair == network.ties.pair_ids.index(pair.pair_id))
        label, pivot = pair.geometry.rover_from_pair, pair.pivot_in_rover
        turn = rotation_of_vector(truth.pointings[k])
        in_rover = stops[pair.stop].inverse.apply(truth.points[network.ties.point[rows]])
        origin = pivot + turn @ (label.translation_m - pivot)
        found[rows] = (in_rover - origin) @ (turn @ label.rotation)
    return found


def with_bent_bar(network: Network, truth: NetworkTruth, turn, longer_m) -> Network:
    """The network as a bent bar sees it: exact projection into the turned right camera."""
    y = in_pairs(network, truth)
    shape = network.pairs[0].geometry
    straight = y - [shape.base_m, 0.0, 0.0]
    bent = (y - [shape.base_m + longer_m, 0.0, 0.0]) @ rotation_of_vector(np.array(turn))
    moved = shape.focal_px * (bent[:, 0] / bent[:, 2] - straight[:, 0] / straight[:, 2])
    ties = network.ties
    return replace(network, ties=replace(ties, parallax_px=ties.parallax_px - moved))


def test_partials_are_those_of_exact_projection():
    network, truth = simulate_network(np.random.default_rng(3), stops=2, noise=0.0)
    A = parallax_partials(network)
    for k in range(4):
        step = np.zeros(4)
        step[k] = 1e-6
        ahead = with_bent_bar(network, truth, step[:3], step[3]).ties.parallax_px
        behind = with_bent_bar(network, truth, -step[:3], -step[3]).ties.parallax_px
        np.testing.assert_allclose((ahead - behind) / 2e-6, A[:, k], atol=2e-3)  # of 1e3 px


@pytest.mark.slow
def test_a_bent_bar_is_recovered_where_telemetry_gives_the_scale(params):
    sharp = replace(params, slip=0.001, position_floor_m=0.005)
    network, truth = simulate_network(
        np.random.default_rng(6), stops=6, inter_ties=60, cross_ties=40, far_cross_ties=20,
        errors=TelemetryErrors.assumed_by(sharp),
    )  # fmt: skip
    bent = with_bent_bar(network, truth, BENT, LONGER_M)
    instruments = {pair.pair_id: "NAVCAM" for pair in network.pairs}
    (found,) = calibrate_rig(bent, {bent.stop_ids[0]}, instruments, sharp, RigParams())
    sigma = np.sqrt(np.diagonal(found.covariance))
    off = np.append(found.turn - BENT, found.base_m - LONGER_M)
    assert (np.abs(off) < 4 * sigma).all(), (off, sigma)
    assert np.degrees(sigma[1]) < 0.005  # a tenth of the bend
    assert sigma[3] < 0.0005
    straight, report = adjust_overall(with_rig(bent, instruments, (found,)), sharp)
    _, as_bent = adjust_overall(bent, sharp)
    assert report.sigma0 == pytest.approx(1.0, abs=0.05)
    assert as_bent.sigma0 > 1.3 * report.sigma0  # a bent bar is a misfit of all, not many blunders
    assert as_bent.blunders < 0.05 * len(bent.ties)
    places = np.array([s.lsl_from_rover.translation_m for s in straight.stops])
    true = np.array([pose.translation_m for pose in truth.lsl_from_rover])
    assert np.linalg.norm(places - true, axis=1).max() < 0.3


@pytest.mark.slow
def test_a_straight_bar_stays_straight_and_its_unseen_length_stays_at_the_prior(params):
    network, _ = simulate_network(np.random.default_rng(8), stops=3, inter_ties=40)
    instruments = {pair.pair_id: "NAVCAM" for pair in network.pairs}
    (found,) = calibrate_rig(network, {network.stop_ids[0]}, instruments, params, RigParams())
    sigma = np.sqrt(np.diagonal(found.covariance))
    assert (np.abs(np.append(found.turn, found.base_m)) < 4 * sigma).all()
    # wheels slip by 10 per cent: two drives say little of a length of half a per cent
    assert 0.8 * RigParams().base_m < sigma[3] <= RigParams().base_m


def test_a_rig_without_uncertainty_is_refused():
    with pytest.raises(AdjustmentError, match="leave the rig correction out"):
        RigParams(turn_deg=0.0)
