import numpy as np
import pytest

from solmap.photogrammetry.matching.cross_site.birds_eye import BirdsEyeParams, PlaneFit
from solmap.photogrammetry.matching.cross_site.gate import GateParams, search_gate
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.hypotheses.features import FeatureParams
from solmap.photogrammetry.matching.cross_site.hypotheses.search import (
    HypothesisParams,
    find_hypotheses,
)
from solmap.photogrammetry.matching.cross_site.hypotheses.voting import Landmarks
from solmap.products.reports.matching_figures import ENLARGED, agrees_with_fit, draw_features

BIRDS_EYE = BirdsEyeParams(radius_m=16.0)


def landmarks(*places):
    return Landmarks(np.array(places, np.float64), np.tile(np.eye(2), (len(places), 1, 1)))


def test_landmarks_agree_if_the_fit_puts_one_on_the_other():
    east_of_it = PlaneFit(np.pi / 2, 1.0, 0.0, 0.0, 9.0, 100.0)
    earlier, later = landmarks((1.0, 2.0), (3.0, 0.0)), landmarks((2.0, 0.0), (0.0, 5.0))
    pairs = np.array([(0, 0), (1, 1), (1, 0)], np.int32)
    found = agrees_with_fit((earlier, later), pairs, east_of_it, 0.1)
    assert found.tolist() == [True, False, False]


@pytest.fixture(scope="module")
def both(first_stop, second_stop):
    return tuple(StopViews.of(stop, BIRDS_EYE) for stop in (first_stop, second_stop))


def lines_in(picture):
    """Picture elements in colour: the ground is grey."""
    return int((np.ptp(picture.astype(int), axis=2) > 60).sum())


def test_features_that_agree_are_joined_across_both_views(both):
    one, other = both
    gate, _ = search_gate(one.stop, other.stop, GateParams())
    right = find_hypotheses(one, other, gate, BIRDS_EYE, HypothesisParams())[0].fit
    wrong = PlaneFit(right.azimuth, right.north_m - 4.0, right.east_m + 4.0, 0.0, 1.0, 1.0)
    views = (one.birds_eye, other.birds_eye)
    drawn, nearly_none = (
        draw_features(*views, fit, BIRDS_EYE, FeatureParams()) for fit in (right, wrong)
    )
    assert drawn.shape[0] == ENLARGED * one.birds_eye.grey.shape[0]
    assert lines_in(drawn) > 4 * lines_in(nearly_none)
