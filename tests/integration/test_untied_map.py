"""Every product of sites that nothing ties to the lander states so."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from pathlib import Path

import geopandas
import numpy as np
import pystac
import pytest
from fastapi.testclient import TestClient
from pyproj import CRS

from solmap.gis_server.app import create_app
from solmap.photogrammetry.archive.tables.places import ORBITAL, PRIORITY
from solmap.photogrammetry.archive.tables.vector_files import Solution, VectorFile, vector_text
from solmap.photogrammetry.frames import FrameKind
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import local_crs
from solmap.products.errors import ProductError
from solmap.products.formats.raster.raster import open_raster
from solmap.products.model import ProductKind
from solmap.products.reports.stac import FOLDER, item_id
from tests.support.small_downlink import COARSE, write_coarse_pipeline, write_small_downlink

pytestmark = [pytest.mark.usefixtures("engine"), pytest.mark.slow]
NAME = "MER2-ORIGIN10"
ORIGIN = "origin: site 10, not tied to the lander"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, engine: None) -> Path:  # noqa: ARG001
    """Two stops of site 10, with all that is made of them, and no vector file."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    folder = tmp_path_factory.mktemp("untied")
    downlink = write_small_downlink(folder / "downlink", stops=2, pairs=2)
    shutil.rmtree(downlink / "masters")
    pipeline = str(write_coarse_pipeline(folder / "coarse.toml", COARSE))
    report = process_downlink(downlink, folder / "store", pipeline)
    assert report.failures == []
    assert any("site 10 is not tied to the lander" in line for line in report.warnings)
    return folder / "store"


@pytest.fixture
def workspace(store: Path) -> Workspace:
    return Workspace.open(store)


def text_of(path: Path) -> str:
    """Text of a file, or of its parts if it is an archive."""
    data = path.read_bytes()
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            data = b"".join(archive.read(name) for name in archive.namelist())
    return data.decode("utf-8", "replace")


def test_every_layer_names_the_origin(workspace):
    layers = workspace.catalogue.layers(NAME)
    kinds = {layer.ref.kind for layer in layers}
    assert kinds > {ProductKind.DTM, ProductKind.STOPS, ProductKind.PANORAMA, ProductKind.POINTS}
    for layer in layers:
        path = workspace.store.path(layer.ref)
        if path.suffix == ".tif":
            with open_raster(path) as dataset:
                assert dataset.tags()["ORIGIN"] == ORIGIN
                assert layer.type == "panorama" or dataset.crs.to_wkt().startswith(
                    f'LOCAL_CS["{ORIGIN} (east, north)"'
                )
        else:
            assert ORIGIN in text_of(path), layer.id
        if path.suffix == ".geojson" and json.loads(path.read_text())["features"]:
            assert CRS(geopandas.read_file(path).crs).name == f"{ORIGIN} (east, north)"


def test_every_file_of_the_traverse_names_the_origin(workspace):
    for kind in (ProductKind.TRAVERSE_TABLE, ProductKind.TRAVERSE_FIGURE):
        (ref,) = workspace.catalogue.pointers(kind)
        assert ORIGIN in text_of(workspace.store.path(ref)).replace("<!-- ", "")
    (package,) = workspace.catalogue.pointers(ProductKind.TRAVERSE_PACKAGE)
    assert geopandas.read_file(workspace.store.path(package), layer="stops").crs.name.startswith(
        ORIGIN
    )
    (rovers,) = workspace.catalogue.pointers(ProductKind.ROVER_VECTORS)
    assert 'name="SITE_FRAME" index1="10"' in text_of(workspace.store.path(rovers))
    assert workspace.catalogue.pointers(ProductKind.PLACES) == []  # a table of places on Mars


def test_stac_names_the_origin_and_gives_no_place_on_mars(store, workspace):
    entry = workspace.catalogue.mission(NAME)
    collection = pystac.Collection.from_file(str(store / FOLDER / NAME / "collection.json"))
    assert ORIGIN in collection.description
    for layer in workspace.catalogue.layers(NAME):
        file = store / FOLDER / NAME / f"{item_id(layer)}.json"
        item = pystac.Item.from_file(str(file))
        assert item.geometry is None
        assert item.properties["description"] == ORIGIN
        if "proj:wkt2" in item.properties:
            assert CRS(item.properties["proj:wkt2"]) == local_crs(entry.landing)


