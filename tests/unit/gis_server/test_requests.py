"""What holds for every request: HEAD as GET, ranges, bodies that never end, and listeners."""

from __future__ import annotations

import asyncio
import re

import pytest
from fastapi.testclient import TestClient
from hypothesis import given
from hypothesis import strategies as st

from solmap.gis_server import middleware
from solmap.gis_server.app import create_app
from solmap.gis_server.live import EventTail, TooManyListenersError
from solmap.gis_server.middleware import LimitBodies, readable_ranges
from solmap.products.model import ProductKind
from tests.unit.gis_server.conftest import ref_of


def addresses(client, world):
    """One address of every GET route, most of them of things that there are."""
    ref = ref_of(world, ProductKind.DTM)
    names = {
        "mission": "MER2",
        "scope": ref.scope.name,
        "kind": "dtm",
        "digest": ref.digest,
        **dict.fromkeys(("z", "x", "y", "zoom", "row", "column", "sol"), "0"),
    }
    for path, operations in client.get("/openapi.json").json()["paths"].items():
        if "get" in operations:
            yield re.sub(r"\{(\w+)\}", lambda found: names.get(found[1], "nothing"), path)


def test_head_is_answered_like_get_without_a_body_by_every_route(client, world):
    found = [one for one in addresses(client, world) if one != "/api/events"]
    assert len(found) > 60
    for address in (*found, "/", "/docs", "/openapi.json"):
        head, get = client.head(address), client.get(address)
        assert head.status_code == get.status_code, address
        assert head.headers.get("content-type") == get.headers.get("content-type"), address
        assert not head.content
        if address not in {"/metrics", "/docs"}:
            assert head.headers.get("content-length") == get.headers.get("content-length"), address


def test_head_of_the_event_stream_ends(client):
    assert client.head("/api/events").headers["content-type"].startswith("text/event-stream")


DIGITS = "9" * 5000


@pytest.mark.parametrize(
    ("requested", "meant"),
    [
        (b"bytes=0-99", b"bytes=0-99"),
        (b"bytes = 5- , -7", b"bytes=5-,-7"),
        (f"bytes=0-{DIGITS}".encode(), b"bytes=0-" + b"9" * 18),
        (f"bytes={DIGITS}-".encode(), b"bytes=" + b"9" * 18 + b"-"),
        (b"bytes=7-5", None),
        (b"bytes=-", None),
        (b"bytes=a-b", None),
        (b"bytes=1-2-3", None),
        (b"bytes", None),
        (b"lines=1-2", None),
        (b"bytes=\xb2-", None),
    ],
)
def test_invalid_ranges_are_ignored_and_endless_numbers_shortened(requested, meant):
    assert readable_ranges(requested) == meant


@pytest.mark.parametrize(
    ("requested", "status"),
    [
        (f"bytes=0-{DIGITS}", 206),
        (f"bytes=-{DIGITS}", 206),
        (f"bytes={DIGITS}-", 416),
        ("bytes=9-3", 200),
        ("bytes=-0", 416),
        ("bytes=x", 200),
        ("pages=1-2", 200),
    ],
)
def test_a_file_is_served_by_any_range(client, world, requested, status):
    ref = ref_of(world, ProductKind.DTM)
    address = f"/download/{ref.scope.name}/{ref.kind}/{ref.digest}"
    answer = client.get(address, headers={"Range": requested})
    assert answer.status_code == status
    if status == 416:
        assert answer.headers["content-range"].startswith("bytes */")


@given(st.text(alphabet="bytes=-,0123456789 \t", max_size=60))
def test_any_requested_range_is_ignored_or_satisfied(requested):
    found = readable_ranges(requested.encode())
    again = found and readable_ranges(found)
    assert again == found


def test_a_length_of_five_thousand_digits_is_too_large(client):
    answer = client.get("/api/missions", headers={"Content-Length": DIGITS})
    assert answer.status_code == 413


def test_a_body_that_does_not_arrive_is_given_up(monkeypatch):
    monkeypatch.setattr(middleware, "BODY_S", 0.05)

    async def app(_scope, receive, _send):
        await receive()

    async def request():
        sent = []

        async def never():
            await asyncio.sleep(60)

        async def note(message):
            sent.append(message)

        scope = {"type": "http", "method": "POST", "headers": [], "path": "/"}
        await asyncio.wait_for(LimitBodies(app)(scope, never, note), 5.0)
        return sent[0]["status"]

    assert asyncio.run(request()) == 408


def test_an_event_number_beyond_64_bits_counts_as_unseen(own_world):
    with TestClient(create_app(own_world.root)) as client:
        seen = {"Last-Event-ID": "9" * 20}
        assert client.head("/api/events", headers=seen).status_code == 200
        tail = client.app.state.services.tail
        assert client.portal.call(tail.events_after, 2**63 - 1) in ([], None)


def test_one_client_does_not_take_the_places_of_all_listeners(world):
    async def crowd():
        tail = EventTail(world.catalogue.engine, most_of_one=1)
        async with tail.listening("a"), tail.listening("b"):
            with pytest.raises(TooManyListenersError, match="1 browsers of yours listen") as found:
                async with tail.listening("a"):
                    pass
        return found.value.are_of_client

    assert asyncio.run(crowd())
