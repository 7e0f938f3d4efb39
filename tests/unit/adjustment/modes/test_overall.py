"""What the adjustment does to networks whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from solmap.photogrammetry.adjustment.model.adjusted_network import BLUNDER, UNUSED, USED
from solmap.photogrammetry.adjustment.model.collinearity import misclosures, partials
from solmap.photogrammetry.adjustment.model.network import Network, StopPrior, select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.telemetry import Telemetry
from solmap.photogrammetry.adjustment.modes.overall import adjust, adjust_overall
from solmap.photogrammetry.adjustment.solver.normal_equations import normal_equations
from solmap.photogrammetry.adjustment.solver.problem import Problem
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import StopId, TieKind
from solmap.photogrammetry.synthetic.networks import TelemetryErrors, simulate_network


def errors(adjusted, truth):
    """(n, 6) rotation vector in the LSL and position, adjusted minus true."""
    rows = []
    for stop, pose in zip(adjusted.stops, truth.lsl_from_rover, strict=True):
        turn = Rotation.from_matrix(stop.lsl_from_rover.rotation @ pose.rotation.T).as_rotvec()
        rows.append([*turn, *(stop.lsl_from_rover.translation_m - pose.translation_m)])
    return np.array(rows)


def without_cross_site_ties_to(network, stop):
    """The network without what joins a stop to the others."""
    of_pair = {pair.pair_id: pair.stop for pair in network.pairs}
    there = np.array([of_pair[name] == stop for name in network.ties.pair_ids])[network.ties.pair]
    shared = np.intersect1d(network.ties.point[there], network.ties.point[~there])
    rows = ~(there & np.isin(network.ties.point, shared))
    return replace(network, ties=select(network.ties, rows))


def test_a_world_without_noise_is_recovered_from_a_wrong_start(params):
    network, truth = simulate_network(np.random.default_rng(1), stops=4, noise=0.0)
    right, _ = adjust_overall(network, params)
    rng = np.random.default_rng(2)
    wrong = replace(
        right,
        stops=tuple(
            replace(
                stop,
                lsl_from_rover=Pose(
                    LSL,
                    stop.stop.frame,
                    Rotation.from_rotvec(rng.normal(0, 0.03, 3)).as_matrix()
                    @ stop.lsl_from_rover.rotation,
                    stop.lsl_from_rover.translation_m + rng.normal(0, 0.3, 3),
                ),
            )
            if not stop.held
            else stop
            for stop in right.stops
        ),
    )
    adjusted, report = adjust_overall(network, params, wrong)
    assert report.converged
    assert np.abs(errors(adjusted, truth)).max() < 1e-8
    points = adjusted.ties.points
    near = np.linalg.norm(points - truth.points, axis=1)
    assert near.max() < 1e-6  # a point of four pixels' parallax moves by metres a pixel


def test_cross_site_ties_remove_most_of_the_telemetry_error(params):
    network, truth = simulate_network(np.random.default_rng(3), stops=5)
    telemetry = max(
        np.linalg.norm(s.lsl_from_rover.translation_m - t.translation_m)
        for s, t in zip(network.stops, truth.lsl_from_rover, strict=True)
    )
    adjusted, report = adjust_overall(network, params)
    assert report.is_usable
    assert np.linalg.norm(errors(adjusted, truth)[:, 3:], axis=1).max() < 0.1 * telemetry
    assert report.untied == ()
    was, now = report.before[TieKind.CROSS_SITE], report.after[TieKind.CROSS_SITE]
    assert now.mean_2d_px < 0.5  # noise is 0.3 px a coordinate
    assert was.mean_2d_px > 10.0
    assert now.mean_3d_m < was.mean_3d_m


def test_sigma0_is_one_on_clean_networks(params):
    found = [
        adjust_overall(simulate_network(np.random.default_rng(seed), stops=4)[0], params)[1]
        for seed in range(5)
    ]
    redundancy = sum(r.redundancy for r in found)
    sigma0 = np.sqrt(sum(r.sigma0**2 * r.redundancy for r in found) / redundancy)
    assert sigma0 == pytest.approx(1.0, abs=0.05)  # 2.6 / sqrt(2 * 4000) would be 0.03


@pytest.mark.usefixtures("unchecked")
def test_stated_covariances_are_true(params):
    """Errors squared, normalised by the stated covariances, are what chance makes them."""
    networks = 32
    nees, points = [], []
    for seed in range(networks):
        rng = np.random.default_rng(3000 + seed)
        network, truth = simulate_network(
            rng, stops=3, pairs_per_stop=7, cross_ties=8, far_cross_ties=3, inter_ties=4,
            intra_ties=2, errors=TelemetryErrors.assumed_by(params),
        )  # fmt: skip
        adjusted, _ = adjust_overall(network, params)
        e = errors(adjusted, truth)[-1]
        nees.append(e @ np.linalg.solve(adjusted.stops[-1].covariance, e))
        off = adjusted.ties.points - truth.points
        scaled = np.linalg.solve(adjusted.ties.covariances, off[:, :, None])[:, :, 0]
        points.extend((off * scaled).sum(axis=1))
    low, high = chi2.ppf([0.025, 0.975], 6 * networks)
    assert low < sum(nees) < high
    # points of one network are correlated: 32 networks make about 3 * 32 * 4 independent numbers
    assert np.mean(points) / 3 == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("fraction", [0.05, 0.2])
def test_harmful_blunders_are_found(params, fraction):
    network, truth = simulate_network(
        np.random.default_rng(7), stops=4, cross_ties=26, far_cross_ties=0, blunders=fraction
    )
    adjusted, report = adjust_overall(network, params)
    # harm done: no stop is further off than its own uncertainty explains
    e = errors(adjusted, truth)[1:]
    C = np.array([stop.covariance for stop in adjusted.stops[1:]])
    nees = (e * np.linalg.solve(C, e[:, :, None])[:, :, 0]).sum(axis=1)
    assert nees.max() < chi2.ppf(0.999, 6)
    ties = adjusted.ties
    wrong = np.abs(truth.blunders) > 10.0
    in_use = (ties.status == USED) & wrong
    checked = np.nanmax(np.nan_to_num(ties.redundancy), axis=1) > 0
    # what stays is alone (its partner was set aside), so that it holds nothing
    assert not (in_use & checked).any()
    assert report.blunders >= 0.8 * len(np.unique(ties.observations.point[wrong]))
    good = np.isin(ties.observations.point, ties.observations.point[truth.blunders != 0])
    lost = (ties.status == BLUNDER) & ~good
    assert lost.sum() <= 0.01 * (~good).sum()


def test_a_network_without_a_held_stop_has_no_datum(bent, params):
    network, _, _ = bent
    with pytest.raises(AdjustmentError, match=r"datum .* is undefined.*hold one stop"):
        adjust(network, set(), params)


def test_a_held_stop_must_be_in_the_network(bent, params):
    with pytest.raises(AdjustmentError, match="test-site0009-drive0009 cannot be held"):
        adjust(bent[0], {StopId("TEST", 9, 9)}, params)


def test_an_empty_network_is_refused(params):
    network, _ = simulate_network(np.random.default_rng(1), stops=1)
    empty = Network((), (), select(network.ties, np.zeros(len(network.ties), dtype=bool)))
    with pytest.raises(AdjustmentError, match="network is empty"):
        adjust_overall(empty, params)


def test_a_single_stop_has_its_mast_pointing_adjusted(params):
    network, truth = simulate_network(np.random.default_rng(4), stops=1)
    adjusted, report = adjust_overall(network, params)
    assert report.is_usable
    assert adjusted.stops[0].held
    assert not adjusted.stops[0].covariance.any()
    found = np.array([pair.pointing for pair in adjusted.pairs])
    relative = (found - found.mean(axis=0)) - (truth.pointings - truth.pointings.mean(axis=0))
    assert np.sqrt((relative**2).mean()) < 0.5 * np.radians(params.pointing_deg)


def test_a_pair_without_ties_keeps_its_label_and_its_prior(stated):
    stated = replace(stated, mast_deg=1e-7)  # other pairs determine the mast
    network, _ = simulate_network(np.random.default_rng(4), stops=2)
    lonely = network.pairs[3].pair_id
    k = network.ties.pair_ids.index(lonely)
    network = replace(network, ties=select(network.ties, network.ties.pair != k))
    pair = adjust_overall(network, stated)[0].pair(lonely)
    assert pair.ties == 0
    np.testing.assert_allclose(pair.pointing, 0.0, atol=1e-12)
    sigma = np.sqrt(np.diagonal(pair.pointing_covariance))
    np.testing.assert_allclose(np.degrees(sigma), stated.pointing_deg, rtol=1e-6)


def test_a_stop_without_ties_follows_the_stop_before_it(params):
    network, _ = simulate_network(np.random.default_rng(11), stops=4, far_cross_ties=0)
    last = network.stop_ids[-1]
    network = without_cross_site_ties_to(network, last)
    adjusted, report = adjust_overall(network, params)
    stop, before = adjusted.stop(last), adjusted.stops[-2]
    assert report.untied == (last,)
    assert not stop.is_tied
    assert stop.held_by == f"telemetry increment from {before.stop}"
    # the step in the frame of the rover before is that of telemetry
    reported = network.stops[-2].lsl_from_rover.inverse.apply(
        network.stops[-1].lsl_from_rover.translation_m[None]
    )
    kept = before.lsl_from_rover.inverse.apply(stop.lsl_from_rover.translation_m[None])
    np.testing.assert_allclose(kept, reported, atol=1e-6)
    # and its uncertainty is that of the drive, not of the images
    step = np.linalg.norm(reported)
    assert stop.sigma_ned_m.min() > 0.9 * params.slip * step > before.sigma_ned_m.max()


def test_a_network_of_telemetry_alone_is_adjusted(params):
    network, _ = simulate_network(np.random.default_rng(11), stops=3)
    bare = replace(network, ties=select(network.ties, np.zeros(len(network.ties), dtype=bool)))
    adjusted, report = adjust_overall(bare, params)
    for stop, prior in zip(adjusted.stops, bare.stops, strict=True):
        np.testing.assert_allclose(
            stop.lsl_from_rover.translation_m, prior.lsl_from_rover.translation_m, atol=1e-9
        )
    assert report.redundancy == 0
    assert not report.is_usable
    assert len(report.untied) == 2


def test_one_tie_leaves_the_attitude_to_telemetry(params):
    network, _ = simulate_network(np.random.default_rng(6), stops=2)
    without = without_cross_site_ties_to(network, network.stop_ids[1])
    shared = np.setdiff1d(network.ties.point, without.ties.point)
    of_stop = np.array([int(name[1:5]) for name in network.ties.pair_ids])[network.ties.pair]
    cross = np.intersect1d(network.ties.point[of_stop == 0], network.ties.point[of_stop == 1])
    rows = ~np.isin(network.ties.point, np.union1d(cross[1:], shared))
    network = replace(network, ties=select(network.ties, rows))
    adjusted, report = adjust_overall(network, params)
    assert report.converged
    azimuth_sigma = np.degrees(np.sqrt(adjusted.stops[1].covariance[2, 2]))
    assert azimuth_sigma > 0.5 * params.azimuth_step_deg


def test_a_fine_azimuth_is_absolute_and_a_coarse_one_relative(params):
    network, _ = simulate_network(np.random.default_rng(6), stops=4)
    bare = replace(network, ties=select(network.ties, np.zeros(len(network.ties), dtype=bool)))
    fine = replace(bare, stops=tuple(replace(s, attitude_measured_by="FINE") for s in bare.stops))

    def sigma_deg(which):
        stops = adjust_overall(which, params)[0].stops
        return np.degrees([np.sqrt(stop.covariance[2, 2]) for stop in stops[1:]])

    np.testing.assert_allclose(sigma_deg(fine), params.azimuth_fine_deg, rtol=0.01)
    np.testing.assert_allclose(
        sigma_deg(bare), params.azimuth_step_deg * np.sqrt([1, 2, 3]), rtol=0.01
    )


def test_points_seen_in_the_left_image_alone_are_ties_too(params):
    network, truth = simulate_network(np.random.default_rng(8), stops=2)
    parallax = network.ties.parallax_px.copy()
    first = np.unique(network.ties.point, return_index=True)[1]
    later = np.setdiff1d(np.arange(len(network.ties)), first)[::3]
    parallax[later] = np.nan
    network = replace(network, ties=replace(network.ties, parallax_px=parallax))
    adjusted, report = adjust_overall(network, params)
    assert report.is_usable
    assert np.isnan(adjusted.ties.residuals_px[later, 2]).all()
    assert np.linalg.norm(errors(adjusted, truth)[1, 3:]) < 0.3


def test_a_point_of_one_image_is_not_used(params):
    network, _ = simulate_network(np.random.default_rng(8), stops=2)
    number = network.ties.point[0]
    parallax = network.ties.parallax_px.copy()
    parallax[network.ties.point == number] = np.nan
    ties = replace(network.ties, parallax_px=parallax)
    rows = network.ties.point != number
    rows[0] = True
    network = replace(network, ties=select(ties, rows))
    adjusted, _ = adjust_overall(network, params)
    assert (adjusted.ties.status[network.ties.point == number] == UNUSED).all()
    assert np.isnan(adjusted.ties.points[number]).all()


def test_elimination_equals_the_classical_reduction_of_the_normal_equations(bent, params):
    """On near points it equals N_oo - N_ot N_tt^-1 N_to, on a dense copy of the whole system."""
    network, observations, state = bent
    telemetry = Telemetry.of(network, params)
    held = np.array([True, False, False])
    everything = np.ones(len(observations), dtype=bool)
    problem = Problem.of(observations, telemetry, held, everything)
    nothing = Problem.of(observations, telemetry, held, ~everything)
    unknowns = problem.unknowns
    dense, right = np.zeros((unknowns.count, unknowns.count)), np.zeros(unknowns.count)
    for point in np.unique(observations.point).tolist():
        rows = np.flatnonzero(observations.point == point)
        if len(rows) == 1:
            continue
        weight = observations.weight[rows].ravel()[:, None]
        by_orientation, by_point = partials(state, observations, rows)
        A_o, A_t = np.zeros((3 * len(rows), unknowns.count)), by_point.reshape(-1, 3) * weight
        for i, pair in enumerate(observations.pair[rows].tolist()):
            local = unknowns.columns(np.array([pair]))[0]
            at = unknowns.offsets[unknowns.pair_stop[pair]] + local[local >= 0]
            A_o[3 * i : 3 * i + 3, at] = by_orientation[i][:, local >= 0]
        A_o *= weight
        l = misclosures(state, observations, rows).ravel() * weight[:, 0]
        N_tt, N_ot = A_t.T @ A_t, A_o.T @ A_t
        dense += A_o.T @ A_o - N_ot @ np.linalg.solve(N_tt, N_ot.T)
        right += A_o.T @ l - N_ot @ np.linalg.solve(N_tt, A_t.T @ l)
    found, reported = (normal_equations(p, state, None) for p in (problem, nothing))
    np.testing.assert_allclose(
        (found[1] - reported[1])[:-1], right, atol=1e-9 * np.abs(right).max()
    )
    bare = nothing.pattern.views(reported[0])
    for (s, t), block in problem.pattern.views(found[0]).items():
        rows = slice(unknowns.offsets[s], unknowns.offsets[s] + unknowns.sizes[s])
        columns = slice(unknowns.offsets[t], unknowns.offsets[t] + unknowns.sizes[t])
        images = block - bare.get((s, t), 0.0)
        np.testing.assert_allclose(images, dense[rows, columns], atol=1e-9 * np.abs(dense).max())


def test_redundancy_numbers_sum_to_the_redundancy_of_the_images(params):
    network, _ = simulate_network(np.random.default_rng(2), stops=3)
    loose = replace(params, pointing_deg=3.0, tilt_deg=10.0, azimuth_step_deg=60.0, slip=10.0)
    adjusted, report = adjust_overall(network, loose)
    telemetry = 2 * 6 + 3 * len(network.pairs)
    images = float(adjusted.ties.redundancy.sum())
    # loose telemetry determines nothing: each of its observations is one of redundancy to itself
    assert images == pytest.approx(report.redundancy - telemetry, abs=0.1 * telemetry)


def test_a_stop_needs_its_own_telemetry():
    pose = Pose.identity(LSL, StopId("TEST", 1, 0).frame)
    with pytest.raises(AdjustmentError, match=r"must be the pose of rover\[2, 0\] in lsl"):
        StopPrior(StopId("TEST", 2, 0), pose)


def test_a_missing_pair_of_a_stop_is_named():
    network, _ = simulate_network(np.random.default_rng(2), stops=2)
    with pytest.raises(AdjustmentError, match="S0001P00 was taken at test-site0001-drive0010"):
        replace(network, stops=network.stops[:1])


def test_a_standard_deviation_of_zero_is_refused():
    with pytest.raises(AdjustmentError, match=r"tilt_deg must be above zero.*`held`"):
        AdjustmentParams(tilt_deg=0.0)


@pytest.mark.usefixtures("unchecked")
def test_a_tie_that_returns_starts_at_its_current_place(params):
    """Its stops moved by metres while it was set aside; started from there it lay behind them."""
    network, _ = simulate_network(
        np.random.default_rng(0), stops=40, pairs_per_stop=6, inter_ties=4, intra_ties=0,
        spacing_m=26.0, blunders=0.03,
    )  # fmt: skip
    _, report = adjust_overall(network, params)
    assert report.converged
    assert report.sigma0 == pytest.approx(1.0, abs=0.05)
