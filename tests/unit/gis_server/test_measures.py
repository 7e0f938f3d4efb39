import math

import numpy as np
import pytest

from solmap.gis_server.analysis.layer_values import ValueHere, derived_sigma
from solmap.gis_server.analysis.measures import true_azimuth
from solmap.products.crs import LandingPoint, lon_lat
from solmap.products.model import ProductKind
from tests.unit.gis_server.conftest import STOP, elevation_at, ref_of

API = "/api/missions/MER2"
SQUARE = [[0, 0], [10, 0], [10, 10], [0, 10]]
STEEPNESS = math.hypot(0.1, 0.05)


def request(client, what, **question):
    answer = client.post(f"{API}/{what}", json=question)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_a_line_has_its_length_rise_and_azimuth(client, world):
    body = request(client, "measure-line", line=[[0, 0], [6, 8], [6, 0]])
    assert body["map_length_m"] == pytest.approx(18.0)
    assert body["leg_azimuth_deg"] == pytest.approx(
        [math.degrees(math.atan2(6, 8)), 180.0], abs=1e-3
    )
    climbs = math.hypot(10, 1.0) + math.hypot(8, 0.4)
    assert body["surface_length_m"] == pytest.approx(climbs, abs=2e-3)
    ends = body["ends"]
    assert ends["rise_m"] == pytest.approx(0.6, abs=1e-3)
    assert ends["sigma_rise_m"] == pytest.approx(0.02 * math.sqrt(2), abs=1e-3)
    assert ends["slope_deg"] == pytest.approx(math.degrees(math.atan(0.1)), abs=0.01)
    assert ends["azimuth_deg"] == 90.0
    assert body["layers"][0]["digest"] == ref_of(world, ProductKind.DTM).digest


def test_an_end_without_elevation_has_no_rise(client):
    assert request(client, "measure-line", line=[[-39, 0], [0, 0]])["ends"] is None
    assert request(client, "measure-line", line=[[0, 0], [5, 5], [0, 0]])["ends"] is None


def test_the_true_azimuth_refers_to_the_meridian():
    landing = LandingPoint("far south", 10.0, -60.0, 3.39e6, "a test")
    assert true_azimuth(np.array([[0.0, 0.0], [3.0, 4.0]]), landing) == pytest.approx(
        math.degrees(math.atan2(3, 4)), abs=2e-3
    )
    places = np.array([[8000.0, 0.0], [8000.0, 10.0]])
    longitude = lon_lat(landing, 8000.0, 0.0)[0][0]
    expected = -(longitude - 10.0) * math.sin(math.radians(-60.0))  # convergence of meridians
    assert (true_azimuth(places, landing) + 180) % 360 - 180 == pytest.approx(-expected, abs=0.01)


def test_an_area_is_larger_on_the_slope(client):
    body = request(client, "measure-area", polygon=SQUARE)
    assert body["map_area_m2"] == pytest.approx(100.0)
    assert body["surface_area_m2"] == pytest.approx(100 * math.hypot(1, STEEPNESS), rel=1e-4)
    assert body["perimeter_m"] == pytest.approx(40.0)
    assert body["centre"] == [5.0, 5.0]
    assert body["elevation_mean_m"] == pytest.approx(elevation_at(5, 5), abs=1e-3)
    assert body["measured_share"] == 1.0
    # Every place is known to 2 cm; of the mean, own errors of many places average out.
    assert body["sigma_elevation_min_m"] == pytest.approx(0.02)
    assert 0.0 <= body["sigma_elevation_mean_m"] < 0.02