def test_every_answer_of_the_server_names_the_untied_origin(store):
    with TestClient(create_app(store)) as client:
        (mission,) = client.get("/api/missions").json()
        assert (mission["mission"], mission["landing"]["name"]) == (NAME, ORIGIN)
        assert mission["crs"]["proj4"] is None
        assert ORIGIN in mission["crs"]["wkt"]
        here = client.get(f"/api/missions/{NAME}/identify?east=1&north=1").json()
        assert here["lon"] is None
        assert here["features"]
        page = client.get(f"/api/missions/{NAME}/sols/155/report").text
        assert ORIGIN in page
        root = f"/ogc/{NAME}"
        for part in (
            "",
            "/collections",
            "/wmts?service=WMTS&request=GetCapabilities",
            "/crs/local",
        ):
            answer = client.get(root + part)
            assert answer.status_code == 200
            assert ORIGIN in answer.text or part == "/collections"
        stops = client.get(f"{root}/collections/stops/items?bbox=-90,-90,90,90")
        assert stops.headers["Content-Crs"].endswith("/crs/local>")
        assert ORIGIN in stops.json()["crs"]["properties"]["name"]
        assert len(stops.json()["features"]) == 2
        package = client.get(f"{root}/collections/stops/items?f=gpkg").content
        assert ORIGIN.encode() in package
        mars = "http://www.opengis.net/def/crs/IAU/2015/49900"
        refused = client.get(f"{root}/collections/stops/items?crs={mars}")
        assert refused.status_code == 400
        assert ORIGIN in refused.text


def test_mars_coordinates_are_refused_with_what_would_tie_the_map(store, tmp_path):
    from solmap.flows.external_data import add_control  # noqa: PLC0415 - imports Prefect
    from solmap.tasks.mission.control import FrameParams  # noqa: PLC0415

    with pytest.raises(ProductError, match=r"solmap poses add FILE"):
        add_control(tmp_path / "control.csv", NAME, store, FrameParams(300.0, 3.0, 0.01))


def test_an_orbital_image_moves_the_map_to_mars(store, tmp_path):
    """By what `tie_by_image` gives; thumbnails show too little ground to be found from orbit."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    copy = tmp_path / "store"
    shutil.copytree(store, copy)
    before = {layer.id: layer for layer in Workspace.open(copy).catalogue.layers(NAME)}
    place_m, level = np.array([-1210.0, 640.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
    solution = Solution(ORBITAL, FrameKind.SITE, (10,), 0, place_m, level, "", 5.0)
    vectors = VectorFile("orbit-site10.svf", "MER2", "svf", PRIORITY, (solution,))
    svf = tmp_path / vectors.source
    svf.write_text(vector_text(vectors))
    report = process_downlink(None, copy, str(store.parent / "coarse.toml"), places=[svf])
    assert report.failures == []
    assert report.poses[0].startswith(f"{svf.name}: 1 sites and stops")
    workspace = Workspace.open(copy)
    assert [entry.mission for entry in workspace.catalogue.missions()] == ["MER2"]
    after = {layer.id: layer for layer in workspace.catalogue.layers("MER2")}
    of_stops = {name for name in before if name.startswith("mer2-site")}
    assert of_stops <= after.keys()
    for kind in ("dtm", "slope"):
        name = f"mer2-site0010-drive0000/{kind}"
        west, south, east, north = after[name].bounds
        assert west < 640.0 < east
        assert south < -1210.0 < north
        with open_raster(workspace.store.path(after[name].ref)) as dataset:
            assert "Columbia Memorial Station" in dataset.crs.to_wkt()
            assert "ORIGIN" not in dataset.tags()
    (stops,) = workspace.catalogue.layers("MER2", kinds=[ProductKind.STOPS])
    document = json.loads(workspace.store.path(stops.ref).read_text())
    for feature in document["features"]:
        assert feature["properties"]["origin_sigma_m"] == pytest.approx(5.0, abs=0.5)


def test_a_places_table_moves_the_map_to_mars(store, tmp_path):
    """Last of this module: it changes the store."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings
    from solmap.flows.external_data import add_poses  # noqa: PLC0415

    table = tmp_path / "places.csv"
    table.write_text("frame,site,drive,landing_x,landing_y,landing_z\nSITE,10,-1,100.0,50.0,1.0\n")
    (line,) = add_poses([table], NAME, store)
    assert "1 sites and stops" in line
    again = tmp_path / "again"
    again.mkdir()
    shutil.copy(next((store.parent / "downlink").rglob("*.img")), again)
    report = process_downlink(again, store, str(store.parent / "coarse.toml"))
    assert report.failures == []
    catalogue = Workspace.open(store).catalogue
    assert [entry.mission for entry in catalogue.missions()] == ["MER2"]
    west, south, east, north = catalogue.layer("mer2-site0010-drive0000", ProductKind.DTM).bounds
    assert west < 50 < east
    assert south < 100 < north
    assert not [name for name in catalogue.maps_of("MER2") if name != "MER2"]
