"""Isochrones and ways on ground that is safe in the south and steep in the north."""

import math

import numpy as np
import pytest
from rasterio.io import MemoryFile
from shapely.geometry import shape

from solmap.products.model import ProductKind
from tests.unit.gis_server.conftest import image_in

API = "/api/missions/MER2"


def request(client, what, **query):
    answer = client.get(f"{API}/{what}", params=query)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_the_reachable_area_is_half_a_disc_south_of_the_slope(client):
    body = request(client, "reach", east=10, north=-1, farthest_m=15, interval_m=5)
    assert body["reached_m2"] == pytest.approx(math.pi * 15**2 / 2 + 15 * 2 - 1, rel=0.04)
    assert 14.8 < body["longest_drive_m"] <= 15
    assert body["longest_drive_h"] == pytest.approx(body["longest_drive_m"] / 36, abs=1e-3)
    rings = body["isochrones"]["features"]
    assert {f["properties"]["drive_m"] for f in rings} == {5, 10, 15}
    assert rings[0]["properties"]["drive_h"] == pytest.approx(5 / 36, abs=1e-4)
    area = sum(shape(f["geometry"]).area for f in rings)
    assert area == pytest.approx(body["reached_m2"], rel=1e-3)
    assert {layer["kind"] for layer in body["layers"]} == {"hazard", "dtm"}


def test_image_and_geotiff_agree(client):
    body = request(client, "reach", east=10, north=-10, farthest_m=15, interval_m=5)
    west, south, _, north = body["bounds"]

    def pixel(drawn, at_east, at_north):
        return drawn[
            int((north - at_north) / body["cell_m"]), int((at_east - west) / body["cell_m"])
        ]

    drawn = image_in(client.get(body["picture"]).content)
    assert drawn.shape[0] == round((north - south) / body["cell_m"])
    assert pixel(drawn, 10, 5)[3] == 0
    near, far = pixel(drawn, 12, -10), pixel(drawn, 23, -10)
    assert near[3] == far[3] == 0xA0
    assert near.tolist() != far.tolist()
    with MemoryFile(client.get(body["geotiff"]).content) as file, file.open() as dataset:
        (metres,) = next(dataset.sample([(18, -10)]))
        assert metres == pytest.approx(8 * math.hypot(1, 0.1), abs=0.15)
        (nothing,) = next(dataset.sample([(10, 5)]))
        assert np.isnan(nothing)
        assert dataset.crs.is_projected


def test_a_route_has_its_length_and_climb(client):
    body = request(client, "route", east=0.04, north=-10, to_east=20, to_north=-10)
    assert body["drive_m"] == pytest.approx(20 * math.hypot(1, 0.1), abs=0.1)
    assert body["straight_m"] == pytest.approx(20, abs=0.1)
    assert body["climb_m"] == pytest.approx(2.0, abs=0.05)
    assert body["descent_m"] == pytest.approx(0.0, abs=0.05)
    assert body["places"][0] == pytest.approx([0, -10], abs=0.12)
    assert body["places"][-1] == pytest.approx([20, -10], abs=0.12)
    assert len(body["places"]) == len(body["distance_m"]) == len(body["ground_m"])


@pytest.mark.parametrize(
    ("what", "query", "message"),
    [
        ("route", {"to_east": 10, "to_north": 20}, "no path free of hazards"),
        ("route", {"to_east": 900, "to_north": 20}, "no path free of hazards"),
        ("reach", {"north": 20}, "is a hazard"),
    ],
)
def test_an_impossible_route_is_answered_with_the_reason(client, what, query, message):
    answer = client.get(f"{API}/{what}", params={"east": 10, "north": -5, **query})
    assert answer.status_code == 422
    assert message in answer.text


def test_a_long_route_is_searched_on_larger_cells(client):
    body = request(client, "reach", east=10, north=-5, farthest_m=500, interval_m=0.1)
    assert body["cell_m"] > 0.16
    assert body["interval_m"] == 10
    assert body["reached_m2"] > 1000


def test_missing_hazard_maps_are_reported(own_world):
    from fastapi.testclient import TestClient  # noqa: PLC0415

    from solmap.gis_server.app import create_app  # noqa: PLC0415

    hazards = [
        layer
        for layer in own_world.catalogue.layers()
        if layer.ref.kind in {ProductKind.HAZARD, ProductKind.REGION_HAZARD}
    ]
    own_world.catalogue.withdraw(hazards)
    with TestClient(create_app(own_world.root)) as client:
        answer = client.get(f"{API}/reach", params={"east": 10, "north": -5})
    assert answer.status_code == 422
    assert "no hazard maps" in answer.text
