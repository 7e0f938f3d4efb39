"""What grows with the mission is read when the server starts, and before pages hear of it."""

from __future__ import annotations

import time

import numpy as np
import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.gis_server.services import ReadAhead
from solmap.products.catalogue.events import LAYERS_PUBLISHED, RUN_CHANGED, Event
from solmap.products.features import texts as feature_texts
from solmap.products.formats.vector.geojson import Feature
from solmap.products.model import ProductKind

SQUARE = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])


@pytest.fixture
def reads(monkeypatch):
    """Files that are read, in order."""
    paths, read_placed = [], feature_texts.read_placed
    monkeypatch.setattr(
        feature_texts, "read_placed", lambda path: paths.append(path) or read_placed(path)
    )
    return paths


def test_the_server_reads_networks_ahead_at_its_start(own_world, reads):
    layer = own_world.catalogue.layer("mer2", ProductKind.FOOTPRINTS)
    path = own_world.store.path(layer.ref)
    with TestClient(create_app(own_world.root)) as client:
        ends = time.monotonic() + 60
        while not reads and time.monotonic() < ends:
            time.sleep(0.01)
        place = f"/api/layers/mer2/footprints/{layer.ref.digest}/features.geojson"
        assert len(client.get(place).json()["features"]) == 2
    assert reads == [path]


def test_a_new_version_is_read_when_it_is_published(own_world, reads):
    ahead = ReadAhead(own_world.store, own_world.catalogue)
    one = own_world.publish_features(
        ProductKind.FOOTPRINTS, [Feature("Polygon", SQUARE, {}, "A")], version=1
    )
    ahead.on_events([Event(1, RUN_CHANGED, {}, "2026-01-01")])
    assert reads == []
    for _ in range(2):
        ahead.on_events([Event(2, LAYERS_PUBLISHED, {}, "2026-01-01")])
    assert reads == [own_world.store.path(one.ref)]


LANDING = '{"name":"x","longitude":0,"latitude":0,"radius_m":3.39e6,"source":"x"}'
RING = '{"geometry":{"type":"LineString","coordinates":[]}}'


@pytest.mark.parametrize(
    "text",
    ["{", '{"solmap":[]}', f'{{"solmap":{{"landing":{LANDING}}},"features":[{RING}]}}'],
)
def test_an_unreadable_product_is_left_to_the_request(own_world, caplog, text):
    layer = own_world.publish_features(
        ProductKind.FOOTPRINTS, [Feature("Polygon", SQUARE, {}, "A")], version=2
    )
    own_world.store.path(layer.ref).write_text(text)
    ReadAhead(own_world.store, own_world.catalogue).read()
    assert "layers were not read ahead" in caplog.text