def test_a_plane_has_no_volume_over_its_rim_and_one_over_a_level(client):
    assert request(client, "volume", polygon=SQUARE)["net_m3"] == pytest.approx(0.0, abs=0.02)
    level = request(
        client, "volume", polygon=SQUARE, base="level", elevation_m=elevation_at(5, 5) - 1
    )
    assert level["net_m3"] == pytest.approx(100.0, abs=0.05)
    assert level["above_m3"] - level["below_m3"] == pytest.approx(level["net_m3"], abs=1e-5)
    assert level["sigma_net_m3"] > 0
    # All but the lower edge of the square is above the base: the ground of either part varies.
    parts = level["sigma_above_m3"], level["sigma_below_m3"]
    assert level["sigma_net_m3"] <= sum(parts) + 1e-6
    assert min(level["sigma_highest_m"], level["sigma_lowest_m"]) >= 0.019
    assert level["sigma_base_slope_deg"] == 0.0
    lowest = request(client, "volume", polygon=SQUARE, base="lowest")
    assert lowest["below_m3"] == pytest.approx(0.0, abs=0.01)
    assert lowest["base_elevation_m"] == pytest.approx(elevation_at(0, 0), abs=0.01)


def test_a_polygon_and_points_of_the_slope_give_its_strike_and_dip(client):
    for question in ({"polygon": SQUARE}, {"points": [[0, 0], [9, 1], [2, 8], [7, 7]]}):
        body = request(client, "plane-fit", **question)
        assert body["dip_deg"] == pytest.approx(math.degrees(math.atan(STEEPNESS)), abs=0.05)
        downhill = math.degrees(math.atan2(-0.1, -0.05)) % 360
        assert body["dip_direction_deg"] == pytest.approx(downhill, abs=0.5)
        assert (body["dip_direction_deg"] - body["strike_deg"]) % 360 == pytest.approx(90, abs=0.01)
        assert body["sigma_dip_deg"] > 0
        assert len(body["layers"]) == 1


def test_points_with_their_own_elevation_need_no_ground(client):
    points = [[0, 0, 1.0], [10, 0, 1.0], [10, 10, 1.0], [0, 10, 1.001]]
    body = request(client, "plane-fit", points=points, sigma_m=0.01)
    assert body["strike_deg"] is None
    assert "level within its uncertainty" in body["said_of_strike"]
    assert body["layers"] == []


def test_statistics_of_a_layer_over_a_polygon(client):
    body = request(client, "zonal", polygon=SQUARE, layer=f"{STOP.name}/dtm")
    assert body["unit"] == "m"
    assert body["mean"] == pytest.approx(elevation_at(5, 5), abs=2e-3)
    assert body["percentiles"]["50"] == pytest.approx(elevation_at(5, 5), abs=0.02)
    assert body["count"] == pytest.approx(100 / 0.0064, rel=0.02)
    assert body["max"] == pytest.approx(elevation_at(10, 10), abs=0.02)
    aspect = request(client, "zonal", polygon=SQUARE, layer=f"{STOP.name}/aspect")
    assert aspect["is_direction"]
    assert aspect["mean"] == pytest.approx(90.0, abs=0.01)


def test_classes_inside_a_polygon_have_their_areas(client):
    box = [[0, -5], [10, -5], [10, 5], [0, 5]]
    body = request(client, "zonal", polygon=box, layer=f"{STOP.name}/hazard")
    areas = {row["name"]: row["area_m2"] for row in body["classes"]}
    assert areas == pytest.approx({"traversable": 50.0, "too steep": 50.0}, rel=0.03)
    assert body["mean"] is None


def test_a_polygon_outside_the_layer_is_empty(client):
    far = [[1000, 1000], [1010, 1000], [1010, 1010]]
    body = request(client, "zonal", polygon=far, layer=f"{STOP.name}/dtm")
    assert (body["count"], body["mean"]) == (0, None)


