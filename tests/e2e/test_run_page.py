"""The page of a run, read from the engine: names by sol, tables, figure and links."""

import json

import pytest
from prefect.client.orchestration import get_client
from prefect.client.schemas.filters import FlowFilter, FlowFilterName
from prefect.client.schemas.sorting import FlowRunSort

PAGE = 200
"""The server lists no more runs at once."""


@pytest.fixture(scope="module")
def runs(mapped):
    """The runs of sols and downlinks over the store, by flow, oldest first."""
    with get_client(sync_client=True) as client:
        return {flow: runs_of(flow, mapped.store, client) for flow in ("downlink", "sol")}


def runs_of(flow, store, client):
    requested = {
        "flow_filter": FlowFilter(name=FlowFilterName(any_=[flow])),
        "sort": FlowRunSort.START_TIME_ASC,
        "limit": PAGE,
    }
    found = page = client.read_flow_runs(**requested)
    while len(page) == PAGE:
        page = client.read_flow_runs(**requested, offset=len(found))
        found = found + page
    return [run for run in found if str(run.parameters.get("store")).endswith(str(store))]


@pytest.fixture(scope="module")
def artifacts(runs):
    """What the run that mapped the downlink left; other tests run over the store once more."""
    of_run = {"flow_run_id": {"any_": [str(runs["downlink"][0].id)]}}
    with get_client(sync_client=True) as client:  # whose `read_artifacts` sends nulls
        found = client.request("POST", "/artifacts/filter", json={"artifacts": of_run}).json()
    return {artifact["key"]: artifact for artifact in found}


def test_runs_are_named_by_mission_and_sol(runs, mapped):
    sols = [sol.sol for sol in mapped.report.sols]
    assert runs["downlink"][0].name == f"downlink MER2 sol {sols[0]}-{sols[-1]}"
    assert {run.name for run in runs["sol"]} == {f"MER2 sol {sol}" for sol in sols}


def test_sols_and_adjustments_are_tables(artifacts, mapped):
    sols = json.loads(artifacts["sols"]["data"])
    assert [(row["mission"], row["sol"]) for row in sols] == [("MER2", 155), ("MER2", 156)]
    adjustments = json.loads(artifacts["adjustments"]["data"])
    assert [row["sol"] for row in adjustments] == [row["sol"] for row in sols]
    for row in adjustments:
        assert row["converged"]
        assert 0.1 < row["sigma0"] < 2.0
        scope, digest = row["report"].removesuffix(".html").split("/")[-2:]
        assert (mapped.store / "products" / "report" / scope / f"{digest}.html").is_file()


def test_the_traverse_is_a_figure_and_map_and_report_are_links(artifacts, mapped):
    assert artifacts["map"]["data"].endswith("(http://127.0.0.1:8765/)")
    assert "/reports/mer2-sol0156/" in artifacts["report-mer2"]["data"]
    image = artifacts["traverse-mer2"]
    assert image["type"] == "image"
    file = image["data"].partition("/products/")[2]
    assert (mapped.store / "products" / file).read_bytes().startswith(b"\x89PNG")
