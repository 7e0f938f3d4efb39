"""The adjusted network goes through JSON and comes back."""

import json

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.synthetic.networks import simulate_network
from solmap.products.formats.documents.adjusted_network import (
    network_document,
    network_of_document,
)


@pytest.fixture
def adjusted():
    network, _ = simulate_network(
        np.random.default_rng(1), stops=3, cross_ties=8, inter_ties=8, blunders=0.1
    )
    return adjust_overall(network, AdjustmentParams())


def test_poses_covariances_and_ties_are_read_back_exactly(adjusted):
    network, report = adjusted
    text = json.dumps(network_document(network, [report]), allow_nan=False)
    again = network_of_document(json.loads(text))
    for old, new in zip(network.stops, again.stops, strict=True):
        assert (old.stop, old.held, old.is_tied, old.held_by) == (
            new.stop, new.held, new.is_tied, new.held_by,
        )  # fmt: skip
        np.testing.assert_array_equal(old.covariance, new.covariance)
        np.testing.assert_array_equal(old.lsl_from_rover.rotation, new.lsl_from_rover.rotation)
        np.testing.assert_array_equal(
            old.lsl_from_rover.translation_m, new.lsl_from_rover.translation_m
        )
    for old, new in zip(network.pairs, again.pairs, strict=True):
        assert old.lsl_from_pair.source == new.lsl_from_pair.source
        np.testing.assert_array_equal(old.lsl_from_pair.rotation, new.lsl_from_pair.rotation)
        np.testing.assert_array_equal(old.covariance, new.covariance)
        np.testing.assert_array_equal(old.pointing, new.pointing)
    for name in ("points", "covariances", "status", "residuals_px", "standardised", "redundancy"):
        np.testing.assert_array_equal(getattr(network.ties, name), getattr(again.ties, name))
    np.testing.assert_array_equal(network.ties.observations.left, again.ties.observations.left)
    assert network.ties.kinds == again.ties.kinds


def test_the_report_in_the_document_is_its_line_and_its_numbers(adjusted):
    network, report = adjusted
    (written,) = network_document(network, [report])["reports"]
    assert written["summary"] == str(report)
    assert written["sigma0"] == report.sigma0
    assert written["after"]["cross-site"]["comparisons"] > 0
    assert str(report).startswith("overall adjustment: converged after")
    assert "\n" not in str(report)


def test_a_document_of_another_kind_is_refused():
    with pytest.raises(AdjustmentError, match=r"expected a document of format .* found 'map'"):
        network_of_document({"format": "map"})


def test_an_incomplete_document_names_the_missing_part(adjusted):
    document = network_document(adjusted[0])
    del document["pairs"]
    with pytest.raises(AdjustmentError, match="lacks 'pairs'"):
        network_of_document(document)
