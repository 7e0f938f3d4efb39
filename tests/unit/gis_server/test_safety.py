"""What other sites, odd names and odd texts cannot do."""

from __future__ import annotations

import json

import numpy as np
import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.products.catalogue.edits import EditLog
from solmap.products.catalogue.tokens import Role, Tokens
from solmap.products.formats.vector.geojson import Feature
from solmap.products.model import ProductKind
from tests.unit.gis_server.conftest import ref_of

NOTE = {"geometry": {"type": "Point", "coordinates": [1.0, 2.0]}, "text": "a rock"}
ADDRESS = "/api/missions/MER2/edits/annotations"
SCRIPT = "<script>alert(1)</script>"


@pytest.fixture
def token(own_world):
    return Tokens.of(own_world.root).add("Ada", Role.ANALYST)[1]


@pytest.fixture
def client(own_world):
    with TestClient(create_app(own_world.root)) as opened:
        yield opened


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", None])
def test_a_form_of_another_site_writes_nothing(client, own_world, token, kind):
    """Such a form sends neither JSON nor the header with the token."""
    sent = {"Origin": "https://evil.example"} | ({"Content-Type": kind} if kind else {})
    body = json.dumps(NOTE)
    assert client.post(ADDRESS, content=body, headers=sent).status_code == 401
    shown = sent | {"Authorization": f"Bearer {token}"}
    assert client.post(ADDRESS, content=body, headers=shown).status_code == 422
    assert not EditLog.of(own_world.root).edits("MER2")


@pytest.mark.parametrize("place", ["query", "cookie", "basic"])
def test_a_token_counts_only_in_its_header(client, token, place):
    address, headers = ADDRESS, {}
    if place == "query":
        address = f"{ADDRESS}?token={token}&access_token={token}"
    elif place == "cookie":
        headers = {"Cookie": f"token={token}; Authorization=Bearer {token}"}
    else:
        headers = {"Authorization": f"Basic {token}"}
    assert client.post(address, json=NOTE, headers=headers).status_code == 401


def test_another_site_may_not_send_a_token(client):
    requested = {
        "Origin": "https://evil.example",
        "Access-Control-Request-Method": "POST",
        "Access-Control-Request-Headers": "authorization,content-type",
    }
    answer = client.options(ADDRESS, headers=requested)
    assert answer.status_code == 405
    assert not [name for name in answer.headers if name.startswith("access-control")]


@pytest.mark.parametrize("name", ['a"b', "%0d%0aX-Evil:%201", "ä", "..%2f.."])
def test_unusual_names_do_not_reach_headers(client, own_world, name):
    digest = ref_of(own_world, ProductKind.DTM).digest
    for address in (
        f"/download/{name}/dtm/{digest}",
        f"/download/{name}/dtm/{digest}/clip?bbox=0,0,1,1",
        f"/models/{name}/dtm/{digest}/terrain.stl",
        f"/ogc/{name}/collections/stops/items?f=csv",
        f"/images/{name}/original",
    ):
        answer = client.get(address)
        assert answer.status_code in {404, 422}, address
        assert "x-evil" not in answer.headers


def test_texts_of_features_are_neither_scripts_nor_formulas(own_world):
    texts = {"name": SCRIPT, "note": "=HYPERLINK(1)"}
    haven = Feature("Polygon", np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), texts, "a")
    own_world.publish_features(ProductKind.HAVENS, [haven], version=2)
    with TestClient(create_app(own_world.root)) as client:
        items = "/ogc/MER2/collections/havens/items"
        page = client.get(items, params={"f": "html"}).text
        table = client.get(items, params={"f": "csv"}).text
    assert SCRIPT not in page
    assert "&lt;script&gt;" in page
    assert "'=HYPERLINK(1)" in table
