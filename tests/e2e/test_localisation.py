"""Files of the traverse that other tools read back to the same places."""

import json

import numpy as np
import pyogrio
import pytest
import shapely
from typer.testing import CliRunner

from solmap.flows.cli import app
from solmap.flows.cli.tables import position_rows
from solmap.photogrammetry.archive.tables.places import parse_places
from solmap.photogrammetry.archive.tables.vector_files import (
    best_poses,
    lsl_tree,
    parse_vector_file,
)
from solmap.photogrammetry.frames import LSL, rover_frame


@pytest.fixture(scope="module")
def handed_out(mapped, tmp_path_factory):
    folder = tmp_path_factory.mktemp("traverse")
    ran = CliRunner().invoke(app, ["traverse", "export", str(folder), "--store", str(mapped.store)])
    assert ran.exit_code == 0, ran.output
    return folder


def adjusted(mapped) -> dict[str, list[float]]:
    return {row["stop"]: row["adjusted_ned_m"] for row in position_rows(mapped.workspace)}


def test_exported_positions_are_the_adjusted_ones(mapped, handed_out):
    text = (handed_out / "MER2_places.csv").read_text()
    table = parse_places(text, "places", mission="MER2", solution_id="adjusted")
    found = [one.offset_m for one in table.solutions]
    np.testing.assert_allclose(found, list(adjusted(mapped).values()), atol=1e-3)


def test_vector_files_compose_to_the_adjusted_stops(mapped, handed_out):
    files = [
        parse_vector_file((handed_out / name).read_text(), name)
        for name in ("MER2_Master.svf", "MER2_Site_10_Master.rvf")
    ]
    tree = lsl_tree(best_poses(files)).tree
    for stop, place in adjusted(mapped).items():
        drive = int(stop.rpartition("drive")[2])
        np.testing.assert_allclose(
            tree.pose(LSL, rover_frame(10, drive)).translation_m, place, atol=1e-3
        )


def test_the_table_gives_the_error_of_telemetry(mapped, handed_out):
    table = json.loads((handed_out / "MER2_differences.json").read_text())
    first, last = (position_rows(mapped.workspace)[k] for k in (0, -1))
    off = np.subtract(last["telemetry_ned_m"], last["adjusted_ned_m"])
    driven = np.subtract(last["adjusted_ned_m"], first["adjusted_ned_m"])
    assert table["end"]["horizontal_m"] == pytest.approx(np.hypot(*off[:2]), abs=2e-3)
    assert table["end"]["elevation_m"] == pytest.approx(-off[2], abs=2e-3)
    assert table["end"]["distance_m"] == pytest.approx(np.hypot(*driven[:2]), abs=2e-3)
    assert (handed_out / "MER2_traverse.svg").stat().st_size > 1000
    assert (handed_out / "MER2_traverse.png").read_bytes().startswith(b"\x89PNG")


def test_the_geopackage_has_lines_stops_and_ellipses_on_the_local_map(mapped, handed_out):
    file = handed_out / "MER2_traverse.gpkg"
    assert {name for name, _ in pyogrio.list_layers(file)} == {
        "traverse", "stops", "error_ellipses"
    }  # fmt: skip
    rows = position_rows(mapped.workspace)
    stops = pyogrio.raw.read(file, layer="stops")
    assert len(stops[2]) == 2 * len(rows)
    fields = dict(zip(stops[0]["fields"].tolist(), stops[3], strict=True))
    places = shapely.get_coordinates(shapely.from_wkb(stops[2]), include_z=True)
    found = places[(fields["solution"] == "adjusted") & (fields["drive"] != 0)]
    north, east, down = rows[-1]["adjusted_ned_m"]
    np.testing.assert_allclose(found, [[east, north, -down]], atol=1e-3)
    ellipses = shapely.from_wkb(pyogrio.raw.read(file, layer="error_ellipses")[2])
    sigma = rows[-1]["sigma_ned_m"][:2]
    assert shapely.contains(ellipses[-1], shapely.Point(east, north))
    assert ellipses[-1].area <= 9 * np.pi * (sigma[0] ** 2 + sigma[1] ** 2)


def test_a_store_without_the_mission_is_refused(mapped, tmp_path):
    command = ["traverse", "export", str(tmp_path), "--mission", "MER1", "--store"]
    ran = CliRunner().invoke(app, [*command, str(mapped.store)])
    assert ran.exit_code == 1
    assert "holds MER2; MER1 is not one of them" in ran.output
