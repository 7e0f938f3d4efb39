from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.cross_site.birds_eye import BirdsEyeParams, PlaneFit
from solmap.photogrammetry.matching.cross_site.gate import GateParams, search_gate
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.hypotheses.search import (
    CLEAR,
    CORRELATION,
    FEATURES,
    LEAST_LEVEL,
    ROCKS,
    HypothesisParams,
    find_hypotheses,
    merge_peaks,
    rank_peaks,
)

PARAMS = HypothesisParams()
BIRDS_EYE = BirdsEyeParams(radius_m=16.0)


def fit(north, east, z, azimuth=0.0):
    return PlaneFit(azimuth, float(north), float(east), 0.0, float(z), 100.0)


@pytest.fixture(scope="module")
def first(first_stop):
    return StopViews.of(first_stop, BIRDS_EYE)


def found_between(one, other):
    gate, _ = search_gate(one.stop, other.stop, GateParams())
    return find_hypotheses(one, other, gate, BIRDS_EYE, PARAMS)


def test_ways_that_agree_rank_before_one_that_shouts():
    correlation = rank_peaks(CORRELATION, [fit(0, 0, 9), fit(5, 0, 7), fit(0, 5, 5), fit(5, 5, 5)])
    features = rank_peaks(FEATURES, [fit(5.1, 0.2, 12), fit(-5, 0, 6), fit(0, -5, 6)])
    best = merge_peaks([*correlation, *features])[0]
    assert best.found_by == (FEATURES, CORRELATION)
    assert (best.fit.north_m, best.fit.east_m) == (5.1, 0.2)
    assert best.evidence == pytest.approx((12 / 6 - 1) + (7 / 5 - 1))


def test_what_looks_like_the_rest_is_no_evidence():
    peaks = rank_peaks(ROCKS, [fit(0, 0, 4), fit(5, 0, 4), fit(0, 5, 4), fit(5, 5, 3.9)])
    assert [peak.evidence for peak in peaks] == [0, 0, 0, 0]


def test_a_single_low_peak_is_held_against_chance():
    (peak,) = rank_peaks(ROCKS, [fit(0, 0, 2.5)])
    assert peak.evidence == 0
    (peak,) = rank_peaks(ROCKS, [fit(0, 0, 2 * LEAST_LEVEL)])
    assert peak.evidence == pytest.approx(1.0)


def test_one_place_at_two_azimuths_is_two_hypotheses():
    one = rank_peaks(CORRELATION, [fit(0, 0, 9), fit(5, 0, 4)])
    turned = rank_peaks(FEATURES, [fit(0, 0, 9, azimuth=0.05), fit(5, 0, 4)])
    assert len(merge_peaks([*one, *turned])) == 3


def test_two_peaks_of_one_way_never_count_as_agreeing():
    near = rank_peaks(CORRELATION, [fit(0, 0, 9), fit(0.1, 0, 8), fit(5, 0, 4)])
    assert all(h.found_by == (CORRELATION,) for h in merge_peaks(near))


def test_correlation_and_features_find_a_stop_that_looks_back_under_another_sun(
    first, second_stop, first_stand, second_stand
):
    found = found_between(first, StopViews.of(second_stop, BIRDS_EYE))
    level = first.stop.lsl_from_rover.rotation
    true = level @ (first_stand.true.inverse @ second_stand.true).translation_m
    best = found[0]
    assert {CORRELATION, FEATURES} <= set(best.found_by)
    assert np.hypot(best.fit.north_m - true[0], best.fit.east_m - true[1]) < 0.2
    assert best.fit.down_m == pytest.approx(true[2], abs=0.15)
    assert all(best.evidence > 1 + other.evidence for other in found[1:])


def test_on_other_ground_no_hypothesis_is_clear(first, foreign_stop):
    found = found_between(first, StopViews.of(foreign_stop, BIRDS_EYE))
    assert len(found) <= PARAMS.most
    assert found[0].evidence < CLEAR


def test_the_best_are_handed_on_and_no_more_than_asked_for(first, second_stop):
    gate, _ = search_gate(first.stop, second_stop, GateParams())
    few = find_hypotheses(
        first, StopViews.of(second_stop, BIRDS_EYE), gate, BIRDS_EYE, replace(PARAMS, most=2)
    )
    assert len(few) == 2
    assert few[0].evidence >= few[1].evidence


def test_none_to_be_tried_are_no_hypotheses():
    with pytest.raises(MatchingError, match="1 or more to be tried"):
        HypothesisParams(most=0)
