"""Control that a person measured moves the network, is named, and the maps follow."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from solmap.flows.cli import app
from solmap.flows.cli.evaluation import true_stops
from solmap.flows.cli.tables import latest_networks, position_rows
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductKind

pytestmark = pytest.mark.slow
SHIFT = (5.0, -2.0)
"""East and north, by which the measured map is off."""


@pytest.fixture(scope="module")
def controlled(mapped, tmp_path_factory) -> Workspace:
    """A copy of the mapped store after an adjustment with places that are off as a whole."""
    from solmap.flows.overall import readjust  # noqa: PLC0415 - needs the engine's settings

    folder = tmp_path_factory.mktemp("control")
    store = folder / "store"
    shutil.copytree(mapped.store, store, ignore=shutil.ignore_patterns("prefect"))
    rows = ["stop,east_m,north_m,sigma_m"]
    for true in true_stops(mapped.downlink / "truth"):
        north, east, _ = true.position
        rows.append(f"{true.site}/{true.drive},{east + SHIFT[0]:.4f},{north + SHIFT[1]:.4f},0.02")
    file = folder / "measured.csv"
    file.write_text("\n".join(rows) + "\n")
    command = ["control", "add", str(file), "--store", str(store)]
    ran = CliRunner().invoke(app, command)
    assert ran.exit_code == 0, ran.output
    assert f"{len(rows) - 1} places" in ran.output
    report = readjust("MER2", store)
    assert not report.failures
    return Workspace.open(store)


def test_the_georeference_of_the_measured_map_is_found(controlled):
    (network,) = latest_networks(controlled)
    adjusted = read_network(network, controlled.store).adjusted
    (frame,) = (one for one in adjusted.frames if one.frame.name == "measured-csv")
    sigma = np.sqrt(np.diagonal(frame.covariance))[:2]
    np.testing.assert_array_less(np.abs(frame.place[:2] + SHIFT), np.maximum(3 * sigma, 0.1))
    assert all(one.used for one in adjusted.control)


def test_every_later_stop_is_listed_as_held_by_control(mapped, controlled):
    rows = position_rows(controlled)
    assert rows[0]["held_by"] == "held as the datum"  # the file does not state its north
    assert all("control: its position in measured-csv" in row["held_by"] for row in rows[1:])
    for row, true in zip(rows, true_stops(mapped.downlink / "truth"), strict=True):
        off = np.subtract(row["adjusted_ned_m"], true.position)
        assert np.hypot(*off[:2]) < 0.15


def test_the_quality_report_has_a_chapter_on_control(controlled):
    (network,) = latest_networks(controlled)
    digest = controlled.catalogue.latest(network.scope.name, ProductKind.QUALITY)
    (file,) = (controlled.store.root / "products").rglob(f"quality/**/{digest}.json")
    found = json.loads(Path(file).read_text())["quality"]
    assert [frame["name"] for frame in found["frames"]] == ["measured-csv"]
    assert len(found["control"]) == len(position_rows(controlled))


def test_a_file_with_an_unknown_stop_ends_with_one_line(mapped, tmp_path):
    file = tmp_path / "measured.csv"
    file.write_text("stop,east_m,north_m,sigma_m\n99/0,1,2,3\n")
    ran = CliRunner().invoke(app, ["control", "add", str(file), "--store", str(mapped.store)])
    assert ran.exit_code == 1
    assert "mer2-site0099-drive0000 is not in the network" in " ".join(ran.output.split())
