"""One answer starts the map; it is rewritten only when something is published."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from http import HTTPStatus

from fastapi.testclient import TestClient

from solmap.gis_server import app as app_module
from solmap.gis_server.app import create_app
from solmap.gis_server.routes import missions


def test_the_start_document_has_all_missions_and_the_layers_of_the_first(client):
    begin = client.get("/api/start").json()
    assert begin["missions"] == client.get("/api/missions").json()
    assert begin["mission"] == begin["missions"][0]["mission"]
    assert begin["layers"] == client.get(f"/api/missions/{begin['mission']}/layers").json()


def test_an_unchanged_start_document_is_not_sent_again(own_world):
    with TestClient(create_app(own_world.root)) as client:
        again = {"If-None-Match": client.get("/api/start").headers["etag"]}
        assert client.get("/api/start", headers=again).status_code == HTTPStatus.NOT_MODIFIED
        layer = own_world.catalogue.layers("MER2")[0]
        own_world.catalogue.publish(layers=[replace(layer, title="renamed")])
        fresh = client.get("/api/start", headers=again)
        assert fresh.status_code == HTTPStatus.OK
        assert "renamed" in {one["title"] for one in fresh.json()["layers"]}


def test_the_progress_of_runs_does_not_rewrite_the_start_document(own_world, monkeypatch):
    with TestClient(create_app(own_world.root)) as client:
        begin = client.get("/api/start").content
        monkeypatch.setattr(missions, "missions_of", _never)
        own_world.catalogue.append_event("run.changed", {"id": "a"})
        own_world.catalogue.append_event("edits.changed", {"mission": "MER2"})
        assert client.get("/api/start").content == begin


def test_events_since_the_start_document_cover_all_changes(own_world):
    with TestClient(create_app(own_world.root)) as client:
        first = client.get("/api/start")
        seen = int(first.headers["Last-Event-ID"])
        own_world.catalogue.append_event("run.changed", {"id": "a"})
        again = client.get("/api/start", headers={"If-None-Match": first.headers["etag"]})
        assert again.status_code == HTTPStatus.NOT_MODIFIED
        assert int(again.headers["Last-Event-ID"]) == seen + 1
        assert [event.document["id"] for event in own_world.catalogue.events_since(seen)] == ["a"]


def test_the_answer_is_there_before_the_first_client(own_world, monkeypatch):
    app = create_app(own_world.root)
    asyncio.run(app_module._answer_once(app))
    monkeypatch.setattr(missions, "missions_of", _never)
    with TestClient(app) as client:
        assert client.get("/api/start").status_code == HTTPStatus.OK


def _never(_services):
    raise AssertionError("the answer is written again though nothing was published")
