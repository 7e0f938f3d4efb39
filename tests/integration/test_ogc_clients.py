"""OGC API Features and STAC as real clients meet them: GDAL, OWSLib and pystac over HTTP."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pyogrio
import pystac
import pytest
from pyproj import CRS, Transformer

from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import MARS, local_crs
from solmap.products.formats.vector.geojson import read_features
from solmap.tasks.mission.publish import update_stac
from tests.support.large_mission import LANDING, write_mission
from tests.support.live_server import serving


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mission")
    write_mission(folder, stops=6, images=60, tie_points=2500)
    workspace = Workspace.open(folder)
    (mission,) = workspace.catalogue.missions()
    update_stac(mission, workspace.catalogue.layers("MER2"), workspace)
    return folder


@pytest.fixture(scope="module")
def server(root: Path) -> Iterator[str]:
    with serving(root) as address:
        yield address


def places_of(root: Path, kind: str) -> np.ndarray:
    """(east, north) of the points of a layer, as they were written."""
    workspace = Workspace.open(root)
    layer = next(one for one in workspace.catalogue.layers("MER2") if str(one.ref.kind) == kind)
    features = read_features(workspace.store.path(layer.ref)).features
    return np.array([one.points[0, :2] for one in features])


def test_gdal_lists_the_collections_as_layers(server):
    listed = pyogrio.list_layers(f"OAPIF:{server}/ogc/MER2")
    names = set(listed[:, 0])
    assert {"traverse-adjusted", "stops", "images", "footprints", "tie-points", "contours"} <= names
    assert not {name for name in names if "." in name}  # rasters are not layers of features


def debians(tool: str, *requested: str) -> str:
    """Output of a program of the machine's own GDAL; it must report no error."""
    program = shutil.which(tool)
    if program is None:
        pytest.skip(f"{tool} of GDAL is not installed")
    reported = subprocess.run(
        [program, *requested], capture_output=True, text=True, timeout=180, check=True
    )
    assert "ERROR" not in reported.stderr + reported.stdout
    return reported.stdout


def listed_by_debians_gdal(source: str) -> list[tuple[str, str]]:
    """Layers and the counts of their features."""
    printed = debians("ogrinfo", "-so", "-al", source)
    layer = re.compile(r"^Layer name: (\S+)$.*?^Feature Count: (\d+)$", re.MULTILINE | re.DOTALL)
    return layer.findall(printed)


def test_debians_gdal_lists_the_collections_of_all_missions_from_the_entry(server):
    found = listed_by_debians_gdal(f"OAPIF:{server}/ogc")
    own = listed_by_debians_gdal(f"OAPIF:{server}/ogc/MER2")
    assert found == [(f"MER2:{name}", count) for name, count in own]


def test_the_system_gdal_lists_the_collections_and_counts_their_features(server):
    found = listed_by_debians_gdal(f"OAPIF:{server}/ogc/MER2")
    collections = httpx.get(f"{server}/ogc/MER2/collections").json()["collections"]
    items = f"{server}/ogc/MER2/collections/{{}}/items?limit=1"
    names = [one["id"] for one in collections]
    counts = [httpx.get(items.format(name)).json()["numberMatched"] for name in names]
    assert [(name, int(count)) for name, count in found] == list(zip(names, counts, strict=True))


def test_the_system_gdal_places_features_on_mars_given_the_reference_system(server, root, tmp_path):
    file = tmp_path / "ties.gpkg"
    source = f"OAPIF:{server}/ogc/MER2"
    debians("ogr2ogr", "-a_srs", "IAU_2015:49900", str(file), source, "tie-points")
    frame = pyogrio.read_dataframe(file)
    assert CRS(frame.crs).equals(CRS(MARS), ignore_axis_order=True)
    on_map = frame.to_crs(local_crs(LANDING)).geometry
    found = np.column_stack([on_map.x, on_map.y])[np.argsort(frame["id"].astype(int))]
    np.testing.assert_allclose(found, places_of(root, "tie-points"), atol=2e-4)


def test_gdal_reads_every_page_and_places_every_feature_on_mars(server, root):
    frame = pyogrio.read_dataframe(f"OAPIF:{server}/ogc/MER2", layer="tie-points")
    assert CRS(frame.crs).equals(CRS(MARS), ignore_axis_order=True)
    assert len(frame) == 2500
    on_map = frame.to_crs(local_crs(LANDING)).geometry
    found = np.column_stack([on_map.x, on_map.y])[np.argsort(frame["id"].astype(int))]
    # nine decimals of a degree are 0.06 mm
    np.testing.assert_allclose(found, places_of(root, "tie-points"), atol=2e-4)


def test_gdal_requests_a_box_and_gets_its_features(server, root):
    places = places_of(root, "tie-points")
    centre = places.mean(axis=0)
    local = local_crs(LANDING)
    carry = Transformer.from_crs(local, local.geodetic_crs, always_xy=True).transform
    west, south = carry(*(centre - 10.0))
    east, north = carry(*(centre + 10.0))
    source = f"OAPIF:{server}/ogc/MER2"
    frame = pyogrio.read_dataframe(source, layer="tie-points", bbox=(west, south, east, north))
    lon, lat = carry(places[:, 0], places[:, 1])
    inside = (lon >= west) & (lon <= east) & (lat >= south) & (lat <= north)
    assert 0 < inside.sum() < len(places)
    assert len(frame) == inside.sum()


def test_owslib_reads_collections_and_items(server):
    ogcapi = pytest.importorskip("owslib.ogcapi.features", reason="OWSLib is not installed")
    client = ogcapi.Features(f"{server}/ogc/MER2/")
    assert "stops" in client.feature_collections()
    page = client.collection_items("stops", limit=4)
    assert (page["numberMatched"], page["numberReturned"]) == (6, 4)
    one = client.collection_item("stops", page["features"][0]["id"])
    assert one["geometry"] == page["features"][0]["geometry"]
    assert client.collection_queryables("stops")["properties"]["stop"]["type"] == "string"


def test_pystac_follows_links_to_files_that_gdal_opens(server):
    catalogue = pystac.Catalog.from_file(f"{server}/stac/catalog.json")
    (mission,) = catalogue.get_children()
    assert mission.id == "MER2"
    items = list(catalogue.get_items(recursive=True))
    assert len(items) == 11  # five of the mission, contours of six stops
    for item in items:
        assert item.properties["ssys:targets"] == ["Mars"]
        assert item.get_collection().id == "MER2"
    stops = next(item for item in items if item.id == "mer2-stops")
    frame = pyogrio.read_dataframe(f"/vsicurl/{stops.assets['data'].get_absolute_href()}")
    assert len(frame) == 12
    west, south, east, north = stops.bbox
    assert (frame.geometry.x.between(west - 1e-6, east + 1e-6)).all()
    assert (frame.geometry.y.between(south - 1e-6, north + 1e-6)).all()
