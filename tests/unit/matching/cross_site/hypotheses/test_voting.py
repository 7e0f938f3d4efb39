import numpy as np
import pytest

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.cross_site.birds_eye import SearchGate
from solmap.photogrammetry.matching.cross_site.hypotheses.voting import (
    Landmarks,
    VotingParams,
    likelihood_root,
    vote_for_places,
)

GATE = SearchGate(12.0, -5.0, 4.0, 0.06)
TRUE = (0.03, 13.4, -6.1)


def turn(azimuth):
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.array([[c, -s], [s, c]])


def landmarks(places, sigma_m=0.15):
    return Landmarks(places, np.broadcast_to(np.eye(2) * sigma_m**2, (len(places), 2, 2)))


def constellations(rng, common=25, foreign=40, noise_m=0.1, azimuth=TRUE[0]):
    """The same landmarks from two stops that stand to each other as TRUE says, and some others."""
    shared = rng.uniform(-8, 8, (common, 2)) + np.array([6.0, -3.0])
    there = (shared - TRUE[1:]) @ turn(azimuth)
    one, other = (
        np.concatenate([places + rng.normal(0, noise_m, places.shape), strangers])
        for places, strangers in zip(
            (shared, there), rng.uniform(-20, 20, (2, foreign, 2)), strict=True
        )
    )
    return landmarks(one), landmarks(other)


def every_pair(one, other):
    return np.argwhere(np.ones((len(one), len(other)), bool)).astype(np.int32)


def test_common_landmarks_elect_the_place_and_the_azimuth():
    one, other = constellations(np.random.default_rng(1))
    best, second = vote_for_places(one, other, every_pair(one, other), GATE, 2, VotingParams())
    # 25 landmarks placed to 0.14 m: 0.03 m, and 0.14 m / (5 m sqrt(25)) = 6 mrad
    assert np.hypot(best.north_m - TRUE[1], best.east_m - TRUE[2]) < 0.12
    assert best.azimuth == pytest.approx(TRUE[0], abs=0.02)
    assert best.z > 2 * second.z


def test_constellations_without_a_common_landmark_elect_nobody():
    one, other = constellations(np.random.default_rng(2), common=0, foreign=65)
    best = vote_for_places(one, other, every_pair(one, other), GATE, 1, VotingParams())[0]
    assert best.z < 5  # 3.0 to 4.2 with eight seeds; 8.8 to 10.9 with 25 landmarks in common


def test_a_pose_outside_the_gate_is_not_elected():
    one, other = constellations(np.random.default_rng(3))
    gate = SearchGate(GATE.north_m - 6.0, GATE.east_m, 3.0, GATE.azimuth_reach)
    for place in vote_for_places(one, other, every_pair(one, other), gate, 3, VotingParams()):
        off = np.hypot(place.north_m - gate.north_m, place.east_m - gate.east_m)
        assert off < gate.reach_m + 3 * VotingParams().cell_m  # a settled peak moves two cells


def test_landmarks_that_are_vague_along_the_ray_still_count_across_it():
    rng = np.random.default_rng(4)
    one, other = constellations(rng, noise_m=0.02)
    along = np.array([1.0, 0.0])
    vague = Landmarks(
        one.places + np.outer(rng.normal(0, 0.5, len(one)), along),
        np.broadcast_to(np.diag([0.5**2, 0.05**2]), (len(one), 2, 2)),
    )
    best = vote_for_places(vague, other, every_pair(one, other), GATE, 1, VotingParams())[0]
    assert abs(best.east_m - TRUE[2]) < 0.15
    assert abs(best.north_m - TRUE[1]) < 0.6


def test_without_pairs_nobody_is_elected():
    one, other = constellations(np.random.default_rng(5))
    assert vote_for_places(one, other, np.zeros((0, 2), np.int32), GATE, 3, VotingParams()) == []


def test_as_many_votes_as_expected_stand_for_nothing():
    sums = np.full((3, 3), 0.4, np.float32)
    z = likelihood_root(sums, sums, np.full((3, 3), 0.2, np.float32))
    np.testing.assert_allclose(z, 0, atol=1e-3)


def test_many_votes_stand_out_by_their_normal_deviation():
    # Stamps of height 1: the sum is the count. 130 where 100 are expected: 3 standard deviations.
    z = likelihood_root(*(np.full((1, 1), v, np.float32) for v in (130, 100, 100)))
    assert z[0, 0] == pytest.approx(2.86, abs=0.05)  # the Poisson count is a little skewed


def test_few_votes_where_none_is_expected_are_no_triumph():
    z = likelihood_root(*(np.full((1, 1), v, np.float32) for v in (2, 0.1, 0.1)))
    assert 2 < z[0, 0] < 3  # (k - l) / sqrt(l) would say 6


def test_cells_wider_than_what_is_looked_for_are_refused():
    with pytest.raises(MatchingError, match="cell < largest sigma < neighbourhood"):
        VotingParams(cell_m=2.0)
