"""OGC API Tiles and WMTS as clients use them: GDAL, OWSLib and OpenLayers query a live server."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from owslib.wmts import WebMapTileService
from pyproj import CRS as ProjCrs
from rasterio.windows import from_bounds

from solmap.products.crs import local_crs
from solmap.products.formats.raster.tiling import CELL_SIZES, TileAddress, zoom_of
from solmap.products.model import ProductKind
from tests.support.live_server import serving
from tests.support.tile_at import tile_at
from tests.unit.gis_server.conftest import (
    CELL_M,
    GRID,
    LANDING,
    STOP,
    UNSEEN_WEST_OF_M,
    SmallWorld,
    brightness,
    build,
)

ROOT = Path(__file__).parents[2]
OPENLAYERS = ROOT / "gis_server" / "viewer" / "node_modules" / "ol"
OWN_ZOOM = zoom_of(CELL_M)
INSIDE = tile_at(5.0, 5.0, OWN_ZOOM)
TMS = "Columbia-Memorial-Station"
ORTHOPHOTO = f"{STOP.name}.orthophoto"


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> SmallWorld:
    return build(tmp_path_factory.mktemp("tiles"))


@pytest.fixture(scope="module")
def server(world: SmallWorld) -> Iterator[str]:
    with serving(world.root) as address:
        yield address


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """GDAL caches answers of a WMTS in the folder it runs in."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def ogc(server: str) -> str:
    return f"{server}/ogc/MER2"


def read(address: str) -> bytes:
    with urllib.request.urlopen(address) as answer:
        return answer.read()


def document(address: str) -> dict:
    return json.loads(read(address))


def refusal(address: str) -> tuple[int, str]:
    with pytest.raises(urllib.error.HTTPError) as caught:
        read(address)
    with caught.value as answer:
        return answer.code, answer.read().decode()


def pixels(body: bytes) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED)
    return image[:, :, [2, 1, 0, 3]]


def expected_grey() -> np.ndarray:
    """Of every cell of the orthophoto, 0 where nothing was seen."""
    return np.nan_to_num(np.rint(brightness() / 254 * 254) + 1, nan=0.0)


@pytest.mark.parametrize("zoom_out", [0, 1])
def test_gdal_opens_the_wmts_and_finds_the_orthophoto_at_its_coordinates(server, zoom_out):
    capabilities = f"{server}/ogc/MER2/wmts/1.0.0/WMTSCapabilities.xml"
    name = f"WMTS:{capabilities},layer={ORTHOPHOTO}"
    with rasterio.open(name) as dataset:
        assert dataset.res[0] == pytest.approx(CELL_SIZES[-1])  # GDAL counts all levels of the set
        assert CELL_M / dataset.res[0] in dataset.overviews(1)
        bounds = (-10.0, -5.0, 10.0, 5.0)
        window = from_bounds(*bounds, transform=dataset.transform)
        shape = round(10.0 / CELL_M) >> zoom_out, round(20.0 / CELL_M) >> zoom_out
        shown = dataset.read(1, window=window, out_shape=shape)
    row, col = round((GRID.north - 5.0) / CELL_M), round((-10.0 - GRID.west) / CELL_M)
    whole = expected_grey()[row : row + 125, col : col + 250]
    step = 2**zoom_out
    trimmed = whole[: shape[0] * step, : shape[1] * step]
    averaged = trimmed.reshape(shape[0], step, shape[1], step).mean(axis=(1, 3))
    assert np.abs(shown - averaged).max() <= 3.0


def _parameters(crs: ProjCrs) -> dict[str, float]:
    return {one.name: one.value for one in crs.coordinate_operation.params}


def test_gdal_accepts_the_proj_string_for_the_local_crs(server):
    capabilities = f"{server}/ogc/MER2/wmts?service=WMTS&request=GetCapabilities"
    with rasterio.open(f"WMTS:{capabilities},layer={ORTHOPHOTO}") as dataset:
        found = ProjCrs.from_wkt(dataset.crs.to_wkt())
        bounds = dataset.bounds
    local = local_crs(LANDING)
    assert found.ellipsoid.semi_major_metre == local.ellipsoid.semi_major_metre
    assert found.ellipsoid.inverse_flattening == 0.0
    assert _parameters(found) == _parameters(local)
    np.testing.assert_allclose(bounds, GRID.bounds, atol=CELL_M)


