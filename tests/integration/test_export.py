"""QGIS and GDAL, as the machine has them, open an exported folder: project, styles, rasters."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from solmap.products.catalogue.workspace import Workspace
from solmap.products.export.contents import export
from solmap.products.export.selection import Selection
from tests.integration.test_qgis import is_on_our_mars, run_with_qgis
from tests.unit.gis_server.conftest import build, elevation_at

SESSION = Path(__file__).parents[1] / "support" / "qgis_project_session.py"
GDALINFO = Path("/usr/bin/gdallocationinfo")
DTM = "MER2_sol0156_site010_drive0064_dtm_8cm.tif"


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    world = build(tmp_path_factory.mktemp("store"))
    target = tmp_path_factory.mktemp("export") / "out"
    export(target, Selection(), Workspace(world.store, world.catalogue))
    return target


@pytest.fixture(scope="module")
def project(exported: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("qgis")
    files = [str(folder / name) for name in ("said.json", "drawn.png")]
    run_with_qgis([str(SESSION), str(exported / "MER2.qgz"), *files], folder)
    if kept := os.environ.get("SOLMAP_SCREENSHOTS"):
        Path(kept, "qgis-export.png").write_bytes(Path(files[1]).read_bytes())
    return json.loads(Path(files[0]).read_text()) | {"picture": files[1]}


def layer_of(project: dict[str, Any], source: str) -> dict[str, Any]:
    (found,) = (one for one in project["layers"] if one["source"].endswith(source))
    return found


def test_qgis_opens_the_project_on_mars_with_all_layers(project, exported):
    assert project["opened"]
    assert project["error"] == ""
    assert is_on_our_mars(project)
    assert project["ellipsoid"] == "NONE"
    assert all(one["valid"] and one["renderer"] for one in project["layers"])
    shown = {Path(one["source"]).name for one in project["layers"]}
    assert shown == {path.name for path in (exported / "maps").iterdir()}


def test_layers_of_the_project_have_readable_names(project):
    names = [one["name"] for one in project["layers"]]
    assert all("sol 156" in name for name in names)
    assert layer_of(project, DTM)["group"] == "sol 156, site 10 drive 64"


def test_styles_of_the_project_are_those_of_the_server(project):
    dtm = layer_of(project, DTM)
    assert dtm["renderer"] == "singlebandpseudocolor"
    assert dtm["colours"][0][1] == "#440154"
    assert is_on_our_mars(dtm)
    havens = layer_of(project, "havens.geojson")
    assert (havens["renderer"], havens["symbol"]) == ("singleSymbol", "SimpleFill")
    assert havens["count"] == 1
    assert "+R=3396190" in havens["crs_proj"]


def test_qgis_draws_visible_layers_at_their_coordinates(project):
    assert project["drawn"]["errors"] == []
    drawn = cv2.imread(project["picture"]).astype(int)
    west, south, east, north = project["drawn"]["extent"]
    rows, cols = drawn.shape[:2]
    # grey of the orthophoto runs from 0 in the west to 254 in the east
    for place in (-15.0, 0.0, 15.0):
        col = round((place - west) / (east - west) * cols)
        row = round((north - 30.0) / (north - south) * rows)
        assert np.abs(drawn[row, col] - 254.0 * (place + 40.96) / 81.92).max() <= 6


def test_gdal_reads_a_raster_with_its_values(exported):
    if not GDALINFO.is_file():
        pytest.skip(f"there is no {GDALINFO}: install gdal-bin")
    message = subprocess.run(
        [GDALINFO, "-valonly", "-b", "1", "-geoloc", str(exported / "maps" / DTM), "10.04", "4.04"],
        check=True,
        capture_output=True,
        text=True,
    )
    assert float(message.stdout) == pytest.approx(elevation_at(10.04, 4.04), abs=1e-4)
