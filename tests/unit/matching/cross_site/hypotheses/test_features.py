from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    BirdsEyeParams,
    BirdsEyeView,
    SearchGate,
)
from solmap.photogrammetry.matching.cross_site.hypotheses.features import (
    FeatureParams,
    conjugate_features,
    find_features,
    match_features,
)

BIRDS_EYE = BirdsEyeParams(radius_m=16.0)
PARAMS = FeatureParams()
GATE = SearchGate(9.0, -6.0, 3.0, 0.06)
CELLS = 200


def seen_from(seed, north=0.0, east=0.0, azimuth=0.0):
    """A round view of one endless ground from a place, its north turned by `azimuth`."""
    rng = np.random.default_rng(seed)
    size, cell_m = 420, BIRDS_EYE.cell_m
    grounds = [ndimage.gaussian_filter(rng.normal(size=(size, size)), s) for s in (1.5, 2.0)]
    row, col = np.mgrid[:CELLS, :CELLS]
    n, e = ((CELLS - 1) / 2 - row) * cell_m, (col - (CELLS - 1) / 2) * cell_m
    there_n = north + n * np.cos(azimuth) - e * np.sin(azimuth)
    there_e = east + n * np.sin(azimuth) + e * np.cos(azimuth)
    at = [size / 2 - there_n / cell_m, size / 2 + there_e / cell_m]
    views = [ndimage.map_coordinates(k, at, order=1).astype(np.float32) for k in grounds]
    for view in views:
        view[np.hypot(n, e) > 14.0] = np.nan
    return BirdsEyeView(cell_m, views[0], views[1])


def features(*place, **how):
    return find_features(seen_from(*place, **how), BIRDS_EYE, PARAMS)


@pytest.fixture(scope="module")
def earlier():
    return features(1)


@pytest.fixture(scope="module")
def later():
    return features(1, 10.0, -7.3, azimuth=0.03)


def test_features_find_shift_and_azimuth(earlier, later):
    best, second = match_features(earlier, later, GATE, 2, PARAMS)
    # hundreds of features, each to a cell of 0.16 m at worst
    assert best.north_m == pytest.approx(10.0, abs=0.05)
    assert best.east_m == pytest.approx(-7.3, abs=0.05)
    assert best.azimuth == pytest.approx(0.03, abs=0.005)
    assert best.z > 2 * second.z


def test_conjugate_features_lie_on_the_same_ground(earlier, later):
    pairs = conjugate_features(earlier, later, GATE, PARAMS)
    c, s = np.cos(0.03), np.sin(0.03)
    moved = later.landmarks.places @ np.array([[c, -s], [s, c]]).T + (10.0, -7.3)
    off = np.hypot(*(earlier.landmarks.places[pairs[:, 0]] - moved[pairs[:, 1]]).T)
    assert len(pairs) > 100
    assert (off < 0.32).mean() > 0.5  # half of what is seen by one stop only has no conjugate


def test_conjugate_features_are_of_one_channel_and_used_once(earlier, later):
    pairs = conjugate_features(earlier, later, GATE, PARAMS)
    np.testing.assert_array_equal(earlier.channel[pairs[:, 0]], later.channel[pairs[:, 1]])
    for column in pairs.T:
        assert len(np.unique(column)) == len(pairs)


def test_features_do_not_need_the_grey_values_to_agree(earlier):
    relit = replace(seen_from(1, 10.0, -7.3), grey=seen_from(5, 10.0, -7.3).grey)
    later = find_features(relit, BIRDS_EYE, PARAMS)
    best = match_features(earlier, later, GATE, 1, PARAMS)[0]
    assert np.hypot(best.north_m - 10.0, best.east_m + 7.3) < 0.15


def test_features_of_other_ground_favour_no_place(earlier):
    found = match_features(earlier, features(2, 10.0, -7.3), GATE, 4, PARAMS)
    assert found[0].z < 1.6 * found[3].z


def test_features_lie_on_ground_that_was_seen(earlier):
    assert len(earlier.size_m) > 200
    assert np.hypot(*earlier.landmarks.places.T).max() < 14.5


def test_a_view_of_nothing_has_no_features():
    view = seen_from(1)
    nothing = np.full_like(view.grey, np.nan)
    found = find_features(BirdsEyeView(view.cell_m, nothing, nothing), BIRDS_EYE, PARAMS)
    assert len(found.size_m) == 0
    assert match_features(found, found, GATE, 3, PARAMS) == []


def test_sizes_alike_up_to_less_than_themselves_are_refused():
    with pytest.raises(MatchingError, match="give 1 or more features, a factor above 1"):
        FeatureParams(size_ratio=0.5)
