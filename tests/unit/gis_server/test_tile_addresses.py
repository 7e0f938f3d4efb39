"""Addresses of tiles: which are answered, and how the others are refused."""

import numpy as np
import pytest
from fastapi.testclient import TestClient

from solmap.products.formats.raster.tiling import zoom_of
from solmap.products.model import ProductKind
from tests.support.tile_at import tile_at
from tests.support.value_tiles import decode_values
from tests.unit.gis_server.conftest import CELL_M, STOP, constant, ref_of

OWN_ZOOM = zoom_of(CELL_M)
INSIDE = tile_at(5.0, 5.0, OWN_ZOOM)


def path_of(world, kind, address, form="png"):
    place = f"/tiles/{STOP.name}/{kind}/{ref_of(world, kind).digest}"
    return f"{place}/{address.zoom}/{address.column}/{address.row}.{form}"


@pytest.mark.parametrize(
    ("kind", "query", "faulty"),
    [
        (ProductKind.DTM, "?band=standard_deviation", "band"),
        (ProductKind.SLOPE, "?style=", "style"),
        (ProductKind.DTM, "?style=%C3%A4", "style"),
        (ProductKind.DTM, "?low=nan", "low"),
        (ProductKind.DTM, f"?style={'a' * 500}", "style"),
    ],
)
def test_faulty_queries_are_refused_and_named(client, world, kind, query, faulty):
    answer = client.get(path_of(world, kind, INSIDE) + query)
    assert answer.status_code == 422
    assert [one["loc"] for one in answer.json()["errors"]] == [["query", faulty]]


def test_of_two_values_of_a_parameter_the_last_one_counts(client, world):
    path = path_of(world, ProductKind.DTM, INSIDE)
    both = client.get(f"{path}?style=hillshade&style=slope")
    assert both.content == client.get(f"{path}?style=slope").content


def test_values_are_compressed_for_clients_that_accept_it(client, world):
    path = path_of(world, ProductKind.DTM, INSIDE, "values")
    packed, plain = (
        client.get(path, headers={"accept-encoding": encoding}) for encoding in ("gzip", "identity")
    )
    assert packed.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in plain.headers
    assert packed.content == plain.content  # the client has unpacked it
    assert packed.headers["vary"] == plain.headers["vary"] == "Accept-Encoding"


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
def test_impossible_urls_are_refused(client, world, place):
    ref = ref_of(world, ProductKind.DTM)
    for form in ("png", "values"):
        answer = client.get(f"/tiles/{STOP.name}/dtm/{ref.digest}/{place}.{form}")
        assert answer.status_code in (404, 422)
        assert answer.headers["content-type"] == "application/problem+json"
        assert len(answer.content) < 2000


@pytest.mark.parametrize(
    "place", ["nowhere/dtm/0123456789abcdef", "mer2/sausage/0123456789abcdef", "mer2/dtm/latest"]
)
def test_unknown_layers_are_refused(client, place):
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
