"""Stops and cameras in the 3D scene, compared with a network made by hand."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.photogrammetry.archive.tables.vector_files import Solution, VectorFile, vector_text
from solmap.photogrammetry.frames import FrameKind
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.synthetic.rig import CAMERAS, Instrument
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.products.catalogue.catalogue import MissionEntry, latest_network
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.network import cached_whole_network
from solmap.products.model import ProductKind, Recipe, Scope, ScopeLevel, mission_of
from tests.support.bowl_store import LANDING, STOPS
from tests.support.scene_store import (
    LAST,
    POINTING,
    SEMI_AXES_M,
    exposure,
    fill_network,
    heading,
    lsl_from_rover,
    place_of,
)

ROUNDED_M = 6e-5
"""Positions are given to a tenth of a millimetre."""


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    root: Path = tmp_path_factory.mktemp("scene")
    fill_network(Workspace.open(root))
    with TestClient(create_app(root)) as client:
        yield client


def test_the_graph_marks_stops_held_by_telemetry_alone(client):
    answer = client.get("/api/missions/MER2/network")
    assert answer.status_code == 200
    graph = answer.json()
    assert [stop["stop"] for stop in graph["stops"]] == [name for name, *_ in STOPS]
    assert graph["adjustment"]["redundancy"] == 0
    assert set(graph["adjustment"]["ties"].values()) <= {0}
    assert graph["links"] == []


def test_stops_have_the_poses_of_the_network(client):
    answer = client.get("/api/missions/MER2/scene/stops").json()
    assert [stop["stop"] for stop in answer["stops"]] == [name for name, *_ in STOPS]
    for index, stop in enumerate(answer["stops"]):
        np.testing.assert_allclose(stop["place"], place_of(index), atol=ROUNDED_M)
        east, north = STOPS[index][4]
        np.testing.assert_allclose(stop["telemetry"][:2], (east, north), atol=ROUNDED_M)
        ahead = np.array(stop["map_from_rover"]) @ [1.0, 0.0, 0.0]
        expected = math.sin(heading(index)), math.cos(heading(index)), 0.0
        np.testing.assert_allclose(ahead, expected, atol=1e-8)
        assert stop["held"] == (index == 0)
    assert answer["body"]["half_width_m"] == 1.15  # Spirit's panels span 2.3 m


def test_the_ellipsoid_has_the_standard_deviations_as_semi_axes(client):
    first, second, _ = client.get("/api/missions/MER2/scene/stops").json()["stops"]
    assert first["ellipsoid"]["semi_axes_m"] == [0.0, 0.0, 0.0]
    assert second["ellipsoid"]["semi_axes_m"] == list(SEMI_AXES_M)
    # Its largest deviation is to the north, then to the east, then upwards.
    north, east, up = np.abs(second["ellipsoid"]["directions"])
    np.testing.assert_allclose(north, (0, 1, 0), atol=1e-6)
    np.testing.assert_allclose(east, (1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(up, (0, 0, 1), atol=1e-6)


@pytest.mark.parametrize("eye", [Eye.LEFT, Eye.RIGHT])
def test_cameras_have_the_directions_of_labels_and_network(client, eye):
    cameras = client.get(f"/api/missions/MER2/scene/cameras?stop={LAST}").json()["cameras"]
    (reported,) = (camera for camera in cameras if camera["eye"] == str(eye))
    made = exposure(eye)
    # Labels of averaged images are half a pixel off, and their reader puts that right.
    averaged = CAMERAS[Instrument.NAVCAM, eye].in_mast.average(4, 4)
    in_rover = averaged.transform(POINTING.rover_from_mast(made.stop))
    camera = in_rover.transform(lsl_from_rover(len(STOPS) - 1))
    np.testing.assert_allclose(reported["centre"], MAP_FROM_LSL @ camera.centre, atol=2e-4)
    corners = np.array([[-0.5, -0.5], [255.5, -0.5], [255.5, 255.5], [-0.5, 255.5]])
    expected = camera.rays(corners) @ MAP_FROM_LSL.T
    np.testing.assert_allclose(reported["corners"], expected, atol=1e-4)
    assert reported["image"] == made.product_id


def test_a_mission_without_network_has_no_stop_yet(tmp_path):
    Workspace.open(tmp_path).catalogue.publish(
        missions=[MissionEntry("MER1", "Opportunity", LANDING, None)]
    )
    with TestClient(create_app(tmp_path)) as client:
        stops = client.get("/api/missions/MER1/scene/stops").json()
        cameras = client.get("/api/missions/MER1/scene/cameras?stop=mer1-site0001-drive0000").json()
        assert client.get("/api/missions/MSL/scene/stops").status_code == 404
    assert (stops["network"], stops["stops"], stops["body"]) == (None, [], None)
    assert cameras["cameras"] == []


def test_a_network_is_read_once_for_scene_and_images(tmp_path):
    workspace = Workspace.open(tmp_path)
    fill_network(workspace)
    ref = latest_network("MER2", workspace.catalogue)
    oriented = OrientedMission.latest("MER2", workspace)
    assert oriented.network is cached_whole_network(ref, workspace.store)


def _keep(path: Path, text: str) -> None:
    path.write_text(text)


def test_sites_are_at_the_chained_published_site_vectors(tmp_path):
    workspace = Workspace.open(tmp_path)
    fill_network(workspace)
    with TestClient(create_app(tmp_path)) as client:
        assert client.get("/api/missions/MER2/scene/stops").json()["sites"] == []  # two, unchained
    chained = Solution(
        *("telemetry", FrameKind.SITE, (11,), 10), np.array([7.0, 5.0, -1.0]), np.eye(4)[0], ""
    )
    text = vector_text(VectorFile("", mission_of("MER2"), "svf", ("telemetry",), (chained,)))
    recipe = Recipe(ProductKind.SITE_VECTORS, Scope(ScopeLevel.REGION, "mer2"))
    ref = workspace.store.make(recipe, lambda path: _keep(path, text))
    workspace.catalogue.publish(pointers=[ref])
    with TestClient(create_app(tmp_path)) as client:
        first, second = client.get("/api/missions/MER2/scene/stops").json()["sites"]
    assert (first["site"], first["place"]) == (10, [0.0, 0.0, 0.0])  # the LSL is its frame
    assert (second["site"], second["place"]) == (11, [5.0, 7.0, 1.0])
    np.testing.assert_array_equal(second["map_from_site"], MAP_FROM_LSL)
