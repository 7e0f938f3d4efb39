"""Documents of OGC API Tiles and WMTS, and that they follow what is published."""

import pytest
from fastapi.testclient import TestClient
from hypothesis import given
from hypothesis import strategies as st

from solmap.gis_server.app import create_app
from solmap.gis_server.ogc.tilesets import limits_at
from solmap.products.formats.raster.tiling import MAX_ZOOM
from solmap.products.model import ProductKind
from tests.support.tile_at import tile_at
from tests.unit.gis_server.conftest import STOP, constant

PLACES = st.integers(-400_000, 400_000).map(lambda halves: halves / 200.0)
"""Half cells of the finest zoom: no corner is nearer to the edge of a tile unless it lies on it."""


@given(
    zoom=st.integers(0, MAX_ZOOM),
    one=st.tuples(PLACES, PLACES),
    other=st.tuples(PLACES, PLACES),
)
def test_limits_are_those_of_the_tiles_of_the_corners(zoom, one, other):
    (west, south), (east, north) = one, (other[0] + 4_001.0, other[1] + 4_001.0)
    limit = limits_at(zoom, (west, south, east, north))
    inside = 1e-6
    north_west = tile_at(west + inside, north - inside, zoom)
    south_east = tile_at(east - inside, south + inside, zoom)
    assert (limit["minTileCol"], limit["minTileRow"]) == (north_west.column, north_west.row)
    assert (limit["maxTileCol"], limit["maxTileRow"]) == (south_east.column, south_east.row)


@pytest.fixture
def published(own_world):
    with TestClient(create_app(own_world.root)) as opened:
        yield own_world, opened


def test_a_layer_is_in_every_list_as_soon_as_it_is_published(published):
    world, client = published
    name = f"{STOP.name}.roughness"
    lists = ("/ogc/MER2/wmts/1.0.0/WMTSCapabilities.xml", "/ogc/MER2/collections")
    for path in lists:
        assert name not in client.get(path).text
    assert client.get(f"/ogc/MER2/collections/{name}").status_code == 404
    world.publish_raster(ProductKind.ROUGHNESS, STOP, constant(0.02))
    for path in lists:
        assert name in client.get(path).text
    assert client.get(f"/ogc/MER2/collections/{name}").json()["id"] == name


def test_rasters_are_listed_apart_from_features(published):
    _, client = published
    known = client.get("/ogc/MER2/collections").json()
    assert {one["itemType"] for one in known["collections"]} == {"feature"}
    drawn = client.get("/ogc/MER2/maps").json()["collections"]
    assert {one["dataType"] for one in drawn} == {"map"}
    linked = [one["href"] for one in known["links"] if one["rel"] == "item"]
    assert linked == [one["links"][0]["href"] for one in drawn]


def test_the_landing_page_links_to_every_mission(published):
    _, client = published
    children = [one for one in client.get("/ogc").json()["links"] if one["rel"] == "child"]
    assert [one["title"] for one in children] == [
        one["title"] for one in client.get("/api/missions").json()
    ]
    for one in children:
        assert client.get(one["href"]).json()["title"] == one["title"]
    page = client.get("/ogc", headers={"accept": "text/html"})
    assert page.headers["content-type"].startswith("text/html")
    assert children[0]["href"] in page.text


def test_a_name_means_the_latest_version_and_its_etag_changes_with_it(published):
    world, client = published
    tms = "Columbia-Memorial-Station"
    tile = f"/ogc/MER2/collections/{STOP.name}.slope/map/tiles/{tms}/13/4096/4096"
    first = client.get(tile)
    again = client.get(tile, headers={"if-none-match": first.headers["etag"]})
    assert again.status_code == 304
    assert again.content == b""
    world.publish_raster(ProductKind.SLOPE, STOP, constant(35.0), version=1)
    newer = client.get(tile, headers={"if-none-match": first.headers["etag"]})
    assert newer.status_code == 200
    assert newer.content != first.content
    assert newer.headers["etag"] != first.headers["etag"]


def test_a_layer_of_another_mission_is_not_shown_under_this_one(published):
    _, client = published
    assert client.get(f"/ogc/MSL/collections/{STOP.name}.dtm/map/tiles").status_code == 404
