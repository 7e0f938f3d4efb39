import numpy as np
import pytest

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.imagery import StereoMatches, StopId
from solmap.photogrammetry.matching.records import Ties, join_ties
from solmap.photogrammetry.matching.tracks import (
    TrackParams,
    build_tie_points,
)

PAIRS = ("a", "b", "c")
STOPS = {"a": StopId("M", 1, 0), "b": StopId("M", 1, 0), "c": StopId("M", 1, 8)}


def tie(first, first_left, second, second_left, sigma=0.1):
    n = np.full(1, 5.0)
    return Ties(
        PAIRS,
        np.array([PAIRS.index(first)], np.int32),
        np.array([PAIRS.index(second)], np.int32),
        np.array([first_left], float),
        np.array([second_left], float),
        n,
        n + 1,
        np.full(1, sigma),
        np.full(1, sigma),
        np.full(1, 2 * sigma),
        np.full(1, 2 * sigma),
        np.full(1, sigma),
        np.full(1, sigma),
    )


def matches(name, points=()):
    left = np.array(points, float).reshape(-1, 2)
    return StereoMatches(name, left, np.full(len(left), 9.0), np.linspace(0.1, 0.3, len(left)))


def network(*ties, own=None):
    own = own or {}
    return build_tie_points([matches(p, own.get(p, ())) for p in PAIRS], list(ties), TrackParams())


def test_ties_that_share_a_measurement_become_one_point():
    points = network(tie("a", (10, 10), "b", (50, 9)), tie("a", (10.2, 10), "c", (70, 30)))
    assert points.point.tolist() == [0, 0, 0]
    assert [points.pair_ids[k] for k in points.pair] == ["a", "b", "c"]
    assert points.parallax_px.tolist() == [5.0, 6.0, 6.0]


def test_of_two_measurements_of_a_feature_the_more_certain_is_kept():
    points = network(
        tie("a", (10, 10), "b", (50, 9), sigma=0.5), tie("a", (10.2, 10), "c", (70, 30), sigma=0.1)
    )
    np.testing.assert_array_equal(points.left[0], [10.2, 10])
    assert points.sigma_px[0] == pytest.approx(0.1)
    assert points.sigma_parallax_px[0] == pytest.approx(0.2)


def test_measurements_further_apart_are_two_points():
    points = network(tie("a", (10, 10), "b", (50, 9)), tie("a", (14, 10), "c", (70, 30)))
    assert points.point.tolist() == [0, 0, 1, 1]


def test_a_point_measured_twice_in_a_pair_is_dropped():
    contradiction = (tie("a", (10, 10), "b", (50, 9)), tie("a", (10, 10), "b", (90, 9)))
    points = network(*contradiction, tie("b", (20, 20), "c", (30, 30)))
    assert points.point.tolist() == [0, 0]
    assert [points.pair_ids[k] for k in points.pair] == ["b", "c"]


def test_points_of_one_pair_are_thinned_to_the_most_certain_of_every_cell():
    points = network(own={"a": [(5, 5), (20, 20), (170, 5)]})
    np.testing.assert_array_equal(points.left, [[5, 5], [170, 5]])
    assert len(set(points.point.tolist())) == 2


def test_a_tied_match_is_not_listed_again():
    points = network(tie("a", (5, 5), "b", (50, 9)), own={"a": [(5, 5.1)]})
    assert points.point.tolist() == [0, 0]


def test_ties_with_a_pair_outside_the_network_are_left_out():
    few = [matches("a"), matches("b")]
    ties = join_ties([tie("a", (1, 1), "b", (2, 2)), tie("a", (9, 9), "c", (2, 2))], PAIRS)
    assert len(build_tie_points(few, [ties], TrackParams())) == 2


def test_a_network_without_ties_has_no_tie_points():
    assert len(network()) == 0


def test_a_pair_listed_twice_is_named():
    with pytest.raises(MatchingError, match="a is listed twice"):
        build_tie_points([matches("a"), matches("a")], [], TrackParams())


def test_ties_of_different_lists_of_pairs_are_not_joined():
    with pytest.raises(MatchingError, match="share one list of pairs"):
        join_ties([tie("a", (1, 1), "b", (2, 2))], ("a", "b"))
