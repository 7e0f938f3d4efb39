"""What a run leaves on its page, asked of the engine: names by sol, tables, picture and links."""

import json

import pytest
from prefect.client.orchestration import get_client
from prefect.client.schemas.filters import ArtifactFilter, ArtifactFilterFlowRunId
from prefect.client.schemas.sorting import FlowRunSort


@pytest.fixture(scope="module")
def runs(mapped):
    with get_client(sync_client=True) as client:
        found = client.read_flow_runs(sort=FlowRunSort.START_TIME_ASC, limit=200)
        flows = {run.flow_id: client.read_flow(run.flow_id).name for run in found}
        mine = [run for run in found if str(mapped.store) in str(run.parameters.get("store"))]
        return [(flows[run.flow_id], run) for run in mine]


@pytest.fixture(scope="module")
def artifacts(runs):
    (downlink,) = (run for flow, run in runs if flow == "downlink")
    of_run = ArtifactFilter(flow_run_id=ArtifactFilterFlowRunId(any_=[downlink.id]))
    with get_client(sync_client=True) as client:
        return {found.key: found for found in client.read_artifacts(artifact_filter=of_run)}


def test_runs_are_named_by_mission_and_sol(runs, mapped):
    sols = [sol.sol for sol in mapped.report.sols]
    names = [run.name for _, run in runs]
    assert f"downlink MER2 sol {sols[0]}-{sols[-1]}" in names
    for sol in sols:
        assert f"MER2 sol {sol}" in names


def test_sols_and_adjustments_are_tables(artifacts, mapped):
    sols = json.loads(artifacts["sols"].data)
    assert [(row["mission"], row["sol"]) for row in sols] == [("MER2", 155), ("MER2", 156)]
    adjustments = json.loads(artifacts["adjustments"].data)
    assert [row["sol"] for row in adjustments] == [row["sol"] for row in sols]
    for row in adjustments:
        assert row["converged"]
        assert 0.1 < row["sigma0"] < 2.0
        scope, digest = row["report"].removesuffix(".html").split("/")[-2:]
        assert (mapped.store / "products" / "report" / scope / f"{digest}.html").is_file()


def test_the_traverse_is_a_picture_and_map_and_report_are_links(artifacts, mapped):
    assert artifacts["map"].data.endswith("(http://127.0.0.1:8765/)")
    assert "/reports/mer2-sol0156/" in artifacts["report-mer2"].data
    picture = artifacts["traverse-mer2"]
    assert picture.type == "image"
    file = picture.data.partition("/products/")[2]
    assert (mapped.store / "products" / file).read_bytes().startswith(b"\x89PNG")
