"""A rig bent by a known amount is corrected, and what cannot be seen is not claimed."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.datum import with_control
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.modes.rig_calibration import (
    BASELINE_SIGMA_M,
    calibrate_rig,
    parallax_partials,
    with_corrected_rigs,
)
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.synthetic.mission import simulate_control
from solmap.photogrammetry.synthetic.networks import TelemetryErrors, simulate_network
from tests.support.adjustment.bent_rigs import with_bent_rig

BENT = np.radians([0.02, 0.05, -0.03])
LONGER_M = 0.001


def test_partials_are_those_of_exact_projection():
    network, truth = simulate_network(np.random.default_rng(3), stops=2, noise=0.0)
    A = parallax_partials(network)
    for k in range(4):
        step = np.zeros(4)
        step[k] = 1e-6
        ahead = with_bent_rig(network, truth, step[:3], step[3]).ties.parallax_px
        behind = with_bent_rig(network, truth, -step[:3], -step[3]).ties.parallax_px
        np.testing.assert_allclose((ahead - behind) / 2e-6, A[:, k], atol=2e-3)  # of 1e3 px


@pytest.mark.slow
def test_a_bent_rig_is_recovered_where_telemetry_gives_the_scale(params):
    sharp = replace(params, slip=0.001, position_floor_m=0.005, sigma_freedoms=np.inf)
    network, truth = simulate_network(
        np.random.default_rng(6), stops=6, inter_ties=60, cross_ties=40, far_cross_ties=20,
        errors=TelemetryErrors.assumed_by(sharp),
    )  # fmt: skip
    bent = with_bent_rig(network, truth, BENT, LONGER_M)
    instruments = {pair.pair_id: "NAVCAM" for pair in network.pairs}
    found = calibrate_rig(bent, {bent.stop_ids[0]}, instruments, sharp)
    (rig,) = found.corrections
    off = rig.values - np.append(BENT, LONGER_M)
    assert (np.abs(off) < 4 * rig.sigmas).all(), (off, rig.sigmas)
    assert np.degrees(rig.sigmas[1]) < 0.005  # a tenth of the bend
    assert rig.sigmas[3] < 0.0005
    straight, report = adjust_overall(
        with_corrected_rigs(bent, instruments, found.corrections), sharp
    )
    _, as_bent = adjust_overall(bent, sharp)
    assert report.sigma0 == pytest.approx(1.0, abs=0.05)
    assert as_bent.sigma0 > 1.3 * report.sigma0  # a bent rig is a misfit of all, not many blunders
    assert as_bent.blunders < 0.05 * len(bent.ties)
    assert found.as_labelled.sigma0 == pytest.approx(as_bent.sigma0, abs=1e-6)
    assert found.corrected.sigma0 == pytest.approx(report.sigma0, abs=0.01)
    places = np.array([s.lsl_from_rover.translation_m for s in straight.stops])
    true = np.array([pose.translation_m for pose in truth.lsl_from_rover])
    assert np.linalg.norm(places - true, axis=1).max() < 0.3


@pytest.mark.slow
def test_a_straight_rig_stays_straight_and_its_undetermined_length_stays_at_the_prior(params):
    network, _ = simulate_network(np.random.default_rng(8), stops=3, inter_ties=40)
    instruments = {pair.pair_id: "NAVCAM" for pair in network.pairs}
    (rig,) = calibrate_rig(network, {network.stop_ids[0]}, instruments, params).corrections
    assert (np.abs(rig.values) < 4 * rig.sigmas).all()
    # wheels slip by 10 per cent: two drives determine a length of half a per cent poorly
    assert 0.8 * BASELINE_SIGMA_M < rig.sigmas[3] <= BASELINE_SIGMA_M


@pytest.mark.slow
def test_noise_of_parallaxes_does_not_lengthen_the_baseline(params):
    off = []
    for seed in range(20, 32):
        network, _ = simulate_network(
            np.random.default_rng(seed), stops=2, inter_ties=100, intra_ties=20
        )
        instruments = {pair.pair_id: "NAVCAM" for pair in network.pairs}
        (rig,) = calibrate_rig(network, {network.stop_ids[0]}, instruments, params).corrections
        off.append(rig.values / rig.sigmas)
    assert (np.abs(np.mean(off, axis=0)) < 3 / np.sqrt(len(off))).all()  # three standard errors


def test_pairs_without_a_camera_set_are_not_changed(params):
    network, truth = simulate_network(np.random.default_rng(4), stops=1, inter_ties=20)
    held, names = {network.stop_ids[0]}, [pair.pair_id for pair in network.pairs]
    bent = with_bent_rig(network, truth, BENT, 0.0)
    (rig,) = calibrate_rig(bent, held, dict.fromkeys(names[1:], "NAVCAM"), params).corrections
    corrected = with_corrected_rigs(bent, dict.fromkeys(names[1:], "NAVCAM"), (rig,))
    own = network.ties.pair == network.ties.pair_ids.index(names[0])
    change = corrected.ties.parallax_px - bent.ties.parallax_px
    assert not change[own].any()
    assert change[~own].all()
    with pytest.raises(AdjustmentError, match="there is no rig to correct"):
        calibrate_rig(network, held, {}, params)


@pytest.mark.usefixtures("unchecked")
def test_a_network_with_control_keeps_its_datum(params):
    rng = np.random.default_rng(5)
    network, truth = simulate_network(rng, stops=2, inter_ties=20)
    bent = with_bent_rig(network, truth, BENT, 0.0)
    image = simulate_control(rng, bent, truth, [1])
    controlled = with_control(bent, [image.frame], image.control, params)
    instruments = {pair.pair_id: "NAVCAM" for pair in network.pairs}
    (rig,) = calibrate_rig(controlled, set(), instruments, params).corrections
    assert (np.abs(rig.values - np.append(BENT, 0.0)) < 4 * rig.sigmas).all()


def test_a_network_without_ties_cannot_be_corrected(params):
    network, _ = simulate_network(
        np.random.default_rng(2), stops=1, pairs_per_stop=2, inter_ties=0, intra_ties=5
    )
    instruments = {pair.pair_id: "NAVCAM" for pair in network.pairs}
    with pytest.raises(AdjustmentError, match="only where a network is adjusted"):
        calibrate_rig(network, {network.stop_ids[0]}, instruments, params)
