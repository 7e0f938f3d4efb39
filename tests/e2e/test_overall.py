"""A mission that was processed sol by sol is adjusted overall, and what did not move stays."""

import json
import re
import shutil
from pathlib import Path

import pytest

from solmap.flows.cli.console import select_rows
from solmap.flows.cli.tables import latest_networks, position_rows, report_rows
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind
from solmap.tasks.network.orientations import read_orientations

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def readjusted(mapped, tmp_path_factory) -> Workspace:
    """A copy of the mapped store after an overall adjustment."""
    from solmap.flows.overall import readjust  # noqa: PLC0415 - needs the engine's settings

    store = tmp_path_factory.mktemp("overall") / "store"
    shutil.copytree(mapped.store, store, ignore=shutil.ignore_patterns("prefect"))
    report = readjust("MER2", store)
    assert not report.failures
    return Workspace.open(store)


def made(workspace: Workspace) -> set[Path]:
    return set((workspace.store.root / "products").rglob("*.*"))


def test_the_overall_network_is_the_latest_and_the_sol_keeps_its_own(readjusted):
    (latest,) = latest_networks(readjusted)
    assert latest.scope.name.endswith("-overall")
    stepwise = latest.scope.name.removesuffix("-overall")
    assert readjusted.catalogue.latest(stepwise, ProductKind.NETWORK)
    rows = position_rows(readjusted)
    assert [row["held"] for row in rows] == [True] + [False] * (len(rows) - 1)


def test_maps_of_stops_that_hardly_moved_are_kept(mapped, readjusted):
    before = {path.name for path in (mapped.store / "products" / "dtm").rglob("*.tif")}
    overall = next(
        ref
        for ref in readjusted.catalogue.pointers(ProductKind.ORIENTATIONS)
        if ref.scope.name.endswith("-overall")
    )
    stops = read_orientations(overall, readjusted.store, ()).values()
    moved = [stop for stop in stops if stop.is_new]
    after = {path.name for path in (readjusted.store.root / "products" / "dtm").rglob("*.tif")}
    assert before <= after
    assert len(after - before) == len(moved)
    assert all(stop.moved_m > 0.02 for stop in moved)


def test_a_later_run_continues_from_the_overall_adjustment_and_makes_nothing(mapped, readjusted):
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415
    from solmap.flows.overall import readjust  # noqa: PLC0415

    before, latest = made(readjusted), latest_networks(readjusted)
    report = process_downlink(mapped.downlink, readjusted.store.root)
    assert report.succeeded
    assert not readjust("MER2", readjusted.store.root).failures
    assert made(readjusted) == before
    assert latest_networks(readjusted) == latest


def test_every_adjustment_has_a_page_and_figures(readjusted):
    rows = select_rows(report_rows(readjusted), "MER2")
    assert [row["adjustment"] for row in rows][-1].endswith("-overall")
    for row in rows:
        page = Path(row["page"]).read_text()
        assert page.count("<img") >= 3
        assert not re.findall(r'(?:src|href)="(?!data:)', page)  # it lies in one file
        figures = json.loads(Path(row["figures"]).read_text())
        assert figures["adjustment"]["converged"]
        assert figures["quality"]["precision"]["pairs"] > 0
        assert {camera["instrument"] for camera in figures["quality"]["cameras"]} == {"NAVCAM"}


def test_a_mission_without_products_is_refused_with_advice(readjusted):
    from solmap.flows.overall import readjust  # noqa: PLC0415
    from solmap.products.errors import ProductNotFoundError  # noqa: PLC0415

    with pytest.raises(ProductNotFoundError, match="`solmap run` its downlink first"):
        readjust("MER1", readjusted.store.root)
