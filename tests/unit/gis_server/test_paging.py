"""Lists come in pages that join to the whole, and each names the next."""

from urllib.parse import urljoin

import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.gis_server.paging import PAGE
from solmap.products.catalogue.catalogue import Catalogue, MissionEntry
from solmap.products.model import Layer, ProductKind, ProductRef, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from tests.support.large_mission import LANDING, write_mission

STOPS, KINDS = 300, (ProductKind.CONTOURS, ProductKind.HAVENS, ProductKind.MODEL)
"""Of every stop: two layers of the map and a model, which is none."""


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """A server of more layers than a page has: rows of the catalogue, whose files nobody reads."""
    root = tmp_path_factory.mktemp("many") / "store"
    ProductStore.open(root)
    layers = [
        Layer(
            ProductRef(kind, Scope(ScopeLevel.STOP, f"mer2-site0001-drive{k:04d}"), f"{k:016x}"),
            "MER2", str(kind), "model" if kind is ProductKind.MODEL else "vector",
            (5.0 * k, -10.0, 5.0 * k + 4.0, 10.0), None, None, None, (k,), "2026-01-01T00:00:00Z",
        )
        for k in range(STOPS)
        for kind in KINDS
    ]  # fmt: skip
    mission = MissionEntry("MER2", "Many stops", LANDING, None)
    Catalogue.open(root).publish(missions=[mission], layers=layers)
    with TestClient(create_app(root)) as client:
        yield client


@pytest.fixture(scope="module")
def traverse(tmp_path_factory):
    root = tmp_path_factory.mktemp("traverse") / "store"
    write_mission(root, stops=4, images=40, tie_points=20)
    with TestClient(create_app(root)) as client:
        yield client


def pages_from(client, address):
    while address:
        answer = client.get(address)
        assert answer.status_code == 200, answer.text
        yield answer
        following = answer.links.get("next")
        address = following and urljoin(str(answer.url), following["url"])


@pytest.mark.parametrize("limit", [1, 7, 40, 1000])
def test_pages_of_images_join_to_the_whole_and_keep_the_other_parameters(traverse, limit):
    whole = traverse.get("/api/missions/MER2/images?sol=2").json()
    assert len(whole) == 10
    pages = list(pages_from(traverse, f"/api/missions/MER2/images?sol=2&limit={limit}"))
    assert [one for page in pages for one in page.json()] == whole
    assert {page.headers["ogc-numbermatched"] for page in pages} == {"10"}
    assert all(0 < len(page.json()) <= limit for page in pages)


def test_a_list_of_layers_is_paged_and_contains_no_models(many):
    pages = list(pages_from(many, "/api/missions/MER2/layers"))
    assert [len(page.json()) for page in pages] == [PAGE, 2 * STOPS - PAGE]
    named = [one["id"] for page in pages for one in page.json()]
    assert len(set(named)) == 2 * STOPS
    assert named == sorted(named)
    assert pages[1].links["prev"]["url"].endswith("offset=0")


def test_a_page_past_the_end_is_empty_and_links_to_the_one_before(many):
    answer = many.get("/api/missions/MER2/layers?offset=600&limit=100")
    assert answer.json() == []
    assert set(answer.links) == {"prev"}
    assert answer.headers["ogc-numbermatched"] == str(2 * STOPS)


def test_the_start_document_has_the_first_page_and_links_to_the_next(many):
    first = many.get("/api/start")
    rest = list(pages_from(many, urljoin("/api/start", first.links["next"]["url"])))
    joined = [*first.json()["layers"], *(one for page in rest for one in page.json())]
    whole = [one for page in pages_from(many, "/api/missions/MER2/layers") for one in page.json()]
    assert joined == whole
    assert first.json()["missions"][0]["bounds"] == [0.0, -10.0, 5.0 * (STOPS - 1) + 4.0, 10.0]


def test_an_unchanged_page_is_not_sent_again(many):
    page = many.get("/api/missions/MER2/layers?limit=3")
    again = many.get(
        "/api/missions/MER2/layers?limit=3", headers={"If-None-Match": page.headers["etag"]}
    )
    assert (again.status_code, again.links) == (304, page.links)


@pytest.mark.parametrize("query", ["limit=0", "limit=1001", "limit=x", "offset=-1", "offset=9e99"])
@pytest.mark.parametrize("what", ["layers", "images"])
def test_an_invalid_page_is_refused(many, what, query):
    answer = many.get(f"/api/missions/MER2/{what}?{query}")
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