def test_owslib_reads_the_capabilities_and_gets_a_tile_by_parameters(ogc, world):
    service = WebMapTileService(f"{ogc}/wmts")
    layer = service.contents[f"{STOP.name}.dtm"]
    assert {"default", "hillshade", "north-facing"} <= set(layer.styles)
    assert layer.styles["default"]["isDefault"]
    matrices = service.tilematrixsets[TMS].tilematrix
    assert float(matrices[str(OWN_ZOOM)].scaledenominator) == pytest.approx(CELL_M / 0.00028)
    limits = layer.tilematrixsetlinks[TMS].tilematrixlimits[str(OWN_ZOOM)]
    assert limits.mintilecol <= INSIDE.column <= limits.maxtilecol
    assert limits.mintilerow <= INSIDE.row <= limits.maxtilerow
    answer = service.gettile(
        layer=f"{STOP.name}.dtm",
        style="hillshade",
        tilematrixset=TMS,
        tilematrix=str(OWN_ZOOM),
        row=INSIDE.row,
        column=INSIDE.column,
        format="image/png",
    )
    ref = world.catalogue.layer(STOP.name, ProductKind.DTM).ref
    place = f"tiles/{STOP.name}/dtm/{ref.digest}/{OWN_ZOOM}/{INSIDE.column}/{INSIDE.row}.png"
    root = ogc.removesuffix("/ogc/MER2")
    assert answer.read() == read(f"{root}/{place}?style=hillshade")
    legend = layer.styles["hillshade"]["legend"]
    assert read(legend).startswith(b"\x89PNG")


