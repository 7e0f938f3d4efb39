"""Twelve tasks, and how many clicks or keystrokes each takes from the map as it opens.

A click on the page counts 1, a key or a combination of keys 1, a text that is typed (a coordinate,
a name) 1, whatever its length. `pytest -s` prints the counts, docs/reference/viewer.md has them.
"""

from __future__ import annotations

import pytest

from tests.support.browsing import at, look, pixel_of, until

RESOLUTION = 0.1


class Hand:
    """Mouse and keyboard of a page, which count."""

    def __init__(self, page) -> None:
        self.page, self.count = page, 0

    def click(self, target) -> None:
        self.count += 1
        target.click()

    def place(self, east: float, north: float, button: str = "left") -> None:
        self.count += 1
        self.page.mouse.click(*pixel_of(self.page, east, north, RESOLUTION), button=button)
        self.page.wait_for_timeout(350)  # else two clicks are a double-click

    def press(self, key: str) -> None:
        self.count += 1
        self.page.keyboard.press(key)

    def type(self, text: str) -> None:
        self.count += 1
        self.page.keyboard.type(text)

    def tab(self, name: str) -> None:
        self.click(self.page.locator(f'[data-tab="{name}"]'))


@pytest.fixture
def hand(page, url):
    look(page, url + at(RESOLUTION, "mer2/dtm,mer2/orthophoto,mer2/stops,mer2/traverse"))
    return Hand(page)


def done(task: str, hand: Hand, most: int) -> None:
    print(f"{task}: {hand.count}")  # noqa: T201 - asked for with -s
    assert hand.count <= most


def test_the_error_of_a_stop(hand):
    hand.tab("stops")
    until(hand.page, lambda: "1.56" in hand.page.locator("#panel-stops").inner_text())
    done("error of a stop", hand, 1)


def test_go_to_a_latitude_and_longitude(hand):
    hand.press("/")
    hand.type("14.5693S 175.4730E")
    hand.page.wait_for_selector("#search-list li")
    hand.press("Enter")
    until(hand.page, lambda: "at=0,0," not in hand.page.url)
    done("latitude and longitude", hand, 3)


def test_measure_with_a_standard_deviation(hand):
    hand.tab("measure")
    hand.click(hand.page.locator('[data-mode="slope"]'))
    hand.place(10.0, 0.0)
    hand.place(20.0, 0.0)
    item = hand.page.locator('[data-quantity="rise"] td')
    item.wait_for()
    assert "±" in item.inner_text()
    done("measure with sigma", hand, 4)


def test_map_the_standard_deviation(hand):
    hand.click(hand.page.locator('li[data-layer="mer2/dtm-sigma"] input[type=checkbox]').first)
    until(hand.page, lambda: "Elevation σ" in hand.page.locator(".map-legend").inner_text())
    done("map sigma", hand, 1)


def test_download_a_layer(hand):
    hand.tab("downloads")
    with hand.page.expect_download() as waiting:
        hand.click(hand.page.locator("#panel-downloads").get_by_text("GeoTIFF").first)
    assert waiting.value.path().stat().st_size > 1000
    done("download a GeoTIFF", hand, 2)


def test_export_the_map_as_a_picture(hand):
    hand.tab("downloads")
    with hand.page.expect_download() as waiting:
        hand.click(hand.page.get_by_role("button", name="PNG of the map"))
    assert waiting.value.suggested_filename.endswith(".png")
    done("map as PNG", hand, 2)


def test_images_of_an_instrument_and_a_sol(hand):
    hand.press("a")
    hand.page.locator(".table-bar select").first.wait_for()
    hand.count += 1
    hand.page.locator(".table-bar select").first.select_option("images")
    hand.click(hand.page.get_by_placeholder("filter rows"))
    hand.type("navcam 155")
    rows = hand.page.locator(".below [role=row]")
    until(hand.page, lambda: rows.count() > 1)
    done("filter by instrument and sol", hand, 4)
