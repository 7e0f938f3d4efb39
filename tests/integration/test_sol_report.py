"""The report of a sol as a page, from the command line and from the server."""

from __future__ import annotations

import re

import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from solmap.flows.cli import app as command
from solmap.gis_server.app import create_app
from solmap.products.catalogue.catalogue import Outcome
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError
from solmap.products.reports.sol_report import sol_facts, sol_report, thumbnail, timings
from tests.support.bowl_store import UNPAIRED, fill

EVIL = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    found = Workspace.open(tmp_path_factory.mktemp("reported") / "store")
    fill(found)
    failed = Outcome.now("mer2-sol0155", (f"a pair failed: {EVIL}",), is_failure=True)
    other = Outcome.now("mer2-sol0156", ("of another sol",), is_failure=True)
    found.catalogue.publish(outcomes=[failed, other])
    return found


def test_a_report_lists_the_images_of_its_sol_and_reasons_for_unpaired_ones(workspace):
    page = sol_report("MER2", 155, workspace)
    images = workspace.catalogue.images("MER2", sol=155)
    assert images
    assert all(image.id in page for image in images)
    assert page.count("data:image/jpeg;base64,") == len(images)
    assert UNPAIRED in page
    others = set(workspace.catalogue.images("MER2")) - set(images)
    assert not [image.id for image in others if image.id in page]


def test_failures_are_listed_as_text_for_this_sol_only(workspace):
    page = sol_report("MER2", 155, workspace)
    assert "a pair failed: &lt;script&gt;" in page
    assert EVIL not in page
    assert "of another sol" not in page


def test_a_report_loads_nothing_from_elsewhere(workspace):
    page = sol_report("MER2", 155, workspace)
    assert not re.findall(r"(?:src|srcset|action)=\"(?!data:)", page)
    assert not re.findall(r"<(?:script|link|iframe)|@import|url\(", page)
    assert not re.findall(r"href=\"(?!/download/)", page)


def test_times_are_the_sums_in_the_provenance(workspace):
    facts = sol_facts("MER2", 155, workspace)
    refs = [layer.ref for layer in facts.layers]
    rows = {row.kind: row for row in timings(refs, workspace)}
    for ref in refs:
        made = workspace.store.provenance(ref)
        row = rows[str(ref.kind)]
        assert (row.seconds, row.cpu_s) == (made["seconds"], made["cpu_s"])
        assert row.peak_rss_mb == made["peak_rss_mb"] > 10
        assert made["cpu_s"] <= made["seconds"] + 0.05
    assert {"dtm", "contours"} <= {row.kind for row in facts.timings}


def test_a_removed_figure_does_not_break_the_report(tmp_path):
    copy = Workspace.open(tmp_path / "store")
    fill(copy)
    (image, *_) = copy.catalogue.images("MER2", sol=155)
    copy.store.remove(image.browse)
    assert thumbnail(image, copy) is None
    assert image.id in sol_report("MER2", 155, copy)


def test_a_sol_without_images_is_refused_with_the_existing_sols(workspace):
    with pytest.raises(ProductNotFoundError, match="no image of sol 7; the last sols are 155, 156"):
        sol_report("MER2", 7, workspace)


def test_the_server_shows_the_same_report(workspace):
    with TestClient(create_app(workspace.store.root)) as client:
        answer = client.get("/api/missions/MER2/sols/155/report")
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/html")
        assert answer.text == sol_report("MER2", 155, workspace)
        assert client.get("/api/missions/MER2/sols/7/report").status_code == 404
        assert client.get("/api/missions/MER2/sols/-1/report").status_code == 422


def test_the_command_writes_the_report_and_lists_timings(workspace, tmp_path):
    out, store = tmp_path / "sol.html", str(workspace.store.root)
    requested = ["report", "MER2", "155", "--store", store, "--out", str(out)]
    done = CliRunner().invoke(command, requested)
    assert done.exit_code == 0, done.output
    assert "MER2, sol 155" in out.read_text()
    listed = CliRunner().invoke(command, ["status", "--timings", "--store", store, "--json"])
    assert '"kind": "dtm"' in listed.output
