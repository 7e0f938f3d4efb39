"""The scorecard of `make accuracy` states what was found, and against which goals."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm
from tests.support.accuracy import bias_floors, floors_of, pointing_errors
from tests.support.scorecard import markdown, scorecard

FLOOR = {"error_m": 0.01, "percent": 0.05, "azimuth_deg": -0.02, "tilt_deg": 0.03, "nees": 0.5}


def stop(driven_m, percent, nees, **others):
    row = {
        "stop": f"mer2-site{int(driven_m):04d}-drive0000",
        "driven_m": driven_m,
        "telemetry_error_m": 1.0,
        "adjusted_error_m": driven_m * (percent or 0.0) / 100,
        "percent": percent,
        "azimuth_error_deg": -0.04,
        "tilt_error_deg": 0.02,
        "nees": nees,
        "floor": FLOOR,
    }
    return row | others


def world(*stops, links=(), **others):
    bias = {"bias_m": {"0-10": -0.001}, "bias_floor_m": {"0-10": 0.0}}
    reported = {"world": "here", "failure": "", "cpu_s_a_stop": 55.0} | bias
    return reported | {"stops": list(stops), "links": list(links)} | others


def link(distance_m, *, linked=True, false=False):
    return {"distance_m": distance_m, "linked": linked, "false": false}


def reached(results):
    return {row["goal"]: (row["reached"], row["holds"]) for row in scorecard(results)}


def test_goals_are_compared_with_medians_and_worst_stops():
    first = world(stop(0.0, None, None), stop(15.0, 0.08, 1.0), stop(30.0, 0.2, 1.1))
    card = reached([first, world(stop(20.0, 0.06, 0.9))])
    assert card["position, median, % of the way"] == (0.08, True)
    assert card["position, worst stop, % of the way"] == (0.2, True)
    assert card["azimuth, median, degrees"] == (0.04, True)
    assert card["NEES/6, mean over all stops"] == (1.0, True)
    assert card["NEES/6, highest of a world"] == (1.05, True)
    assert card["height bias at 0-10 m, median, m"] == (0.001, True)
    card = reached([world(stop(15.0, 0.8, 27.0))])
    assert not any(
        card[goal][1] for goal in ("position, median, % of the way", "NEES/6, highest of a world")
    )


def test_a_goal_that_mast_pointing_forbids_is_named():
    results = [
        world(stop(20.0, 0.14, 1.0, floor=FLOOR | {"percent": percent})) for percent in (0.05, 0.13)
    ]
    pages = [markdown(scorecard([result]), [result]) for result in results]
    median = "| position, median, % of the way | 0.14 | <= 0.1 |"
    assert f"{median} 0.05 | **missed** |" in pages[0]
    assert f"{median} 0.13 | **missed**, as by the floor |" in pages[1]
    assert "| here | 1.00 (0.50) |" in pages[0]


def test_a_world_contradicts_its_covariances_where_chance_does_not_explain_it():
    goal = "worlds whose NEES/6 contradicts their covariances"
    usual = [world(stop(15.0, 0.1, nees), stop(30.0, 0.1, nees)) for nees in (0.4, 1.0, 1.8)]
    assert reached(usual)[goal] == (0.0, True)
    single = [world(stop(15.0, 0.1, 2.5)), *usual]
    assert reached(single)[goal] == (0.0, True)  # of one stop, it may be
    for nees in (0.1, 2.5):
        unusual = world(stop(15.0, 0.1, nees), stop(30.0, 0.1, nees))
        assert reached([unusual, *usual])[goal] == (1.0, False)


def test_links_count_by_distance_and_false_ones_are_named():
    links = [link(12.0), link(24.0), link(30.0, linked=False), link(35.0, false=True), link(60.0)]
    card = reached([world(stop(15.0, 0.1, 1.0), links=links)])
    assert card["links found to 25 m, share"] == (1.0, True)
    assert card["links found to 40 m, share"] == (0.5, False)
    assert card["false links"] == (1.0, False)


def test_a_failed_world_is_on_the_page_and_not_in_the_figures():
    results = [world(stop(15.0, 0.08, 1.0)), world(failure="no images", world="there")]
    page = markdown(scorecard(results), results)
    assert "there failed" in page
    assert "no images" in page
    assert reached(results)["position, median, % of the way"] == (0.08, True)
    assert scorecard([results[1]]) == []


def test_the_lower_limit_is_the_mean_pointing_error_of_both_panoramas():
    def turned(azimuth_deg):
        return Rotation.from_rotvec([0, 0, np.deg2rad(azimuth_deg)]).as_matrix()

    heading, origin, there = turned(70.0), np.zeros(3), np.array([12.0, 16.0, -1.0])
    stops = [(heading, turned(0.1), origin), (np.eye(3), turned(0.03), there)]
    held, other = floors_of(stops, pointing_errors(stops))
    assert (held["error_m"], held["azimuth_deg"]) == (0.0, 0.0)
    assert other["error_m"] == pytest.approx(20.0 * np.deg2rad(0.1), abs=1e-4)
    assert other["azimuth_deg"] == pytest.approx(-0.07, abs=1e-4)
    assert other["tilt_deg"] == pytest.approx(0.0, abs=1e-4)


def test_the_floor_of_height_bias_is_that_of_ground_turned_by_the_mean_pointing_error():
    grid, slope, pitch = MapGrid(-30.0, 30.0, 0.5, 120, 120), 0.1, np.deg2rad(0.1)
    east, north = grid.centres()
    true = np.repeat(slope * north[:, None], grid.cols, axis=1).astype(np.float32)
    seen = np.where(north[:, None] > 0, true, np.float32(np.nan))
    dtm = Dtm(grid, seen, seen, seen, np.ones(grid.shape, np.uint8))
    miss = Rotation.from_rotvec([0.0, pitch, 0.0]).as_matrix()
    floors = bias_floors(dtm, true, np.eye(3), miss, np.zeros(3))
    for name, (low, high) in {"0-10": (0, 10), "10-20": (10, 20)}.items():
        range_m = np.hypot(north[:, None], east[None, :])
        here = np.isfinite(seen) & (range_m >= low) & (range_m < high)
        ahead_m = np.median(np.broadcast_to(north[:, None], grid.shape)[here])
        assert floors[name] == pytest.approx(-ahead_m * pitch * (1 + slope**2), abs=2e-4)
