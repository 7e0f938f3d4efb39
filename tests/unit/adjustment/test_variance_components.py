"""Sizes of errors, and systematic errors of the mast, are found where they differ from the priors.

Simulated networks whose errors are larger or smaller than what is stated of them.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from solmap.photogrammetry.adjustment.model.network import select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.telemetry import mast_partials
from solmap.photogrammetry.adjustment.model.variance_components import (
    COMPONENTS,
    Component,
    Scatter,
)
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.modes.sequential import begin, extend
from solmap.photogrammetry.adjustment.modes.stepwise import adjust_stepwise
from solmap.photogrammetry.adjustment.quality.network_quality import (
    component_quality,
    mast_quality,
)
from solmap.photogrammetry.adjustment.quality.records import QualityParams
from solmap.photogrammetry.adjustment.quality.weaknesses import weaknesses
from solmap.photogrammetry.synthetic.networks import TelemetryErrors, simulate_network
from solmap.products.formats.documents.adjusted_network import (
    network_document,
    network_of_document,
)
from tests.support.adjustment.network_statistics import nees

SMALL = {"pairs_per_stop": 10, "inter_ties": 20, "intra_ties": 2}


def simulated(seed, stops=5, errors=None, **how):
    return simulate_network(
        np.random.default_rng(seed), stops=stops, errors=errors, **{**SMALL, **how}
    )


@pytest.fixture(scope="module")
def stepped(rough):
    """Rough, stop by stop, with marginalised stops."""
    return along(rough, AdjustmentParams(window_stops=2), sequentially)


@pytest.fixture(scope="module")
def rough():
    """Pointing and ties much worse, tilt much better than stated."""
    errors = TelemetryErrors(pointing_deg=0.3, tilt_deg=0.1)
    return simulated(1, stops=6, errors=errors, tie_noise=2.0)[0]


def along(network, params, step):
    traverse = None
    for k, stop in enumerate(network.stop_ids):
        part = network.within(set(network.stop_ids[: k + 1]))
        traverse = step(traverse, part, [stop], params)[0]
    return traverse


def sequentially(traverse, part, new, params):
    return begin(part, params) if traverse is None else extend(traverse, part, new, params)


def test_error_sizes_are_estimated_from_any_stated_ones(rough, params):
    found = adjust_overall(rough, params)[0].components.sigmas
    assert found[Component.POINTING] == pytest.approx(0.3, rel=0.25)
    assert found[Component.INTER_STEREO] == pytest.approx(2.0, rel=0.15)
    assert found[Component.IMAGE_MATCHED] == pytest.approx(2.0, rel=0.2)
    assert found[Component.TILT] < 0.75 * params.tilt_deg


def test_an_undetermined_component_keeps_its_stated_size(params):
    network, _ = simulated(2, stops=1)
    found = adjust_overall(network, params)[0].components
    unseen = [k for k, name in enumerate(COMPONENTS[:4]) if name is not Component.POINTING]
    np.testing.assert_array_equal(found.factors[unseen], 1.0)
    two, _ = simulated(3, stops=2)
    assert np.abs(np.log(adjust_overall(two, params)[0].components.factors)).max() < np.log(2.0)


@pytest.mark.slow
def test_stated_covariances_are_true_though_pointing_is_three_times_worse(params, stated):
    errors = TelemetryErrors(pointing_deg=0.3)
    networks = [simulated(seed, stops=3, errors=errors, cross_ties=10) for seed in range(10)]
    taken, estimated = (
        np.mean([
            nees(adjust_overall(network, how)[0].stops[-1], truth.lsl_from_rover[-1])
            for network, truth in networks
        ])
        for how in (stated, params)
    )  # fmt: skip
    assert taken > 2.0
    assert estimated < 1.5  # 60 degrees of freedom: 1.32 is the 95 % point of true sigmas


def test_one_slipping_drive_does_not_change_the_size_for_all(params):
    slips = (0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 0.0)
    network, _ = simulated(4, stops=8, errors=TelemetryErrors(drive_slips=slips))
    found = adjust_overall(network, params)[0].components.sigmas
    assert found[Component.POSITION] < 2 * params.slip  # its 20 standard deviations alone: 5


def test_blunders_do_not_enlarge_the_size_of_tie_errors(params):
    network, _ = simulated(5, blunders=0.1)
    found = adjust_overall(network, params)[0].components.sigmas
    assert found[Component.IMAGE_MATCHED] == pytest.approx(1.0, abs=0.2)


def test_kinds_of_ties_have_separate_sizes(params):
    """Of what matching adds for errors that ties have in common residuals show nothing."""
    network, _ = simulated(6)
    ties = network.ties
    surface_matched = (ties.point % 2).astype(bool)
    wider = np.where(surface_matched, 10.0, 1.0)
    ties = replace(
        ties, surface_matched=surface_matched, sigma_line_px=wider * ties.sigma_line_px,
        sigma_parallax_px=wider * ties.sigma_parallax_px,
    )  # fmt: skip
    found = adjust_overall(replace(network, ties=ties), params)[0].components.sigmas
    assert found[Component.SURFACE_MATCHED] == pytest.approx(1.0, abs=0.35)
    assert found[Component.IMAGE_MATCHED] == pytest.approx(1.0, abs=0.25)
    assert select(ties, surface_matched).surface_matched.all()


def test_ties_between_stops_are_never_better_than_stated(params):
    """What is stated of errors that all of them share shows in no residual."""
    network, _ = simulated(7, stops=3, tie_noise=0.3)
    found = adjust_overall(network, params)[0].components.sigmas
    assert found[Component.IMAGE_MATCHED] == 1.0
    assert found[Component.INTER_STEREO] < 0.5


def test_the_weight_that_follows_from_a_factor_is_true_in_the_mean():
    rng = np.random.default_rng(7)
    for r in (20, 100):
        squares, redundancy = np.zeros((2, len(COMPONENTS), 3))
        redundancy[0, 0] = r
        factors = []
        for chance in rng.chisquare(r, 1000):
            squares[0, 0] = chance
            factors.append(Scatter(squares, redundancy).factors(1e-9)[0])
        assert 1.0 <= 1.1 * np.mean(np.power(factors, -2)) < 1.25


@pytest.mark.usefixtures("unchecked")
def test_steps_along_the_traverse_count_every_observation_once(rough, stepped, params):
    overall = adjust_overall(rough, params)[0].components
    assert stepped.memory is not None
    found = stepped.components
    np.testing.assert_allclose(
        found.scatter.redundancy.sum(), overall.scatter.redundancy.sum(), rtol=0.03
    )
    np.testing.assert_allclose(np.log(found.factors), np.log(overall.factors), atol=0.25)
    step = along(rough, params, adjust_stepwise).components
    kinds = [COMPONENTS.index(kind) for kind in (Component.POINTING, Component.MAST)]
    kinds += [COMPONENTS.index(kind) for kind in (Component.INTER_STEREO, Component.IMAGE_MATCHED)]
    np.testing.assert_allclose(
        np.log(step.factors[kinds]), np.log(overall.factors[kinds]), atol=0.25
    )
    mast = COMPONENTS.index(
        Component.MAST
    )  # unknown to the end: four observations, not four a step
    of_mast = [one.scatter.redundancy[mast].sum() for one in (found, overall)]
    np.testing.assert_allclose(*of_mast, rtol=0.1)


def test_the_next_step_reads_factors_from_the_document(stepped):
    again = network_of_document(network_document(stepped))
    assert again.components.sigmas == stepped.components.sigmas
    np.testing.assert_array_equal(again.components.past.squares, stepped.components.past.squares)
    np.testing.assert_array_equal(again.mast.covariance, stepped.mast.covariance)
    np.testing.assert_array_equal(again.memory.mast, stepped.memory.mast)


def test_the_report_states_priors_and_estimates(rough, params):
    adjusted, _ = adjust_overall(rough, params)
    found = {one.component: one for one in component_quality(adjusted)}
    assert found[Component.POINTING].prior == params.pointing_deg
    assert found[Component.POINTING].estimate > 0.2
    assert found[Component.POINTING].redundancy > 20
    assert Component.SURFACE_MATCHED not in found  # there are none
    named = {weak.what for weak in weaknesses(adjusted, {}, (), QualityParams())}
    assert str(Component.INTER_STEREO) in named


def test_errors_that_all_pairs_share_are_unknowns_of_the_mast(params):
    errors = TelemetryErrors(mast_deg=0.2, pointing_deg=0.05)
    for seed in (1, 2):
        network, truth = simulated(seed, stops=3, errors=errors)
        B = mast_partials(network.pairs)
        true = np.linalg.lstsq(B.reshape(-1, B.shape[2]), truth.pointings.ravel(), rcond=None)[0]
        adjusted, _ = adjust_overall(network, params)
        elevation, *axes = mast_quality(adjusted)
        assert elevation.sigma_deg < 0.04
        assert abs(elevation.value_deg - np.degrees(true[0])) < 3 * elevation.sigma_deg + 0.02
        assert all(axis.sigma_deg > 0.8 * params.mast_deg for axis in axes)  # as a tilt of all


@pytest.mark.usefixtures("unchecked")
def test_the_azimuth_zero_turns_all_places_about_the_held_stop_and_is_stated():
    stated = AdjustmentParams(mast_deg=0.2)
    known = replace(stated, mast_deg=1e-6)
    errors = TelemetryErrors.assumed_by(stated)
    across, without = [], []
    for seed in range(30):
        network, truth = simulated(seed, stops=3, errors=errors, pairs_per_stop=4, inter_ties=8)
        last, as_known = (adjust_overall(network, p)[0].stops[-1] for p in (stated, known))
        true = truth.lsl_from_rover[-1]
        way = true.translation_m - truth.lsl_from_rover[0].translation_m
        side = np.cross([0, 0, 1], way) / np.linalg.norm(way[:2])
        for stop, found in ((last, across), (as_known, without)):
            off = side @ (stop.lsl_from_rover.translation_m - true.translation_m)
            found.append((off, (side @ stop.covariance[3:, 3:] @ side) ** 0.5))
    (off, sigma), (off_if_known, sigma_if_known) = np.array(across).T, np.array(without).T
    low, high = chi2.ppf([0.0005, 0.9995], len(off)) / len(off)
    assert low < np.mean((off / sigma) ** 2) < high
    assert np.mean((off_if_known / sigma_if_known) ** 2) > high
    assert np.mean(off**2) < 1.02 * np.mean(off_if_known**2)  # no place is worse for it


def test_errors_of_the_mast_are_kept_in_the_marginal(stated):
    network, _ = simulated(8, errors=TelemetryErrors(mast_deg=0.1))
    traverse = along(network, replace(stated, window_stops=3), sequentially)
    overall, _ = adjust_overall(network, stated)
    sigma = np.sqrt(np.diagonal(overall.mast.covariance))
    np.testing.assert_allclose(traverse.mast.values / sigma, overall.mast.values / sigma, atol=0.02)
    np.testing.assert_allclose(np.diagonal(traverse.mast.covariance), sigma**2, rtol=0.01)
    a, b = traverse.stops[-1], overall.stops[-1]
    off = a.lsl_from_rover.translation_m - b.lsl_from_rover.translation_m
    assert (np.abs(off) < 0.02 * b.sigma_ned_m).all()
