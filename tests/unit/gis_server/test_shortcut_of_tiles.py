"""Tiles take a way of their own through the server; it leads to what the ordinary one does."""

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from solmap.gis_server.errors import install_error_table
from solmap.gis_server.rendering.tiles import decode_values
from solmap.gis_server.routes import tiles
from solmap.gis_server.services import open_services
from solmap.products.formats.raster.tiling import TileAddress, zoom_of
from solmap.products.model import ProductKind
from tests.support.pictures import unpacked
from tests.unit.gis_server.conftest import CELL_M, STOP, constant, ref_of

OWN_ZOOM = zoom_of(CELL_M)
INSIDE = TileAddress.holding(5.0, 5.0, OWN_ZOOM)


@pytest.fixture(scope="module")
def ordinary(world):
    """The routes alone."""
    app = FastAPI()
    app.state.services = open_services(world.root)
    install_error_table(app)
    app.include_router(tiles.router)
    with TestClient(app) as opened:
        yield opened


def path_of(world, kind, address, form="png"):
    place = f"/tiles/{STOP.name}/{kind}/{ref_of(world, kind).digest}"
    return f"{place}/{address.zoom}/{address.column}/{address.row}.{form}"


@pytest.mark.parametrize("form", ["png", "values"])
@pytest.mark.parametrize(
    ("kind", "query"),
    [
        (ProductKind.DTM, ""),
        (ProductKind.DTM, "?style=hillshade&azimuth=12.5"),
        (ProductKind.DTM, "?band=standard_deviation"),
        (ProductKind.ORTHOPHOTO, "?low=10&high=200"),
        (ProductKind.SLOPE, "?style="),
        (ProductKind.DTM, "?style=hillshade&style=slope"),
        (ProductKind.DTM, "?style=%C3%A4"),
        (ProductKind.DTM, "?low=nan"),
        (ProductKind.DTM, f"?style={'a' * 500}"),
    ],
)
def test_both_ways_answer_alike(client, ordinary, world, kind, query, form):
    path = path_of(world, kind, INSIDE, form) + query
    for encoding in ("gzip", "identity"):
        asked = {"accept-encoding": encoding}
        short, long = (one.get(path, headers=asked) for one in (client, ordinary))
        assert short.status_code == long.status_code
        assert unpacked(short.content) == unpacked(long.content)
        for name in ("content-type", "cache-control", "vary", "content-encoding"):
            assert short.headers.get(name) == long.headers.get(name)


@pytest.mark.parametrize(
    "place",
    [
        "99/1/1",
        "9999999999/1/1",
        "17/-1/0",
        "17/1/1e9",
        f"17/{10**30}/0",
        "17/131072/0",
        "17/٣/0",
        "17/1/%00",
        "17/../0",
        "0x11/1/1",
    ],
)
def test_absurd_addresses_are_refused(client, world, place):
    ref = ref_of(world, ProductKind.DTM)
    for form in ("png", "values"):
        answer = client.get(f"/tiles/{STOP.name}/dtm/{ref.digest}/{place}.{form}")
        assert answer.status_code in (404, 422)
        assert answer.headers["content-type"] == "application/json"
        assert len(answer.content) < 2000


@pytest.mark.parametrize(
    "place", ["nowhere/dtm/0123456789abcdef", "mer2/sausage/0123456789abcdef", "mer2/dtm/latest"]
)
def test_layers_that_are_not_there_are_refused(client, place):
    answer = client.get(f"/tiles/{place}/3/1/1.png")
    assert answer.status_code in (404, 422)
    assert answer.headers["cache-control"] == "no-store"


def test_tiles_have_the_headers_of_all_answers(client, world):
    answer = client.get(path_of(world, ProductKind.DTM, INSIDE))
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "content-security-policy" in answer.headers


def test_a_layer_published_later_has_tiles_at_once(own_world):
    from solmap.gis_server.app import create_app  # noqa: PLC0415

    with TestClient(create_app(own_world.root)) as client:
        missing = f"/tiles/{STOP.name}/slope/0123456789abcdef/{OWN_ZOOM}/{INSIDE.column}/1.png"
        assert client.get(missing).status_code == 404
        layer = own_world.publish_raster(ProductKind.SLOPE, STOP, constant(33.0), version=9)
        path = f"/tiles/{STOP.name}/slope/{layer.ref.digest}/{OWN_ZOOM}"
        answer = client.get(f"{path}/{INSIDE.column}/{INSIDE.row}.values")
        np.testing.assert_allclose(decode_values(answer.content), 33.0, atol=0.01)
