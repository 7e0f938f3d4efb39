import numpy as np
import pytest

from solmap.photogrammetry.errors import TraverseError
from solmap.photogrammetry.traverse.differences import common_stops, differences
from solmap.photogrammetry.traverse.records import Traverse


def traverse(solution, places_m, sols=None, stops=None):
    places_m = np.asarray(places_m, dtype=float)
    count = len(places_m)
    return Traverse(
        solution,
        tuple(stops or (f"1/{10 * k}" for k in range(count))),
        np.asarray(sols if sols is not None else range(count), dtype=np.int32),
        places_m,
    )


def test_a_constant_slip_of_a_tenth_shows_as_ten_percent_at_every_stop():
    true = [[0.0, 30.0 * k, 0.0] for k in range(5)]
    reported = [[0.0, 33.0 * k, 0.5 * k] for k in range(5)]
    found = differences(traverse("telemetry", reported), traverse("adjusted", true))
    np.testing.assert_allclose(found.distance_m, [0, 30, 60, 90, 120])
    np.testing.assert_allclose(found.horizontal_m, [0, 3, 6, 9, 12])
    np.testing.assert_allclose(found.percent[1:], 10.0)
    np.testing.assert_allclose(found.leg_m, 3.0)
    end = found.summary().end
    assert (end.horizontal_m, end.percent, end.elevation_m) == pytest.approx((12.0, 10.0, 2.0))


def test_the_worst_percentage_excludes_the_first_metres():
    true = [[0, 0, 0], [2, 0, 0], [50, 0, 0], [100, 0, 0], [300, 0, 0]]
    reported = [[0, 0, 0], [3, 0, 0], [51, 0, 0], [108, 0, 0], [306, 0, 0]]
    found = differences(traverse("telemetry", reported), traverse("adjusted", true))
    worst = found.summary().worst
    assert (worst.stop, worst.horizontal_m, worst.percent) == ("1/30", 8.0, 8.0)
    assert found.summary(least_distance_m=0.0).worst.percent == 50.0
    assert found.summary().farthest.stop == "1/30"


def test_cancelling_slips_show_in_the_legs():
    true = [[0, 0, 0], [50, 0, 0], [100, 0, 0]]
    reported = [[0, 0, 0], [55, 0, 0], [100, 0, 0]]
    found = differences(traverse("telemetry", reported), traverse("adjusted", true))
    assert found.horizontal_m[-1] == 0.0
    np.testing.assert_allclose(found.leg_m, 5.0)


def test_a_section_restarts_as_the_papers_local_difference():
    true = [[0, 0, 0], [100, 0, 0], [200, 0, 0], [250, 0, 0]]
    reported = [[0, 0, 0], [90, 0, 0], [180, 0, 0], [240, 0, 0]]
    reported, true = traverse("telemetry", reported), traverse("adjusted", true)
    local = differences(reported.between(2, 3), true.between(2, 3))
    assert local.summary().end.horizontal_m == pytest.approx(10.0)
    assert local.summary().end.percent == pytest.approx(20.0)


def test_a_sol_is_represented_by_its_last_stop():
    places = [[0, 0, 0], [10, 0, 0], [20, 0, 0], [30, 0, 0]]
    sols = [5, 5, 7, 7]
    found = differences(traverse("telemetry", places, sols), traverse("adjusted", places, sols))
    assert [(row.sol, row.stop) for row in found.by_sol()] == [(5, "1/10"), (7, "1/30")]


def test_an_elevation_missing_in_one_solution_is_not_invented():
    reported = [[0, 0, 0], [10, 0, 1]]
    true = [[5, 0, np.nan], [15, 0, np.nan]]
    found = differences(traverse("telemetry", reported), traverse("localised", true))
    assert np.isnan(found.offset_m[:, 2]).all()
    np.testing.assert_allclose(found.horizontal_m, 0.0, atol=1e-12)


def test_traverses_without_common_stops_are_refused_and_common_ones_compared():
    first = traverse("telemetry", [[0, 0, 0], [1, 0, 0], [2, 0, 0]], stops=["1/0", "1/5", "2/0"])
    second = traverse("adjusted", [[0, 0, 0], [2, 0, 0]], stops=["1/0", "2/0"])
    with pytest.raises(TraverseError, match="1/5"):
        differences(first, second)
    assert differences(*common_stops(first, second)).stops == ("1/0", "2/0")
    with pytest.raises(TraverseError, match="fewer than two"):
        differences(first.at([0]), first.at([0]))