OPENLAYERS_SCRIPT = """
import OGCMapTile from "ol/source/OGCMapTile.js";
import Projection from "ol/proj/Projection.js";
import { addProjection } from "ol/proj.js";
globalThis.XMLHttpRequest = class extends EventTarget {  // Node has only fetch
  open(_method, url) { this.url = url; }
  setRequestHeader() {}
  async send() {
    const answer = await fetch(this.url);
    this.status = answer.status;
    this.responseText = await answer.text();
    this.dispatchEvent(new Event("load"));
  }
};
const projection = new Projection({ code: "local", units: "m" });
projection.setGetPointResolution((resolution) => resolution);
addProjection(projection);
const source = new OGCMapTile({ url: process.argv[2], projection });
source.on("change", () => {
  if (source.getState() === "loading") return;
  if (source.getState() === "error") {
    console.error(String(source.error_ ?? "the tileset was refused"));
    process.exit(1);
  }
  const grid = source.getTileGrid();
  const [east, north, zoom] = process.argv.slice(3).map(Number);
  const at = grid.getTileCoordForCoordAndZ([east, north], zoom);
  const url = source.getTileUrlFunction()(at, 1, projection);
  console.log(JSON.stringify({ at, url, resolution: grid.getResolution(zoom) }));
  process.exit(0);
});
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="OpenLayers runs in Node")
@pytest.mark.skipif(not OPENLAYERS.is_dir(), reason="the viewer's packages are not installed")
@pytest.mark.parametrize("style", ["map/tiles", "styles/slope/map/tiles"])
def test_openlayers_reads_the_tileset_and_requests_the_tile_of_a_place(ogc, style):
    script = OPENLAYERS.parent / ".ogc-map-tile.mjs"  # where imports find the package
    script.write_text(OPENLAYERS_SCRIPT)
    address = f"{ogc}/collections/{STOP.name}.dtm/{style}/{TMS}"
    try:
        found = subprocess.run(
            ["node", str(script), address, "5", "5", str(OWN_ZOOM)],  # noqa: S607
            capture_output=True,
            check=False,
            text=True,
            timeout=60,
        )
    finally:
        script.unlink()
    assert found.returncode == 0, found.stderr
    reported = json.loads(found.stdout)
    assert reported["resolution"] == CELL_M
    assert reported["at"] == [OWN_ZOOM, INSIDE.column, INSIDE.row]
    shown = pixels(read(reported["url"]))
    assert shown.shape == (256, 256, 4)
    assert shown[..., 3].any()


def test_tilesets_are_found_by_links_from_the_landing_page(ogc):
    landing = document(ogc)
    rels = {one["rel"]: one["href"] for one in landing["links"]}
    scheme = "http://www.opengis.net/def/rel/ogc/1.0/tiling-schemes"
    (listed,) = document(rels[scheme])["tileMatrixSets"]
    tms = document(listed["links"][0]["href"])
    assert tms["tileMatrices"][OWN_ZOOM]["cellSize"] == CELL_M
    collections = document(rels["data"])["collections"]
    maps = [one for one in collections if one.get("dataType") == "map"]
    assert {f"{STOP.name}.{kind}" for kind in ("dtm", "orthophoto", "slope")} <= {
        one["id"] for one in maps
    }
    for one in maps:
        self = next(link["href"] for link in one["links"] if link["rel"] == "self")
        assert document(self) == one
        tilesets = next(link["href"] for link in one["links"] if "tilesets-map" in link["rel"])
        (tileset,) = document(tilesets)["tilesets"]
        described = document(tileset["links"][0]["href"])
        assert described["tileMatrixSetLimits"][-1]["tileMatrix"] == str(OWN_ZOOM)
        item = next(link for link in described["links"] if link["rel"] == "item")
        limit = described["tileMatrixSetLimits"][-1]
        address = item["href"].format(
            tileMatrix=limit["tileMatrix"],
            tileRow=limit["minTileRow"],
            tileCol=limit["maxTileCol"],
        )
        assert pixels(read(address)).shape == (256, 256, 4)
    classes = document(f"{ogc}/conformance")["conformsTo"]
    assert "http://www.opengis.net/spec/ogcapi-tiles-1/1.0/conf/core" in classes


def test_tile_limits_cover_all_ground_and_no_extra_row_or_column(ogc):
    described = document(f"{ogc}/collections/{ORTHOPHOTO}/map/tiles/{TMS}")
    assert [one["tileMatrix"] for one in described["tileMatrixSetLimits"]] == [
        str(zoom) for zoom in range(OWN_ZOOM + 1)
    ]
    limit = described["tileMatrixSetLimits"][-1]
    north_west = TileAddress(OWN_ZOOM, limit["minTileCol"], limit["minTileRow"]).bounds
    south_east = TileAddress(OWN_ZOOM, limit["maxTileCol"], limit["maxTileRow"]).bounds
    west, south, east, north = GRID.bounds
    assert (north_west[0], north_west[3]) == (west, north)
    assert (south_east[2], south_east[1]) == (east, south)


def test_the_latest_tile_is_revalidated_and_not_sent_again(ogc):
    address = (
        f"{ogc}/collections/{STOP.name}.dtm/map/tiles/{TMS}/{OWN_ZOOM}/{INSIDE.row}/{INSIDE.column}"
    )
    with urllib.request.urlopen(address) as answer:
        tag, first = answer.headers["ETag"], answer.read()
        assert answer.headers["Cache-Control"] == "no-cache"
    again = urllib.request.Request(address, headers={"If-None-Match": tag})
    with pytest.raises(urllib.error.HTTPError) as caught:
        urllib.request.urlopen(again)
    with caught.value as answer:
        assert answer.code == 304
    styled = urllib.request.Request(f"{address}?style=slope", headers={"If-None-Match": tag})
    with urllib.request.urlopen(styled) as answer:
        assert answer.read() != first


def test_unseen_ground_is_transparent_for_every_client(ogc):
    address = tile_at(UNSEEN_WEST_OF_M - 0.01, 0.1, OWN_ZOOM)
    path = f"{OWN_ZOOM}/{address.row}/{address.column}"
    shown = pixels(read(f"{ogc}/collections/{ORTHOPHOTO}/map/tiles/{TMS}/{path}"))
    east = address.west_north[0] + (np.arange(256) + 0.5) * CELL_M
    np.testing.assert_array_equal(shown[0, :, 3] > 0, east > UNSEEN_WEST_OF_M)


@pytest.mark.parametrize(
    ("path", "status", "content"),
    [
        ("collections/{map}/map/tiles/WebMercatorQuad/3/1/1", 404, "no tile matrix set WebMerc"),
        ("collections/nowhere.dtm/map/tiles/{tms}/3/1/1", 404, "no dtm of nowhere"),
        ("collections/dtm/map/tiles/{tms}/3/1/1", 404, "MER2 has no map dtm"),
        ("collections/{map}/styles/jet/map/tiles/{tms}/3/1/1", 422, "has no style jet"),
        ("collections/{map}/map/tiles/{tms}/21/1/1", 422, "less than or equal to 20"),
        ("collections/{map}/map/tiles/{tms}/3/8/1", 404, "columns and rows 0 to 7"),
        ("collections/{map}/map/tiles/{tms}/3/99999999999999999999999/1", 404, "columns and rows"),
        ("collections/{map}/map/tiles/{tms}/3/1/1?f=tiff", 422, "'png'"),
        ("collections/{map}/map/tiles/{tms}/3/1/1?low=nan", 422, "low"),
    ],
)
def test_unknown_resources_are_refused_with_the_reason(ogc, path, status, content):
    code, text = refusal(f"{ogc}/{path.format(map=ORTHOPHOTO, tms=TMS)}")
    assert code == status
    assert content in text


GET_TILE = {
    "service": "WMTS",
    "request": "GetTile",
    "layer": ORTHOPHOTO,
    "tilematrixset": TMS,
    "tilematrix": "3",
    "tilerow": "3",
    "tilecol": "3",
}


@pytest.mark.parametrize(
    ("changed", "code", "content"),
    [
        ({"request": "GetMap"}, "OperationNotSupported", "request=GetMap is neither"),
        ({"layer": ""}, "MissingParameterValue", "GetTile requires the parameter layer"),
        ({"layer": "moon"}, "InvalidParameterValue", "MER2 has no map moon"),
        ({"style": "sepia"}, "InvalidParameterValue", "has no style sepia"),
        ({"tilematrix": "1e9"}, "InvalidParameterValue", "tilematrix=1e9 is not a whole number"),
        ({"tilerow": "8"}, "TileOutOfRange", "columns and rows 0 to 7"),
        ({"tilecol": "-1"}, "InvalidParameterValue", "tilecol=-1 is not a whole number"),
        ({"format": "image/jpeg"}, "InvalidParameterValue", "format=image/jpeg is not"),
    ],
)
def test_an_invalid_wmts_request_gets_an_exception_report(ogc, changed, code, content):
    query = urllib.parse.urlencode({**GET_TILE, **changed})
    status, text = refusal(f"{ogc}/wmts?{query}")
    assert status == 400
    assert f'exceptionCode="{code}"' in text
    assert content in text


def test_the_exception_report_on_an_unknown_style_locates_it_in_the_style(ogc):
    query = urllib.parse.urlencode({**GET_TILE, "style": "sepia"})
    assert 'locator="style"' in refusal(f"{ogc}/wmts?{query}")[1]


def test_parameters_of_wmts_may_be_written_in_any_case(ogc):
    query = urllib.parse.urlencode({name.upper(): value for name, value in GET_TILE.items()})
    assert pixels(read(f"{ogc}/wmts?{query}")).shape == (256, 256, 4)
    assert b"<Contents>" in read(f"{ogc}/wmts?SERVICE=wmts&REQUEST=getcapabilities")
    assert io.BytesIO(read(f"{ogc}/wmts/1.0.0/WMTSCapabilities.xml")).read(5) == b"<?xml"
