"""Headers of every answer, and answers to pages of other sites."""

from __future__ import annotations

import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.products.catalogue.workspace import Workspace
from tests.support.bowl_store import fill

ELSEWHERE = "https://maps.example.org"


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("headers") / "store"
    fill(Workspace.open(folder))
    return folder


@pytest.mark.parametrize(
    "path", ["/", "/api/missions", "/api/missions/none/layers", "/metrics", "/docs", "/nothing"]
)
def test_every_answer_has_the_security_headers(root, path):
    with TestClient(create_app(root)) as client:
        head = client.get(path).headers
    assert "frame-ancestors 'none'" in head["content-security-policy"]
    assert "default-src 'self'" in head["content-security-policy"]
    assert "unsafe-eval'" not in head["content-security-policy"].replace("wasm-unsafe-eval'", "")
    assert head["x-content-type-options"] == "nosniff"
    assert head["x-frame-options"] == "DENY"
    assert head["referrer-policy"] == "same-origin"
    assert "geolocation=()" in head["permissions-policy"]
    assert "set-cookie" not in head


def test_no_other_site_is_allowed_unless_it_is_named(root):
    requested = {"Origin": ELSEWHERE}
    with TestClient(create_app(root)) as client:
        assert (
            "access-control-allow-origin"
            not in client.get("/api/missions", headers=requested).headers
        )
    with TestClient(create_app(root, origins=[ELSEWHERE])) as client:
        head = client.get("/api/missions", headers=requested).headers
        assert head["access-control-allow-origin"] == ELSEWHERE
        assert "access-control-allow-credentials" not in head
        other = client.get("/api/missions", headers={"Origin": "https://evil.example"}).headers
        assert "access-control-allow-origin" not in other
        before = {**requested, "Access-Control-Request-Method": "POST"}
        before["Access-Control-Request-Headers"] = "authorization"
        requested_before = client.options("/api/runs", headers=before)
        assert requested_before.status_code == 200
        assert "POST" in requested_before.headers["access-control-allow-methods"]


def test_a_store_without_tokens_accepts_no_writes(root):
    with TestClient(create_app(root)) as client:
        described = client.get("/openapi.json").json()["paths"]
        writing = [
            path for path, ways in described.items() for way in ways.values() if way.get("security")
        ]
        assert "/api/runs" in writing
        for method in ("PUT", "PATCH", "DELETE"):
            assert client.request(method, "/api/missions").status_code == 405
        answer = client.post("/api/runs", json={"kind": "downlink"})
        assert answer.status_code == 403
        assert "is read-only" in answer.json()["description"]


def test_an_internal_error_reveals_nothing_internal(root, monkeypatch):
    app = create_app(root)

    def broken() -> None:
        raise RuntimeError("password=hunter2 in /srv/secret.py")

    monkeypatch.setattr(type(app.state.services.catalogue), "missions", lambda _self: broken())
    with TestClient(app, raise_server_exceptions=False) as client:
        answer = client.get("/api/missions")
    assert answer.status_code == 500
    assert "hunter2" not in answer.text
    assert answer.json()["code"] == "Internal Server Error"
