"""The quality report names what images did not determine."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.adjusted_network import Lack
from solmap.photogrammetry.adjustment.model.datum import with_control
from solmap.photogrammetry.adjustment.model.network import select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.quality.network_quality import network_quality
from solmap.photogrammetry.adjustment.quality.records import PairCamera, QualityParams
from solmap.photogrammetry.synthetic.mission import simulate_control
from solmap.photogrammetry.synthetic.networks import LINES, simulate_network
from solmap.products.formats.documents.adjusted_network import quality_document, report_document
from solmap.products.reports.quality_page import report_page


class Blank(dict):
    """Placeholder figures."""

    def items(self):
        return [(name, b"<svg/>") for name in ("traverse", "growth", "statistics", "NAVCAM")]


@pytest.fixture(scope="module")
def network():
    return simulate_network(
        np.random.default_rng(3), stops=3, pairs_per_stop=6, inter_ties=8, intra_ties=0
    )[0]


def page_of(network):
    adjusted, report = adjust_overall(network, AdjustmentParams())
    cameras = {pair.pair_id: PairCamera("NAVCAM", LINES, LINES) for pair in network.pairs}
    telemetry = {prior.stop: prior.lsl_from_rover for prior in network.stops}
    found = network_quality(adjusted, telemetry, cameras, QualityParams())
    document = {"adjustment": report_document(report), "quality": quality_document(found)}
    return report_page("a network", document, Blank()), report


def test_a_stop_without_ties_is_named_with_what_holds_it(network):
    last = {pair.pair_id for pair in network.pairs if pair.stop == network.stop_ids[-1]}
    seen = np.array([name in last for name in network.ties.pair_ids])[network.ties.pair]
    alone = replace(network, ties=select(network.ties, ~seen))
    page, report = page_of(alone)
    (finding,) = report.findings
    assert finding.lack is Lack.NO_TIES
    section = page.split("What images do not determine")[1].split("<h2>")[0]
    assert str(network.stop_ids[-1]) in section
    assert "no ties: telemetry holds it" in section


def test_a_network_determined_by_images_has_no_such_section(network):
    page, report = page_of(network)
    assert not report.findings
    assert "What images do not determine" not in page


def test_control_is_in_the_report_with_wrong_points_named(network):
    rng = np.random.default_rng(3)
    truth = simulate_network(rng, stops=3, pairs_per_stop=6, inter_ties=8, intra_ties=0)[1]
    orbit = simulate_control(rng, network, truth, range(3))
    wrong = replace(orbit.control[1], east_m=orbit.control[1].east_m + 8.0)
    control = (orbit.control[0], wrong, orbit.control[2])
    frame = replace(orbit.frame, covariance=orbit.frame.covariance / 1e4)
    frame = replace(frame, place=orbit.place)  # well known, so that three places check each other
    page, _ = page_of(with_control(network, [frame], control, AdjustmentParams()))
    section = page.split("<h2>Control</h2>")[1].split("<h2>")[0]
    east_m, north_m = np.sqrt(np.diagonal(wrong.covariance)[:2])
    assert f"{east_m:.2f}, {north_m:.2f}" in section
    assert section.count("set aside: off by +8.") + section.count("set aside: off by +7.") == 1
    assert f"<b>{wrong.stop} in orbit</b>: its position was set aside" in page
    assert "control: its position in orbit" in page.split("<h2>Stops</h2>")[1]
