import math

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.io import MemoryFile

from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.products.formats.raster.raster import write_dtm
from solmap.products.model import ProductKind
from tests.unit.gis_server.conftest import CRS, GRID, STOP, elevation_at, image_in, plane

API = "/api/missions/MER2"


def walled() -> Dtm:
    """The plane with a wall of 3 m along north = 10."""
    surface = plane()
    _, north = GRID.centres()
    surface[np.abs(north - 10.0) < 0.3] += 3.0
    ones = np.ones(GRID.shape, np.float32)
    return Dtm(GRID, surface, 0.02 * ones, ones, ones.astype(np.uint8))


@pytest.fixture
def walls(own_world):
    from fastapi.testclient import TestClient  # noqa: PLC0415

    from solmap.gis_server.app import create_app  # noqa: PLC0415

    own_world.publish_raster(
        ProductKind.DTM, STOP, lambda path: write_dtm(path, walled(), CRS), version=2
    )
    with TestClient(create_app(own_world.root)) as opened:
        yield opened


def request(client, what, **query):
    answer = client.get(f"{API}/{what}", params=query)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_all_of_a_plane_is_visible(client):
    body = request(client, "viewshed", east=10, north=0, radius_m=15)
    assert body["visible_m2"] == pytest.approx(math.pi * 15**2, rel=0.01)
    assert body["hidden_m2"] == 0
    assert body["eye_elevation_m"] == pytest.approx(elevation_at(10, 0) + 1.5, abs=0.01)
    (patch,) = body["polygons"]["features"]
    assert patch["properties"]["area_m2"] == pytest.approx(body["visible_m2"], rel=0.01)
    assert body["layers"][0]["kind"] == "dtm"


def test_a_wall_hides_the_ground_behind_it(walls):
    body = request(walls, "viewshed", east=10, north=0, radius_m=20)
    half_disc_beyond = 20**2 * math.acos(0.5) - 10 * math.sqrt(300)
    assert body["hidden_m2"] == pytest.approx(half_disc_beyond, rel=0.05)
    png = image_in(walls.get(body["picture"]).content)
    west, south, east, north = body["bounds"]
    assert png.shape[:2] == (
        round((north - south) / body["cell_m"]),
        round((east - west) / body["cell_m"]),
    )

    def alpha_and_colour(at_east, at_north):
        row, col = (north - at_north) / body["cell_m"], (at_east - west) / body["cell_m"]
        return png[int(row), int(col)].tolist()

    assert alpha_and_colour(10, 5) == [0x77, 0xAA, 0xDD, 0xA0]
    assert alpha_and_colour(10, 15) == [0x66, 0x44, 0x22, 0xA0]
    assert alpha_and_colour(10, 25)[3] == 0
    with MemoryFile(walls.get(body["geotiff"]).content) as file, file.open() as dataset:
        values = [v[0] for v in dataset.sample([(10, 5), (10, 15)])]
        assert values == [1, 2]
        assert rasterio.crs.CRS.from_wkt(dataset.crs.to_wkt()).is_projected


def test_unmapped_ground_is_unknown(client):
    body = request(client, "viewshed", east=-25, north=0, radius_m=12)
    assert body["unknown_m2"] > 50
    total = body["visible_m2"] + body["hidden_m2"] + body["unknown_m2"]
    assert total == pytest.approx(math.pi * 144, rel=0.01)


def test_a_large_radius_is_answered_on_larger_cells(client):
    body = request(client, "viewshed", east=0, north=0, radius_m=2000)
    assert body["cell_m"] > 1
    assert body["visible_m2"] > 1000


def test_a_line_of_sight_is_free_over_a_plane_and_blocked_by_a_wall(client, walls):
    query = {"east": 10, "north": 0, "to_east": 10, "to_north": 18}
    free = request(client, "line-of-sight", **query)
    assert free["sight"] == "visible"
    assert free["obstruction"] is None
    assert free["clearance_m"] == pytest.approx(0.1, abs=0.05)
    blocked = request(walls, "line-of-sight", **query)
    assert blocked["sight"] == "hidden"
    assert blocked["obstruction"][1] == pytest.approx(10.0, abs=0.4)
    assert blocked["clearance_m"] < -2
    assert len(blocked["distance_m"]) == len(blocked["ground_m"]) == len(blocked["line_m"])
    high = request(walls, "line-of-sight", **query, eye_m=8, target_m=8)
    assert high["sight"] == "visible"


def test_an_end_on_unmapped_ground_takes_an_elevation(client):
    query = {"east": 0, "north": 0, "to_east": -33, "to_north": 0, "to_elevation": 2.0}
    body = request(client, "line-of-sight", **query)
    assert body["target_elevation_m"] == pytest.approx(2.1)
    assert body["unseen_m"] == pytest.approx(3.0, abs=0.1)
    assert (
        request(client, "viewshed", east=-39, north=0, elevation=4, radius_m=5)["visible_m2"] == 0
    )


@pytest.mark.parametrize(
    ("what", "query", "reported"),
    [
        ("viewshed", {"east": -39, "north": 0}, "no elevation"),
        ("viewshed", {"east": 0, "north": 0, "radius_m": 1e7}, "2000"),
        ("viewshed", {"east": 0, "north": 0, "radius_m": "nan"}, "2000"),
        ("viewshed.png", {"east": 0, "north": 0, "mast_m": -1}, "greater than or equal"),
        ("line-of-sight", {"east": 0, "north": 0, "to_east": 0, "to_north": 0}, "longer"),
        ("line-of-sight", {"east": 0, "north": 0, "to_east": -39, "to_north": 0}, "no elevation"),
        ("line-of-sight", {"east": 0, "north": 0}, "required"),
    ],
)
def test_invalid_sight_queries_are_refused_with_the_reason(client, what, query, reported):
    answer = client.get(f"{API}/{what}", params=query)
    assert answer.status_code == 422
    assert reported in answer.text


def test_the_viewshed_image_is_a_png(client):
    body = client.get(f"{API}/viewshed.png", params={"east": 0, "north": 0, "radius_m": 5}).content
    assert cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED).shape[2] == 4
