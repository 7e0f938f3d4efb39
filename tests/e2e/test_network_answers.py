"""Answers of the server about the adjusted network of a synthetic downlink."""

import numpy as np
import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.products.catalogue.oriented_images import OrientedMission

MISSION = "/api/missions/MER2"


@pytest.fixture(scope="module")
def client(mapped):
    with TestClient(create_app(mapped.store)) as opened:
        yield opened


def request(client, path, **query):
    answer = client.get(MISSION + path, params=query)
    assert answer.status_code == 200, answer.text
    return answer.json()


@pytest.fixture(scope="module")
def oriented(mapped):
    return OrientedMission.latest("MER2", mapped.workspace)


def test_every_adjustment_is_listed_and_one_is_published(client, oriented):
    listed = request(client, "/solutions")
    assert [one["digest"] for one in listed if one["is_latest"]] == [oriented.ref.digest]
    assert [one["sol"] for one in listed] == sorted((one["sol"] for one in listed), reverse=True)


def test_differences_from_telemetry_accumulate_along_both_traverses(client, oriented):
    found = request(client, "/traverse")
    adjusted = oriented.network.adjusted.stops
    places = np.array([MAP_FROM_LSL @ stop.lsl_from_rover.translation_m for stop in adjusted])
    reported = np.array(
        [MAP_FROM_LSL @ oriented.network.telemetry[s.stop].translation_m for s in adjusted]
    )
    off = (reported - reported[0]) - (places - places[0])
    driven = np.hypot(*np.diff(places[:, :2], axis=0).T).cumsum()
    last = found["rows"][found["end"]]
    assert last["distance_m"] == pytest.approx(driven[-1], abs=1e-4)
    assert last["horizontal_m"] == pytest.approx(np.hypot(*off[-1, :2]), abs=1e-4)
    assert last["percent"] == pytest.approx(100 * last["horizontal_m"] / driven[-1], abs=1e-2)
    assert found["rows"][0]["percent"] is None
    assert last["horizontal_m"] > 0.01  # the world's wheels slip


def test_a_solution_has_no_difference_from_itself(client):
    (latest,) = (one for one in request(client, "/solutions") if one["is_latest"])
    found = request(client, "/traverse", solution="latest", reference=latest["id"])
    assert found["solution"] == found["reference"] == latest["id"]
    assert {row["horizontal_m"] for row in found["rows"]} == {0.0}
    assert found["rows"][-1]["reference_sigma_up_m"] == found["rows"][-1]["sigma_up_m"]


@pytest.mark.parametrize(
    ("query", "status"),
    [
        ({"solution": "mer2-sol0155/0123456789abcdef"}, 404),
        ({"solution": "../../etc/passwd"}, 422),
        ({"reference": "msl-sol0001/0123456789abcdef"}, 404),
    ],
)
def test_an_unknown_solution_is_refused(client, query, status):
    answer = client.get(f"{MISSION}/traverse", params=query)
    assert answer.status_code == status
    if status == 404:
        assert "/solutions lists them" in answer.text


def test_the_graph_counts_the_shared_points_of_stops(client, oriented):
    graph = request(client, "/network")
    ties = oriented.network.adjusted.ties
    stop_of = {pair.pair_id: str(pair.stop) for pair in oriented.network.adjusted.pairs}
    seen: dict[int, set[str]] = {}
    for point, pair, status in zip(
        ties.observations.point.tolist(), ties.observations.pair.tolist(), ties.status, strict=True
    ):
        if status == 0:
            seen.setdefault(point, set()).add(stop_of[ties.observations.pair_ids[pair]])
    (link,) = graph["links"]
    both = {link["one"], link["other"]}
    assert link["ties"] == sum(both <= stops for stops in seen.values()) > 0
    assert {stop["stop"] for stop in graph["stops"]} == both


def test_couples_of_pairs_have_as_many_ties_as_shared_points(client):
    stop = request(client, "/network")["stops"][0]["stop"]
    graph = request(client, "/network/pairs", stop=stop)
    names = {pair["id"] for pair in graph["pairs"]}
    assert all({edge["one"], edge["other"]} <= names for edge in graph["edges"])
    own = next(pair for pair in graph["pairs"] if pair["stop"] == stop)
    shared = sum(edge["ties"] for edge in graph["edges"] if own["id"] in edge.values())
    assert shared >= own["ties"] > 0  # a point of three pairs counts in two edges
    assert client.get(f"{MISSION}/network/pairs", params={"stop": "mer2-x"}).status_code == 404


@pytest.mark.parametrize("eye", ["left", "right"])
def test_a_tie_minus_its_residual_is_the_projection_of_its_point(client, oriented, eye):
    entries = oriented.workspace.catalogue.images("MER2")
    entry = next(one for one in entries if one.eye == eye and one.partner)
    ties = request(client, f"/images/{entry.id}/ties")["ties"]
    used = [tie for tie in ties if tie["status"] == "used" and tie["place"]]
    assert len(used) > 10
    camera = oriented.oriented_image(entry).camera
    shown = camera.project(np.array([tie["place"] for tie in used]) @ MAP_FROM_LSL)
    computed = [
        (tie["sample"] - tie["residual_sample_px"], tie["line"] - tie["residual_line_px"])
        for tie in used
    ]
    # Places are sent to 0.1 mm, which is a tenth of a pixel at the nearest ground.
    np.testing.assert_allclose(computed, shown, atol=0.15)
    assert np.median(np.abs(np.subtract(computed, shown))) < 0.02
