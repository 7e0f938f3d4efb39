"""The server as a separate process, queried by GDAL over HTTP."""

from __future__ import annotations

import json
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pyogrio
import pytest
import rasterio
from pyproj import CRS as ProjCrs
from rasterio.windows import Window

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.products.catalogue.catalogue import Catalogue, MissionEntry
from solmap.products.crs import MARS, LandingPoint, local_crs
from solmap.products.formats.raster.raster import write_raster
from solmap.products.formats.vector.geojson import Feature, write_features
from solmap.products.model import Layer, ProductKind, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from tests.support.live_server import serving

LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
GRID = MapGrid.covering((-60.0, -60.0, 60.0, 60.0), 0.08)
REGION = Scope(ScopeLevel.REGION, "mer2")
STOP_AT = (12.5, -7.25)


def elevation() -> np.ndarray:
    east, north = GRID.centres()
    return (0.1 * east[None, :] + 0.05 * north[:, None]).astype(np.float32)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("served")
    store, catalogue = ProductStore.open(folder), Catalogue.open(folder)
    dtm = store.make(
        Recipe(ProductKind.DTM, REGION),
        lambda path: write_raster(
            path, GRID, {"elevation": elevation()}, local_crs(LANDING), unit="m"
        ),
    )
    stop = Feature("Point", np.array([[*STOP_AT, 1.0]]), {"site": 10})
    stops = store.make(
        Recipe(ProductKind.STOPS, REGION), lambda path: write_features(path, [stop], LANDING)
    )
    made = "2026-01-01T00:00:00+00:00"
    catalogue.publish(
        missions=[MissionEntry("MER2", "Spirit", LANDING, None)],
        layers=[
            Layer(dtm, "MER2", "DTM", "raster", GRID.bounds, 0.08, "m", (-9.0, 9.0), (156,), made),
            Layer(
                stops, "MER2", "Stops", "vector", (*STOP_AT, *STOP_AT), None, None, None, (), made
            ),
        ],
    )
    return folder


@pytest.fixture(scope="module")
def server(root: Path) -> Iterator[str]:
    with serving(root) as address:
        yield address


def layers(server: str) -> dict[str, dict]:
    with urllib.request.urlopen(f"{server}/api/missions/MER2/layers") as answer:
        return {layer["kind"]: layer for layer in json.load(answer)}


def test_gdal_reads_a_window_of_the_terrain_model_by_http_ranges(server):
    address = f"/vsicurl/{server}{layers(server)['dtm']['download']}"
    with (
        rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"),
        rasterio.open(address) as dataset,
    ):
        assert ProjCrs.from_wkt(dataset.crs.to_wkt(version="WKT2_2019")).equals(local_crs(LANDING))
        window = Window(300, 500, 40, 30)
        np.testing.assert_array_equal(dataset.read(1, window=window), elevation()[500:530, 300:340])
        overview = dataset.read(1, out_shape=(GRID.rows // 4, GRID.cols // 4))
    expected = elevation().reshape(GRID.rows // 4, 4, GRID.cols // 4, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(overview, expected, atol=1e-5)


def test_gdal_reads_the_features_over_http_as_features_of_mars(server):
    address = f"/vsicurl/{server}{layers(server)['stops']['download']}"
    frame = pyogrio.read_dataframe(address)
    assert ProjCrs(frame.crs).equals(ProjCrs(MARS), ignore_axis_order=True)
    point = frame.to_crs(local_crs(LANDING)).geometry.iloc[0]
    assert (point.x, point.y) == pytest.approx(STOP_AT, abs=1e-4)


def test_one_connection_gets_many_tiles(server):
    """A lost TCP_NODELAY costs 40 ms an answer on a connection that is kept: it would show here."""

    address = layers(server)["dtm"]["tiles"].format(z=17, x=65536, y=65535)
    with httpx.Client(base_url=server) as client:
        client.get(address)
        seconds = []
        for _ in range(20):
            started = time.perf_counter()
            assert client.get(address).status_code == 200
            seconds.append(time.perf_counter() - started)
    assert np.median(seconds) < 0.03, f"median {1e3 * np.median(seconds):.1f} ms"
