from dataclasses import replace

import pytest

from solmap.photogrammetry.matching.cross_site.links import (
    LinkTestParams,
    SiteLinkFigures,
    evaluate_link,
)

GOOD = SiteLinkFigures(
    distance_m=20.0,
    peak_z=15.0,
    overlap_m2=500.0,
    measured=60,
    ties=50,
    by_chance=4,
    rms_px=1.0,
    sigma0=1.0,
    spread_m=4.0,
)


def evaluated(**changes):
    return evaluate_link(replace(GOOD, **changes), LinkTestParams())


def test_many_ties_far_above_chance_and_spread_out_are_a_link():
    linked, reason = evaluated()
    assert linked
    assert reason == "50 ties of 60 conjugates, rms 1.00 px, 4 by chance"


def test_too_few_ties_to_correct_drift_are_not_a_link():
    assert evaluated(ties=19, peak_z=7.0) == (False, "19 ties, 20 are needed")


def test_at_a_clear_peak_few_ties_are_a_link():
    few = {"ties": 9, "measured": 12, "by_chance": 1}
    assert evaluated(**few)[0]
    assert not evaluated(**few, peak_z=7.0)[0]
    assert evaluated(**few | {"ties": 7}) == (False, "7 ties, 8 are needed")


@pytest.mark.parametrize("by_chance", [26, 40])
def test_ties_at_the_rate_of_chance_are_not_a_link(by_chance):
    linked, reason = evaluated(by_chance=by_chance)
    assert not linked
    assert f"a wrong position gets {by_chance} by chance" in reason


def test_few_ties_at_twice_the_rate_of_chance_are_not_a_link():
    assert not evaluated(ties=24, measured=30, by_chance=11)[0]  # 11 + 4 sqrt(11) = 24.3
    assert evaluated(ties=24, measured=30, by_chance=8)[0]


def test_ties_that_disagree_in_space_are_not_a_link():
    assert "only 25% of 200 conjugates agree" in evaluated(measured=200)[1]


def test_ties_along_a_line_are_not_a_link():
    assert evaluated(spread_m=0.4) == (False, "the ties lie on a line, 0.4 m wide")
