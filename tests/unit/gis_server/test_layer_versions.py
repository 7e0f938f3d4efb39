"""Versions of layers: which there are, and which solutions they hold for."""

from __future__ import annotations

import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.products.catalogue.runs import Run, RunRecords, RunState
from solmap.products.catalogue.workspace import Workspace
from tests.support.versions_store import fill_versions


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    root = tmp_path_factory.mktemp("versions") / "store"
    run = Run.start("downlink", "a folder")
    versions = fill_versions(root)
    RunRecords(Workspace.open(root).catalogue.engine).write(run.with_end(RunState.SUCCEEDED))
    with TestClient(create_app(root)) as client:
        yield client, versions


def request(client, stop, kind="dtm", **query):
    answer = client.get(f"/api/layers/{stop}/{kind}/versions", params=query)
    assert answer.status_code == 200
    return answer.json()


def named(ref):
    return f"{ref.scope.name}/{ref.digest}"


def test_a_stop_that_moved_has_a_version_for_each_solution(store):
    client, versions = store
    for kind in ("dtm", "orthophoto"):  # an orthophoto belongs to the solution of its map
        answer = request(client, versions.moved, kind)
        assert answer["total"] == 2
        by_latest = {v["is_latest"]: v for v in answer["versions"]}
        for is_latest, network in zip((False, True), versions.networks, strict=True):
            found = by_latest[is_latest]
            assert [one["id"] for one in found["solutions"]] == [named(network)]
            assert found["layer"]["id"].endswith(f"/{kind}@{found['layer']['digest']}")


def test_an_unchanged_map_is_valid_for_both_solutions(store):
    client, versions = store
    answer = request(client, versions.stayed)
    assert answer["total"] == 1
    (only,) = answer["versions"]
    assert {s["id"] for s in only["solutions"]} == {named(ref) for ref in versions.networks}


def test_a_layer_of_unknown_origin_belongs_to_no_known_solution(store):
    client, _ = store
    assert request(client, "mer2", "dtm")["versions"][0]["solutions"] == []


def test_versions_name_the_run_that_made_them(store):
    client, versions = store
    (newest, *_) = request(client, versions.moved)["versions"]
    assert newest["run"]["kind"] == "downlink"


def test_versions_are_paged(store):
    client, versions = store
    pages = [request(client, versions.moved, limit=1, offset=k) for k in range(3)]
    assert [page["total"] for page in pages] == [2, 2, 2]
    digests = [[v["layer"]["digest"] for v in page["versions"]] for page in pages]
    assert [len(one) for one in digests] == [1, 1, 0]
    assert digests[0] != digests[1]


def test_an_earlier_version_has_tiles_and_values_of_its_own(store):
    client, versions = store
    for found in request(client, versions.moved)["versions"]:
        layer = found["layer"]
        assert client.get(f"/api/layers/{layer['id'].replace('@', '/')}").json() == found
        address = layer["tiles"].format(z=17, x=65535, y=65535)
        assert client.get(address).status_code == 200


def test_unknown_layers_have_no_versions(store):
    client, versions = store
    assert client.get(f"/api/layers/{versions.stayed}/slope/versions").status_code == 404
    assert client.get(f"/api/layers/{versions.stayed}/nonsense/versions").status_code == 422
