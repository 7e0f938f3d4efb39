"""QGIS opens what the server offers, over HTTP: what lies where, on which Mars, and what it draws.

QGIS runs as the machine's own Python has it, apart from this environment's GDAL and PROJ. What
QGIS 3.22 cannot do is tested too, as `docs/how-to/open-in-gis.md` states it: OGC API Features come
as degrees of the Earth, and WMTS by its own provider without a reference system; by GDAL's driver,
which QGIS has as well, WMTS has the right one.
"""

from __future__ import annotations

import json
import os
import subprocess
import urllib.request
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from solmap.products.formats.vector.geojson import Feature
from tests.support.live_server import serving
from tests.unit.gis_server.conftest import build, elevation_at, haven

PYTHON = Path("/usr/bin/python3")
SESSION = Path(__file__).parents[1] / "support" / "qgis_session.py"
AT = (10.04, 4.04)
"""The middle of a cell, metres east and north."""


@pytest.fixture(scope="module")
def qgis_answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("qgis")
    root = build(folder / "store").root
    with serving(root) as url:
        requested = _requested(url, folder)
        (folder / "asked.json").write_text(json.dumps(requested))
        run_with_qgis([str(SESSION), str(folder / "asked.json"), str(folder / "said.json")], folder)
    return json.loads((folder / "said.json").read_text()) | {"folder": str(folder)}


def run_with_qgis(arguments: list[str], home: Path) -> None:
    """Run a script; skip where the machine has no QGIS."""
    if not PYTHON.is_file():
        pytest.skip(f"{PYTHON} is not installed")
    home.chmod(0o700)
    clean = {
        "PATH": "/usr/bin:/bin",
        "HOME": str(home),
        "XDG_RUNTIME_DIR": str(home),
        "QT_QPA_PLATFORM": "offscreen",
    }
    ended = subprocess.run(
        [str(PYTHON), *arguments],
        check=False,
        env=clean,
        cwd=home,  # GDAL caches answers of a WMTS in its working folder
        capture_output=True,
        text=True,
        timeout=300,
    )
    if "No module named 'qgis'" in ended.stderr:
        pytest.skip(f"{PYTHON} has no qgis.core: install python3-qgis")
    assert ended.returncode == 0, ended.stderr[-2000:]


def _requested(url: str, folder: Path) -> dict[str, dict[str, Any]]:
    with urllib.request.urlopen(f"{url}/api/start") as answer:
        layers = {layer["kind"]: layer for layer in json.load(answer)["layers"]}
    orthophoto = layers["orthophoto"]["id"].replace("/", ".")
    capabilities = f"{url}/ogc/MER2/wmts/1.0.0/WMTSCapabilities.xml"
    geopackage = folder / "havens.gpkg"
    urllib.request.urlretrieve(f"{url}{layers['havens']['download']}.gpkg", geopackage)
    view = {"view": [-40.0, -40.0, 40.0, 40.0]}
    wmts = f"layers={orthophoto}&styles=default&format=image/png&url={capabilities}"
    return {
        "wmts by GDAL": {
            "provider": "gdal",
            "address": f"WMTS:{capabilities},layer={orthophoto}",
            "picture": str(folder / "wmts.png"),
            **view,
        },
        "wmts": {
            "provider": "wms",
            "address": f"{wmts}&tileMatrixSet=Columbia-Memorial-Station",
        },
        "terrain": {
            "provider": "gdal",
            "address": f"/vsicurl/{url}{layers['dtm']['download']}",
            "at": AT,
            "picture": str(folder / "terrain.png"),
        },
        "features": {
            "provider": "OAPIF",
            "address": f"url='{url}/ogc/MER2' typename='havens'",
            "field": "area_m2",
        },
        "geojson": {
            "provider": "ogr",
            "address": f"/vsicurl/{url}{layers['havens']['download']}",
            "field": "area_m2",
        },
        "geopackage": {
            "provider": "ogr",
            "address": str(geopackage),
            "field": "area_m2",
            "picture": str(folder / "havens.png"),
            "view": [-25.0, -25.0, -5.0, -5.0],
        },
    }


def image(answers: dict[str, Any], name: str) -> np.ndarray:
    drawn = cv2.imread(str(Path(answers["folder"]) / f"{name}.png"))
    if folder := os.environ.get("SOLMAP_SCREENSHOTS"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(Path(folder) / f"qgis-{name}.png"), drawn)
    return drawn


def is_on_our_mars(reported: dict[str, Any]) -> bool:
    proj = reported["crs_proj"]
    return "+proj=ortho" in proj and "+R=3393000" in proj and "+lat_0=-14.5692" in proj


def test_a_terrain_model_over_http_has_metres_values_and_the_mars_crs(qgis_answers):
    reported = qgis_answers["terrain"]
    assert reported["valid"]
    assert is_on_our_mars(reported)
    assert reported["extent"] == pytest.approx([-40.96, -40.96, 40.96, 40.96])
    assert reported["value"] == pytest.approx(elevation_at(*AT), abs=1e-4)
    assert reported["errors"] == []


def test_wmts_by_gdals_driver_is_on_mars_at_its_coordinates(qgis_answers):
    reported = qgis_answers["wmts by GDAL"]
    assert reported["valid"]
    assert is_on_our_mars(reported)
    assert reported["errors"] == []
    drawn = image(qgis_answers, "wmts").astype(int)
    # Grey runs from 0 in the west to 254 in the east; a pixel is 0.2 m, of 512 cells.
    for east in (-20.0, 0.0, 20.0):
        expected = 254.0 * (east + 40.96) / 81.92
        shown = drawn[200, round((east + 40.0) / 0.2)]
        assert np.abs(shown - expected).max() <= 6
    assert (drawn[200, 10] == 255).all()  # 38 m to the west nothing was seen


def test_wmts_by_the_qgis_provider_opens_without_a_reference_system(qgis_answers):
    reported = qgis_answers["wmts"]
    assert reported["valid"]
    assert reported["crs"] == ""
    assert reported["crs_proj"] == ""


@pytest.mark.parametrize("name", ["geopackage", "geojson", "features"])
def test_all_features_arrive_with_their_values(qgis_answers, name):
    reported = qgis_answers[name]
    assert reported["valid"]
    assert reported["count"] == 1
    assert [value for value, _, _ in reported["values"]] == [96.0]


def test_a_geopackage_is_in_metres_of_the_local_mars_crs(qgis_answers):
    reported = qgis_answers["geopackage"]
    feature: Feature = haven()
    assert is_on_our_mars(reported)
    assert reported["extent"] == pytest.approx(list(feature.bounds), abs=1e-3)
    drawn = image(qgis_answers, "havens")
    # 20 m are 400 pixels: the square from -20 to -10 m in both, its hole from -16 to -14 m.
    assert (drawn[40, 40] == 255).all()
    assert (drawn[160, 140] != 255).any()
    assert (drawn[200, 200] == 255).all()


def test_geojson_is_in_degrees_of_mars(qgis_answers):
    assert "3396190" in qgis_answers["geojson"]["crs_ellipsoid"]


def test_ogc_api_features_are_read_as_degrees_of_the_earth(qgis_answers):
    """QGIS 3.22 gives them all the Earth's: set the layer's reference system by hand."""
    reported, geojson = qgis_answers["features"], qgis_answers["geojson"]
    assert reported["extent"] == pytest.approx(geojson["extent"], abs=1e-8)
    assert reported["crs"] == "EPSG:4326"
