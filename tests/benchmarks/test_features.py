"""Requests for features of a mission of 500 stops, 10,000 images and 150,000 tie points.

The time is that of the server's own work, in the process of the test: routing, the index, GeoJSON
and its compression. `make bench` prints it; docs/reference/measurements/server.md keeps it.
"""

from __future__ import annotations

import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.products.catalogue.workspace import Workspace
from solmap.products.features.mission_features import MissionFeatures
from solmap.products.model import ProductKind
from tests.support.large_mission import write_mission

BOX = "175.50,-14.55,175.52,-14.53"
REQUESTS = {
    "collections": "/collections",
    "first page of 100 tie points": "/collections/tie-points/items",
    "1000 tie points": "/collections/tie-points/items?limit=1000",
    "1000 tie points, the last ones": "/collections/tie-points/items?limit=1000&offset=149000",
    "1000 tie points in a box": f"/collections/tie-points/items?limit=1000&bbox={BOX}",
    "1000 tie points of ten sols": "/collections/tie-points/items?limit=1000&sol=200/209",
    "1000 tie points of a month": "/collections/tie-points/items?limit=1000"
    "&datetime=2004-06-11T00:00:00Z/2004-07-11T00:00:00Z",
    "1000 images": "/collections/images/items?limit=1000",
    "1000 footprints in a box": f"/collections/footprints/items?limit=1000&bbox={BOX}",
    "500 contours in a box, of 500 stops": f"/collections/contours/items?limit=500&bbox={BOX}",
    "500 stops": "/collections/stops/items?limit=1000",
    "one tie point": "/collections/tie-points/items/77777",
}


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    root = tmp_path_factory.mktemp("mission") / "store"
    write_mission(root)
    workspace = Workspace.open(root)
    MissionFeatures.open(workspace.store, workspace.catalogue).fill("MER2", set(ProductKind))
    with TestClient(create_app(root)) as opened:
        yield opened


@pytest.mark.parametrize("request_of", REQUESTS)
def test_a_request_for_features_of_a_long_mission(client, benchmark, request_of):
    path = f"/ogc/MER2{REQUESTS[request_of]}"
    answer = benchmark.pedantic(client.get, args=(path,), rounds=9, warmup_rounds=1)
    assert answer.status_code == 200
    benchmark.extra_info["kB"] = round(len(answer.content) / 1e3)
    if "items?" in path:
        assert answer.json()["numberReturned"] > 0
