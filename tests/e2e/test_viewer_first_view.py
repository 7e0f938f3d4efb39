"""The first view requests what it shows; the rest of the page loads after it is drawn."""

from __future__ import annotations

import urllib.request
from pathlib import PurePosixPath

import pytest

from tests.support.browsing import DIST, at, load
from tests.support.first_view import first_view

LATEST_MS = 4000
"""The rest of the page comes then even where the map is not drawn (`session.ts`)."""

LEAST_BYTES = 1000
"""Files from this size on are compressed (`vite.config.ts`)."""


@pytest.fixture(scope="module")
def view(chromium, url):
    first_view(chromium, url)  # the server has read its files
    return first_view(chromium, url)


def test_the_first_drawing_requests_only_what_the_map_shows(view):
    page = [path for path in view.first_requested if path.startswith("/assets/")]
    data = [path for path in view.first_requested if path.startswith("/api/")]
    tiles = [path for path in view.first_requested if path.startswith("/tiles/")]
    assert {PurePosixPath(path).suffix for path in page} == {".css", ".js"}
    assert not [path for path in page if "later-parts" in path or "editor" in path]
    assert data[0] == "/api/start"
    shown = {"stops", "traverse", "contours"}
    assert {path.split("/")[4] for path in data[1:]} == shown
    assert len(data) == 1 + len(shown)
    assert {path.split("/")[3] for path in tiles} == {"hillshade", "orthophoto"}
    assert len(view.first_requested) == len(page) + len(data) + len(tiles)


def test_tiles_are_of_the_view_and_requested_once(view):
    tiles = [one["path"] for one in view.requested if one["path"].startswith("/tiles/")]
    assert len(tiles) == len(set(tiles))
    assert len(tiles) <= 2 * 4 * 4  # two layers, a map of 664 x 732 pixels, tiles of 256


def test_the_rest_of_the_page_loads_after_the_map(view):
    later = [one["path"] for one in view.requested if one["start"] >= view.painted_ms]
    assert any("later-parts" in path for path in later)
    assert any(path.endswith("/images") for path in later)


@pytest.mark.parametrize("kind", [pytest.param("footprints", marks=pytest.mark.slow), "stops"])
def test_later_parts_load_after_the_page_is_drawn(page, url, kind):
    def late(route) -> None:
        page.wait_for_timeout(LATEST_MS + 500)
        route.continue_()

    page.route(f"**/mer2/{kind}/*/features.geojson*", late)
    page.goto("about:blank")
    page.goto(url + at(0.1, f"mer2/{kind}"))
    page.wait_for_selector('html[data-ready="true"]', state="attached", timeout=20_000)
    spans = page.evaluate(
        """() => Object.fromEntries(
          performance.getEntriesByType("mark").concat(performance.getEntriesByType("resource"))
            .map((one) => [one.name.split("/").pop(), one.responseEnd || one.startTime]))"""
    )
    parts = next(end for name, end in spans.items() if name.startswith("later-parts"))
    assert parts < spans["map painted"]


def test_the_browser_logs_no_error(page, url):
    message_: list[str] = []
    page.on("console", lambda message: message_.append(f"{message.text} {message.location['url']}"))
    load(page, url)
    no_network = ("/solutions", "/network")  # the bowl was mapped without one
    assert [text for text in message_ if not text.endswith(no_network)] == []


def test_the_first_view_takes_less_than_a_second_of_processor(view):
    # By the clock, on an idle machine: docs/reference/measurements/viewer.md.
    assert view.main_thread_ms < 1000


def test_script_and_style_are_precompressed_and_cached_forever(view, url):
    pages = [path for path in view.first_requested if path.startswith("/assets/")]
    large = [path for path in pages if (DIST / path[1:]).stat().st_size >= LEAST_BYTES]
    assert {PurePosixPath(path).suffix for path in large} == {".css", ".js"}
    for path in large:
        for encoding, suffix in (("br, gzip", ".br"), ("gzip", ".gz")):
            request = urllib.request.Request(url + path, headers={"Accept-Encoding": encoding})
            with urllib.request.urlopen(request) as answer:
                body = answer.read()
                assert "immutable" in answer.headers["cache-control"]
                assert answer.headers["vary"] == "Accept-Encoding"
            assert body == (DIST / f"{path[1:]}{suffix}").read_bytes()
        with urllib.request.urlopen(url + path) as plain:
            assert "content-encoding" not in plain.headers
            assert plain.read() == (DIST / path[1:]).read_bytes()


def test_scripts_until_the_map_is_drawn_are_at_most_160_kb(view):
    scripts = {one["path"]: one["bytes"] for one in view.requested if one["path"].endswith(".js")}
    first = [path for path in scripts if path in view.first_requested]
    assert 0 < sum(scripts[path] for path in first) <= 160_000
    assert len(first) <= 3


def test_the_page_itself_is_revalidated(url):
    with urllib.request.urlopen(url) as answer:
        assert answer.headers["cache-control"] == "no-cache"
