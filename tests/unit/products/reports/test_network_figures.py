"""Figures of a report are drawn from any network, and are the same bytes every time."""

from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.network import select
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.adjustment.quality.network_quality import network_quality
from solmap.photogrammetry.adjustment.quality.records import PairCamera, QualityParams
from solmap.photogrammetry.synthetic.networks import LINES, simulate_network
from solmap.products.reports.network_figures import (
    ellipse_scale,
    growth_figure,
    network_figure,
    residual_figure,
    statistics_figure,
)


@pytest.fixture(scope="module", params=["tied", "telemetry alone", "one stop"])
def stated(request):
    stops = 1 if request.param == "one stop" else 3
    network, _ = simulate_network(np.random.default_rng(2), stops=stops)
    params = AdjustmentParams()
    if request.param == "telemetry alone":
        network = replace(network, ties=select(network.ties, np.zeros(0, np.int64)))
    adjusted, _ = adjust_overall(network, params)
    cameras = {p.pair_id: PairCamera("NAVCAM", LINES, LINES) for p in network.pairs}
    telemetry = {s.stop: s.lsl_from_rover for s in network.stops}
    return (
        adjusted,
        telemetry,
        cameras,
        network_quality(adjusted, telemetry, cameras, QualityParams()),
    )


def images(stated):
    adjusted, telemetry, cameras, found = stated
    return [
        network_figure(adjusted, telemetry, found),
        growth_figure(found),
        statistics_figure(adjusted),
        *(residual_figure(adjusted, cameras, camera) for camera in found.cameras),
    ]


def test_figures_are_svg_and_reproducible(stated):
    drawn = images(stated)
    assert drawn == images(stated)
    for image in drawn:
        root = ET.fromstring(image)  # noqa: S314 - drawn a line above
        assert root.tag.endswith("svg")
        assert b"<dc:date>" not in image


def test_a_camera_without_ties_has_no_residuals(stated):
    adjusted, _, _, found = stated
    tied = bool((adjusted.ties.redundancy > 0).any())
    assert len(found.cameras) == tied


def test_ellipses_are_enlarged_by_a_round_number_to_a_tenth_of_the_traverse(stated):
    adjusted, _, _, found = stated
    places = np.array([s.lsl_from_rover.translation_m for s in adjusted.stops])
    scale = ellipse_scale(places, found)
    first_digit = int(f"{scale:e}"[0])
    assert scale == pytest.approx(first_digit * 10 ** np.floor(np.log10(scale)))
    largest = max(stop.ellipse_m[0] for stop in found.stops)
    if scale > 1:
        extent = np.ptp(places[:, :2], axis=0).max()
        assert 0.05 * extent < scale * largest <= 0.1 * extent