@pytest.mark.parametrize(
    ("what", "question", "reported"),
    [
        ("volume", {"polygon": [[0, 0], [10, 10], [10, 0], [0, 10]]}, "crossing"),
        ("volume", {"polygon": SQUARE, "base": "level"}, "elevation_m"),
        ("volume", {"polygon": [[-40, 0], [-31, 0], [-31, 9]]}, "rim"),
        ("volume", {"polygon": SQUARE, "base": "bottom"}, "rim"),
        ("measure-area", {"polygon": [[0, 0], [1, 1]]}, "at least 3"),
        ("measure-area", {"polygon": [[0, 0], [1, 1], [2, 2]]}, "crossing"),
        ("measure-area", {"polygon": [[0, 0], [1e-5, 0], [0, 1e-5]]}, "larger"),
        ("plane-fit", {}, "one of them"),
        ("plane-fit", {"points": [[0, 0], [1, 0], [2, 0]]}, "line"),
        ("plane-fit", {"points": [[-39, 0], [-39, 1], [-38, 0]]}, "3 points"),
        ("zonal", {"polygon": SQUARE, "layer": "nothing"}, "not a layer"),
        ("zonal", {"polygon": SQUARE, "layer": "mer2/stops"}, "not a raster"),
        ("measure-line", {"line": [[0, 0], [3000, 0]], "step_m": 0.001}, "stations"),
    ],
)
def test_unmeasurable_shapes_are_refused_with_the_reason(client, what, question, reported):
    answer = client.post(f"{API}/{what}", json=question)
    assert answer.status_code == 422
    assert reported in answer.text


def test_an_enormous_polygon_is_answered(client):
    huge = [[-1e6, -1e6], [1e6, -1e6], [1e6, 1e6], [-1e6, 1e6]]
    body = request(client, "measure-area", polygon=huge)
    assert body["map_area_m2"] == pytest.approx(4e12)
    assert client.post(f"{API}/volume", json={"polygon": huge}).status_code == 422


def test_identify_lists_every_band_of_every_layer(client):
    place = client.get(f"{API}/identify", params={"east": 3, "north": 4}).json()
    layers = {layer["id"]: layer for layer in place["layers"]}
    dtm = layers[f"{STOP.name}/dtm"]["bands"]
    assert dtm["elevation"] == pytest.approx(elevation_at(3, 4), abs=0.01)
    assert dtm["standard_deviation"] == pytest.approx(0.02)
    assert dtm["observations"] == 3.0
    assert layers[f"{STOP.name}/slope"]["bands"] == {"value": 20.0}


@pytest.mark.parametrize("question", ["measure-line", "profile", "profile.csv", "measure-area"])
def test_nearly_identical_places_are_not_a_line(client, question):
    near = [[5e-324, 0.0], [0.0, 0.0], [0.0, 1e-9]]
    requested = {"polygon": near} if question == "measure-area" else {"line": near}
    assert client.post(f"{API}/{question}", json=requested).status_code == 422


def test_a_nearly_closed_line_has_no_ends(client):
    line = [[0.0, 0.0], [3.0, 0.0], [5e-324, 0.0]]
    body = client.post(f"{API}/measure-line", json={"line": line}).json()
    assert body["map_length_m"] == 6.0
    assert body["ends"] is None


def here(kind, value, sigma=None, **bands):
    fixed = {"id": kind, "scope": "a", "title": "", "unit": None, "cell_m": None, "label": None}
    return ValueHere(kind=kind, value=value, sigma=sigma, bands=bands, **fixed)


def test_aspect_and_northerly_tilt_have_the_standard_deviation_of_the_gradient(rng):
    east, north = rng.normal([[0.2], [0.1]], 0.004, (2, 100_000))
    slope = np.degrees(np.arctan(np.hypot(east, north)))
    values = {
        "aspect": np.degrees(np.arctan2(east, north)),
        "northerly-tilt": np.degrees(np.arctan(north)),
    }
    known = here("slope", slope.mean(), slope.std())
    for kind, all_values in values.items():
        derived = derived_sigma(here(kind, all_values.mean()), [known])
        assert derived == pytest.approx(all_values.std(), rel=0.02)  # of 100,000 draws: 0.2 %
    assert derived_sigma(here("aspect", 60.0), []) is None


def test_a_difference_of_stops_has_the_standard_deviation_that_it_was_divided_by():
    assert derived_sigma(here("region-seams", 0.006, disagreement_in_sigmas=0.4), []) == 0.015
