import csv
import io
import math

import numpy as np
import pytest

from solmap.products.model import ProductKind
from tests.unit.gis_server.conftest import CELL_M, STOP, elevation_at, ref_of

URL = "/api/missions/MER2/profile"


def test_a_profile_over_a_plane_is_a_straight_line(client, world):
    body = client.post(URL, json={"line": [[-20, -10], [20, 20]]}).json()
    assert body["length_m"] == pytest.approx(50.0)
    distance, heights = np.array(body["distance_m"]), np.array(body["elevation_m"])
    expected = elevation_at(-20 + 0.8 * distance, -10 + 0.6 * distance)
    assert np.abs(heights - expected).max() < 2e-3
    assert set(body["sigma_m"]) == {0.02}
    slopes = np.array(body["slope_deg"], dtype=float)
    assert slopes[10:-10] == pytest.approx(math.degrees(math.atan(0.08 + 0.03)), abs=0.02)
    (layer,) = body["layers"]
    assert layer["digest"] == ref_of(world, ProductKind.DTM).digest
    assert set(body["source"]) == {0}
    assert body["step_m"] <= max(CELL_M, 50 / 1000) + 1e-9


def test_unmeasured_ground_is_a_gap(client):
    body = client.post(URL, json={"line": [[-39, 0], [-20, 0]], "step_m": 0.1}).json()
    known = np.array([height is not None for height in body["elevation_m"]])
    east = np.array(body["east"])
    assert known[east > -29.9].all()
    assert not known[east < -30.1].any()
    assert [k is None for k in body["source"]] == (~known).tolist()
    assert body["slope_deg"][0] is None


def test_the_table_holds_the_same(client):
    question = {"line": [[-31, 0], [-29, 0]], "step_m": 0.5}
    body = client.post(URL, json=question).json()
    answer = client.post(f"{URL}.csv", json=question)
    assert answer.headers["content-type"].startswith("text/csv")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert [row["elevation_m"] for row in rows] == [
        "" if height is None else str(height) for height in body["elevation_m"]
    ]
    assert rows[-1]["layer"] == f"{STOP.name}/dtm"
    assert rows[0]["layer"] == ""


@pytest.mark.parametrize(
    ("question", "reported"),
    [
        ({"line": [[0, 0]]}, "at least 2"),
        ({"line": [[0, 0], [0, 0]]}, "two different points"),
        ({"line": [[0, 0], [1e9, 0]]}, "less than or equal"),
        ({"line": [[0, 0], [1e6, 0]], "step_m": 0.01}, "stations"),
        ({"line": [[0, 0], [1, 0]], "step_m": -1}, "greater than 0"),
        ({"line": [[0, 0], [1, 0]], "layer": "../../etc/passwd"}, "is not a terrain model"),
        ({"line": [[0, 0], [1, 0]], "layer": f"{STOP.name}/slope"}, "is not a terrain model"),
        ({"line": [[0, 0], [1, 0]], "slope_baseline_m": 0}, "greater than 0"),
        ({"line": [[0, 0], [1, 0]], "stepp": 1}, "not permitted"),
        ({"line": [[0, 0]] * 5000}, "at most 1000"),
    ],
)
def test_unanswerable_profiles_are_refused_with_the_reason(client, question, reported):
    answer = client.post(URL, json=question)
    assert answer.status_code == 422
    assert reported in answer.text


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_invalid_numbers_are_refused(client, number):
    text = f'{{"line": [[0, 0], [{number}, 1]]}}'
    answer = client.post(URL, content=text, headers={"content-type": "application/json"})
    assert answer.status_code == 422
    assert "finite" in answer.text


def test_an_unknown_mission_has_no_profile(client):
    assert (
        client.post("/api/missions/XYZ/profile", json={"line": [[0, 0], [1, 1]]}).status_code == 404
    )
