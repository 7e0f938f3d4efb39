"""Parts of layers, STAC and addresses over HTTP."""

import io
import json

import numpy as np
import pyogrio
import pytest
import rasterio

from solmap.products.crs import local_crs
from solmap.products.model import ProductKind
from solmap.products.reports.stac import AcquisitionTimes, write_catalogue, write_items
from tests.support.product_readers import read_stl
from tests.unit.gis_server.conftest import (
    CELL_M,
    LANDING,
    REGION,
    STOP,
    elevation_at,
    plane,
    ref_of,
)


def part_of(client, world, kind, scope=None, **query):
    ref = ref_of(world, kind, scope) if scope else ref_of(world, kind)
    return client.get(f"/download/{ref.scope.name}/{ref.kind}/{ref.digest}/clip", params=query)


def test_a_part_of_a_raster_is_a_geotiff_with_the_same_cells(client, world):
    answer = part_of(client, world, ProductKind.DTM, bbox="1,2,5,9")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("image/tiff")
    with rasterio.open(io.BytesIO(answer.content)) as part:
        west, south, east, north = part.bounds
        assert (west, south) <= (1.0, 2.0)
        assert (east, north) >= (5.0, 9.0)
        rows, cols = np.indices(part.shape)
        places = part.transform * (cols + 0.5, rows + 0.5)
        np.testing.assert_allclose(part.read(1), elevation_at(*places), atol=1e-4)


@pytest.mark.parametrize("form", ["geojson", "gpkg"])
def test_a_part_of_a_vector_layer_is_cut_at_the_box(client, world, tmp_path, form):
    answer = part_of(client, world, ProductKind.FOOTPRINTS, REGION, bbox="0,0,10,10", f=form)
    file = tmp_path / f"part.{form}"
    file.write_bytes(answer.content)
    frame = pyogrio.read_dataframe(file).to_crs(local_crs(LANDING))
    np.testing.assert_allclose(sorted(frame.geometry.area), [16.0, 100.0], rtol=1e-5)


@pytest.mark.parametrize(
    ("query", "status", "text"),
    [
        ({}, 400, "is missing"),
        ({"bbox": "1,2,3"}, 422, ""),
        ({"bbox": "nan,0,1,1"}, 422, ""),
        ({"bbox": "5000,5000,5001,5001"}, 404, "no cell is in the box"),
    ],
)
def test_an_invalid_download_box_is_refused(client, world, query, status, text):
    answer = part_of(client, world, ProductKind.DTM, **query)
    assert answer.status_code == status
    assert text in answer.text


def test_a_box_with_too_many_cells_is_refused_by_number(client, world, monkeypatch):
    monkeypatch.setattr("solmap.products.formats.cropping.MOST_CELLS", 100)
    answer = part_of(client, world, ProductKind.DTM, bbox="0,0,9,9")
    assert answer.status_code == 400
    assert "more than the 100 that may be downloaded at once" in answer.json()["description"]


def test_urls_lead_to_all_downloads(client):
    listed = client.get("/api/missions/MER2/addresses").json()
    services = {one["service"] for one in listed}
    assert {"OGC API Features", "WMTS", "STAC", "Cloud Optimised GeoTIFF"} <= services
    for one in listed:
        url = one["url"].removeprefix("/vsicurl/").removeprefix("OAPIF:")
        if one["service"] != "STAC":  # this store has none yet
            assert client.get(url).status_code == 200, url


def test_the_stac_catalogue_is_served_with_the_files_that_it_points_to(client, world):
    assert client.get("/stac/catalog.json").status_code == 404
    (mission,), layers = world.catalogue.missions(), world.catalogue.layers("MER2")
    taken = AcquisitionTimes.of(layers[0], ["2004-06-11T10:00:00Z"])
    write_items([(layer, taken) for layer in layers], mission, world.store)
    write_catalogue([mission], layers, taken, world.store)
    assert client.get("/stac/catalog.json").json()["type"] == "Catalog"
    collection = client.get("/stac/MER2/collection.json").json()
    items = [link["href"] for link in collection["links"] if link["rel"] == "item"]
    assert len(items) == len(layers)
    item = client.get(f"/stac/MER2/{items[0]}").json()
    for asset in item["assets"].values():
        path = asset["href"].removeprefix("../../")
        assert client.get(f"/{path}").status_code == 200
    data = item["assets"]["data"]["href"].removeprefix("../../")
    head = client.get(f"/{data}", headers={"Range": "bytes=0-3"})
    assert (head.status_code, len(head.content)) == (206, 4)


@pytest.mark.parametrize(
    "path",
    [
        "/stac/MER2/none.json",
        "/stac/../catalogue.sqlite",
        "/stac/MER2/..%2f..%2fcatalogue.json",
        "/products/dtm/none/0123456789abcdef.tif",
        "/products/image/2n140000000effa000p1600l0m1/0123456789abcdef.img",
    ],
)
def test_only_published_products_are_served(client, path):
    assert client.get(path).status_code in {404, 422}


def test_a_product_under_another_suffix_is_not_found(client, world):
    ref = ref_of(world, ProductKind.DTM)
    answer = client.get(f"/products/{ref.kind}/{ref.scope.name}/{ref.digest}.png")
    assert answer.status_code == 404
    assert json.loads(answer.text)["description"].endswith(".tif")


def test_the_terrain_of_a_stop_is_served_as_a_solid(client, world):
    layer = world.catalogue.layer(STOP.name, ProductKind.DTM)
    path = f"/models/{STOP.name}/dtm/{layer.ref.digest}/terrain.stl"
    answer = client.get(path, params={"base_m": 1.0, "tolerance_m": 0.1})
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "model/stl"
    corners = read_stl(answer.content).astype(np.float64)
    a, b, c = np.moveaxis(corners, 1, 0)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    seen = np.isfinite(plane())
    height = plane()[seen] - plane()[seen].min() + 1.0
    assert volume == pytest.approx(height.sum() * CELL_M**2, rel=0.03)
    assert client.get(path, params={"base_m": -1}).status_code == 422
    reported = client.get("/openapi.json").json()["paths"][
        "/models/{scope}/dtm/{digest}/terrain.stl"
    ]
    assert list(reported["get"]["responses"]["200"]["content"]) == ["model/stl"]
    region = ref_of(world, ProductKind.FOOTPRINTS, REGION)
    lost = f"/models/{REGION.name}/dtm/{region.digest}/terrain.stl"
    assert client.get(lost).status_code == 404
