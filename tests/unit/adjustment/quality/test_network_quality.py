"""What a quality report states is held against networks whose noise and blunders are known."""

import json
from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.adjusted_network import USED, AdjustmentReport
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.quality.network_quality import error_ellipse, network_quality
from solmap.photogrammetry.adjustment.quality.records import PairCamera, QualityParams
from solmap.photogrammetry.imagery import TieKind
from solmap.photogrammetry.synthetic.networks import LINES, simulate_network
from solmap.products.formats.documents.adjusted_network import quality_document

SIZES = {
    "stops": 3, "pairs_per_stop": 12, "inter_ties": 60, "intra_ties": 5,
    "cross_ties": 30, "far_cross_ties": 15,
}  # fmt: skip


def stated(network, adjusted, params=None, instrument=lambda _: "NAVCAM"):
    cameras = {p.pair_id: PairCamera(instrument(p), LINES, LINES) for p in network.pairs}
    telemetry = {s.stop: s.lsl_from_rover for s in network.stops}
    return network_quality(adjusted, telemetry, cameras, params or QualityParams())


@pytest.fixture(scope="module")
def clean():
    from solmap.photogrammetry.adjustment.model.params import AdjustmentParams  # noqa: PLC0415

    network, truth = simulate_network(np.random.default_rng(2), **SIZES)
    adjusted, report = adjust_overall(network, AdjustmentParams())
    assert report.is_usable
    return network, truth, adjusted, stated(network, adjusted)


def test_precision_is_the_mean_of_the_stated_standard_deviations(clean):
    _, _, adjusted, found = clean
    free = [p for p in adjusted.pairs if p.stop != adjusted.stops[0].stop]
    sigmas = np.sqrt([np.diagonal(p.covariance) for p in free])
    assert found.precision is not None
    assert found.precision.pairs == 24
    np.testing.assert_allclose(found.precision.position_mm, 1e3 * sigmas[:, 3:].mean(axis=0))
    np.testing.assert_allclose(
        found.precision.angles_arcmin, 60 * np.degrees(sigmas[:, :3].mean(axis=0))
    )


def test_residuals_of_a_clean_network_are_what_matching_stated(clean):
    _, _, _, found = clean
    (camera,) = found.cameras
    for kind in (TieKind.INTER_STEREO, TieKind.CROSS_SITE):
        figures = camera.figures[kind]
        # noise was drawn with the stated sigma; n standardised residuals estimate 1 to 1/sqrt(2n)
        assert figures.rms_standardised == pytest.approx(
            1.0, abs=4 / np.sqrt(2 * 3 * figures.observations)
        )
        assert np.abs(figures.mean_px).max() < 4 * 0.3 / np.sqrt(figures.observations)
    assert not found.weaknesses
    assert not found.blunders


def test_a_bent_camera_shows_in_the_grid_of_means(params):
    network, _ = simulate_network(np.random.default_rng(2), **SIZES)
    ties = network.ties
    stretched = ties.parallax_px + 0.8 * (ties.left[:, 0] > LINES / 2)
    bent = replace(network, ties=replace(ties, parallax_px=stretched))
    adjusted, _ = adjust_overall(bent, params)
    (camera,) = stated(bent, adjusted).cameras
    parallax = np.array([[c[2] if c else np.nan for c in row] for row in camera.grid])
    half = parallax.shape[1] // 2
    # neighbours overlap in opposite halves, so every point meets both: 0.4 px off to either side
    assert np.nanmean(parallax[:, half:]) == pytest.approx(0.4, abs=0.1)
    assert np.nanmean(parallax[:, :half]) == pytest.approx(-0.4, abs=0.1)


def test_blunders_are_named_with_their_place_and_the_ties_that_contradict_them(params):
    network, truth = simulate_network(np.random.default_rng(4), blunders=0.1, **SIZES)
    adjusted, report = adjust_overall(network, params)
    found = stated(network, adjusted).blunders
    assert len(found) == report.blunders > 4
    # of a point that only two pairs see, either may be the one that is set aside
    wrong = set(network.ties.point[np.flatnonzero(truth.blunders)].tolist())
    assert {b.point for b in found} <= wrong
    rows = {(n, *left): k for k, (n, left) in enumerate(places(network.ties))}
    for blunder in found:
        k = rows[blunder.pair_id, *blunder.left_px]
        assert network.ties.point[k] == blunder.point
        assert network.ties.parallax_px[k] == blunder.parallax_px
        assert blunder.pair_id not in blunder.others
    sizes = [float(np.linalg.norm(b.residual_px)) for b in found]
    assert sizes == sorted(sizes, reverse=True)


def places(ties):
    return [(ties.pair_ids[k], xy) for k, xy in zip(ties.pair, ties.left.tolist(), strict=True)]


def test_redundancy_counts_every_measured_coordinate_once(clean):
    _, _, adjusted, found = clean
    ties = adjusted.ties
    tied = (ties.status == USED) & (np.array(ties.kinds)[ties.observations.point] != "intra-stereo")
    total = sum(r.observations for r in found.redundancy.values())
    assert total == tied.sum()
    mean = sum(3 * r.observations * r.mean for r in found.redundancy.values())
    assert mean == pytest.approx(ties.redundancy[tied].sum())


def test_the_ellipse_has_the_axes_of_the_covariance(clean):
    _, _, adjusted, _ = clean
    azimuth = np.radians(30.0)
    axes = np.array([[np.cos(azimuth), -np.sin(azimuth)], [np.sin(azimuth), np.cos(azimuth)]])
    covariance = np.zeros((6, 6))
    covariance[3:5, 3:5] = axes @ np.diag([0.4**2, 0.1**2]) @ axes.T
    (major, minor), degrees = error_ellipse(replace(adjusted.stops[0], covariance=covariance))
    assert (major, minor, degrees) == pytest.approx((0.4, 0.1, 30.0))


def test_weak_places_are_named(params):
    network, _ = simulate_network(
        np.random.default_rng(5), **SIZES | {"stops": 4, "cross_ties": 4, "far_cross_ties": 0}
    )
    names = network.stop_ids
    alone = np.array([not name.startswith("S0003") for name in network.ties.pair_ids])
    across = (
        np.isin(network.ties.point, network.ties.point[~alone[network.ties.pair]])
        & alone[network.ties.pair]
    )
    from solmap.photogrammetry.adjustment.model.network import select  # noqa: PLC0415

    cut = replace(network, ties=select(network.ties, ~across))
    adjusted, _ = adjust_overall(cut, params)
    found = stated(cut, adjusted)
    message = {weak.what: weak.why for weak in found.weaknesses}
    assert "left at telemetry" in message[str(names[3])]
    assert message[f"link {names[0]} - {names[1]}"] == "rests on 4 tie points, fewer than 7"
    assert found.links[names[0], names[1]] == 4
    assert (names[2], names[3]) not in found.links


def test_the_document_is_json_and_names_images_and_stops(clean):
    network, _, _, found = clean
    document = json.loads(json.dumps(quality_document(found), allow_nan=False))
    assert [stop["stop"] for stop in document["stops"]] == [str(s) for s in network.stop_ids]
    assert set(document["ties"]) == {str(kind) for kind in TieKind}
    first, second = network.stop_ids[:2]
    assert document["links"][f"{first} - {second}"] >= 20


@pytest.mark.parametrize(("stops", "words"), [(1, "1 position left"), (2, "2 positions left")])
def test_the_report_counts_one_position_in_the_singular(stops, words):
    report = AdjustmentReport(
        "x", converged=True, iterations=0, sigma0=1.0, redundancy=0, stops=stops, pairs=1
    )
    assert words in str(report)
