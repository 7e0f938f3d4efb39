"""Figures for Prometheus, read back with its own parser from a server of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.runs import Run, RunRecords, RunState
from solmap.products.catalogue.workspace import Workspace
from tests.support.bowl_store import fill
from tests.support.live_server import serving


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    root = tmp_path_factory.mktemp("metrics") / "store"
    fill(Workspace.open(root))
    book = RunRecords(Catalogue.open(root).engine)
    book.write(Run.start("downlink", "sol-155").with_end(RunState.SUCCEEDED))
    book.write(Run.start("downlink", "sol-156").with_end(RunState.FAILED))
    with serving(root) as address:
        yield address, root


def figures(address: str) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    answer = httpx.get(f"{address}/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain")
    families = text_string_to_metric_families(answer.text)
    samples = [sample for family in families for sample in family.samples]
    return {(one.name, tuple(sorted(one.labels.items()))): one.value for one in samples}


def value(found, name: str, /, **labels: str) -> float:
    return found[name, tuple(sorted(labels.items()))]


def test_requests_are_counted_by_route_and_not_by_address(server):
    address, _ = server
    for mission in ("MER2", "MSL", "NOWHERE"):
        httpx.get(f"{address}/api/missions/{mission}/layers")
    httpx.get(f"{address}/../../etc/passwd")
    found = figures(address)
    route = "/api/missions/{mission}/layers"
    known = {"route": route, "method": "GET"}
    assert value(found, "solmap_http_requests_total", **known, status="200") == 2
    assert value(found, "solmap_http_requests_total", **known, status="404") == 1
    assert value(found, "solmap_http_request_seconds_count", route=route) == 3
    assert "NOWHERE" not in str(found)
    assert "passwd" not in str(found)


def test_tiles_are_timed_and_cache_hits_counted(server):
    address, root = server
    layers = Catalogue.open(root).layers("MER2")
    (dtm,) = [layer for layer in layers if str(layer.ref.kind) == "dtm"]
    place = f"{address}/tiles/{dtm.ref.scope.name}/dtm/{dtm.ref.digest}/17"
    for column in (65535, 65536, 65536):
        assert httpx.get(f"{place}/{column}/65535.png").status_code == 200
    found = figures(address)
    assert value(found, "solmap_tile_render_seconds_count", form="png") == 3
    route = "/tiles/{scope}/{kind}/{digest}/{z}/{x}/{y}.png"
    assert value(found, "solmap_http_request_seconds_count", route=route) == 3
    assert value(found, "solmap_cache_lookups_total", cache="layers", found="yes") == 2
    assert value(found, "solmap_open_rasters") >= 1


def test_metrics_give_the_content_of_the_store_and_the_outcome_of_runs(server):
    address, root = server
    found, catalogue = figures(address), Catalogue.open(root)
    images = catalogue.images("MER2")
    things = "solmap_catalogue_things"
    assert value(found, things, mission="MER2", thing="images") == len(images)
    assert value(found, things, mission="MER2", thing="stops") == len({one.stop for one in images})
    assert value(found, things, mission="MER2", thing="layers") == len(catalogue.layers("MER2"))
    for state in ("succeeded", "failed"):
        assert value(found, "solmap_runs", kind="downlink", state=state) == 1
        last = {"kind": "downlink", "state": state}
        assert value(found, "solmap_run_last_ended_timestamp_seconds", **last) > 1.6e9
        assert value(found, "solmap_run_last_duration_seconds", **last) >= 0.0
    assert value(found, "process_resident_memory_bytes") > 1e7
    assert value(found, "process_open_fds") > 3
