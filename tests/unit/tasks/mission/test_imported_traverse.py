"""Whole missions out of others' files, and their layers."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from solmap.flows.cli import app
from solmap.photogrammetry.errors import TraverseError
from solmap.photogrammetry.mars import MARS_RADIUS_M
from solmap.photogrammetry.traverse.sources import parse_mission_table
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint
from solmap.products.formats.vector.geojson import read_features
from solmap.products.model import ProductKind
from solmap.tasks.mission.imported_traverse import draw_mission_traverse, read_traverses

LANDING = LandingPoint("here", 175.4729, -14.5692, 3_393_000.0, "a test")
TABLE = (
    "SITE,DRIVE,START_SOL,END_SOL,RAW_X,RAW_Y,RAW_Z,CORRECTED_X,CORRECTED_Y\n"
    "0,0,1,1,0.0,0.0,0.0,-1432.26,-863385.06\n"
    "1,10,3,4,33.0,0.0,0.0,-1401.26,-863385.06\n"
    "2,0,7,7,33.0,66.0,0.0,-1401.26,-863325.06\n"
)
LOCATIONS = (
    "<msl>"
    + "".join(
        f"<location><site>{site}</site><drive>{drive}</drive><lat>-4.5</lat><lon>137.4</lon>"
        f"<rot>0,0,0,1</rot><x>{x}</x><y>{y}</y><z>0</z></location>"
        for site, drive, x, y in ((0, 0, 100, 50), (1, 7, 130, 50))
    )
    + "</msl>"
)


@pytest.fixture
def table(tmp_path) -> Path:
    file = tmp_path / "path.csv"
    file.write_text(TABLE)
    return file


def test_telemetry_begins_at_the_start_of_the_localised_traverse(table):
    traverses = read_traverses([table], "MER2", LANDING)
    telemetry, localised = traverses.of("telemetry"), traverses.of("localised")
    np.testing.assert_allclose(telemetry.places_m[0, :2], localised.places_m[0, :2])
    np.testing.assert_allclose(np.diff(telemetry.places_m[:, 0])[0], 33.0)


def test_a_comparison_may_begin_and_end_with_a_sol(table):
    telemetry, localised = read_traverses([table], "MER2", LANDING).at_common_stops(3, 7)
    assert telemetry.stops == localised.stops == ("1/10", "2/0")


def test_positions_of_a_location_file_are_the_localised_ones(tmp_path):
    file = tmp_path / "locations.xml"
    file.write_text(LOCATIONS)
    traverses = read_traverses([file], "MSL", LANDING)
    assert traverses.of("localised").stops == ("0/0", "1/7")
    with pytest.raises(TraverseError, match="no file contains a telemetry traverse"):
        traverses.at_common_stops()


def test_layers_have_the_degrees_of_the_localised_places(table, tmp_path):
    workspace = Workspace.open(tmp_path / "store")
    traverses = read_traverses([table], "MER2", LANDING)
    lines, stops = draw_mission_traverse("MER2", traverses, [table], LANDING, workspace.store)
    assert (lines.kind, stops.kind) == (ProductKind.MISSION_TRAVERSE, ProductKind.MISSION_STOPS)
    written = json.loads(workspace.store.path(lines).read_text())
    by_solution = {f["properties"]["solution"]: f["geometry"] for f in written["features"]}
    assert by_solution["localised"]["coordinates"][0] == pytest.approx(
        [175.4758369, -14.5658282], abs=1e-7
    )
    here = {f.id: f for f in read_features(workspace.store.path(stops)).features}
    end = here["2/0-localised"].properties
    east = np.radians(31.0 / 3396190.0 * 180 / np.pi) * 3393000.0 * np.cos(np.radians(14.566))
    north = 60.0 * 3393000.0 / 3396190.0
    assert end["telemetry_off_m"] == pytest.approx(np.hypot(33 - east, 66 - north), abs=0.01)


def test_the_comparison_of_spirit_is_one_command(shared_data, tmp_path):
    file = shared_data / "traverse" / "mer_spirit" / "MERA-MER2-Spirit_traverse_path.csv"
    figure = tmp_path / "spirit.svg"
    ran = CliRunner().invoke(
        app, ["traverse", "compare", str(file), "--json", "--figure", str(figure)]
    )
    assert ran.exit_code == 0, ran.output
    rows = {row["where"]: row for row in json.loads(ran.stdout)}
    assert rows["end"]["stop"] == "138/1230"
    assert rows["end"]["elevation_m"] is None  # the table has none
    assert rows["end"]["percent"] == pytest.approx(3.77, abs=0.01)
    assert figure.read_bytes().startswith(b"<?xml")


def test_the_layers_of_spirit_have_the_degrees_of_other_tables(shared_data, tmp_path):
    """Written from the path table; read beside the tables of drives and sites, to a millimetre."""
    folder = shared_data / "traverse" / "mer_spirit"
    files = [folder / "MERA-MER2-Spirit_traverse_path.csv"]
    store = Workspace.open(tmp_path / "store").store
    traverses = read_traverses(files, "MER2", LANDING)
    stops = draw_mission_traverse("MER2", traverses, files, LANDING, store)[1]
    written = {
        f["id"].removesuffix("-localised"): f["geometry"]["coordinates"][:2]
        for f in json.loads(store.path(stops).read_text())["features"]
        if f["id"].endswith("-localised")
    }
    metre = np.radians(1.0) * MARS_RADIUS_M * np.array([np.cos(np.radians(-14.57)), 1.0])
    for name, fewest in (("drives.geojson", 500), ("sites.csv", 100)):
        other = parse_mission_table((folder / name).read_text(), name)
        apart_m = [
            float(np.hypot(*((np.array(written[stop]) - place) * metre)))
            for stop, place in zip(other.stops, other.localised_deg, strict=True)
            if stop in written
        ]
        assert len(apart_m) >= fewest
        assert np.median(apart_m) < 1e-3
        assert np.quantile(apart_m, 0.99) < 1e-2  # some stops stand at several places


def test_a_file_without_a_traverse_ends_with_one_line(tmp_path):
    file = tmp_path / "notes.txt"
    file.write_text("nothing\n")
    ran = CliRunner().invoke(app, ["traverse", "compare", str(file)])
    assert ran.exit_code == 1
    assert "notes.txt: not a traverse table" in ran.output
