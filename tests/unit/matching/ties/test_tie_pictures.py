import numpy as np
import pytest

from photogrammetry.errors import MatchingError
from photogrammetry.matching.tie_pictures import GAP_PX, draw_ties
from photogrammetry.matching.ties import Ties


def tie(ids, first_left, second_left):
    one = np.ones(1)
    return Ties(
        ids,
        np.array([0], np.int32),
        np.array([1], np.int32),
        np.array([first_left], float),
        np.array([second_left], float),
        *[one.copy() for _ in range(6)],
    )


def test_a_tie_is_a_coloured_line_from_image_to_image(first_stop):
    one, other = first_stop.pairs[:2]
    ties = tie((one.pair_id, other.pair_id), (50, 100), (60, 100))
    plain = draw_ties(one, other, ties.taking(np.zeros(1, bool)))
    drawn = draw_ties(one, other, ties)
    assert plain.shape == (256, 2 * 256 + GAP_PX, 3)
    changed = (plain != drawn).any(axis=2)
    assert changed[100, 60:300].all()
    assert not changed[:90].any()
    assert not changed[:, :40].any()


def test_a_line_runs_the_right_way_when_the_pairs_are_exchanged(first_stop):
    one, other = first_stop.pairs[:2]
    ties = tie((one.pair_id, other.pair_id), (50, 100), (60, 140))
    drawn = draw_ties(other, one, ties)
    plain = draw_ties(other, one, ties.taking(np.zeros(1, bool)))
    assert (plain != drawn).any(axis=2)[140, 55:66].any()  # the ring around the start


def test_a_pair_that_the_ties_do_not_know_is_named(first_stop):
    one, other = first_stop.pairs[:2]
    with pytest.raises(MatchingError, match="P001 is not among the pairs"):
        draw_ties(one, other, tie(("P000", "X"), (5, 5), (6, 6)))
