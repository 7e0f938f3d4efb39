"""The attribute table: sorted, filtered, linked with the map both ways, and handed out as files."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator

import pytest

from tests.support.bowl_store import STOPS, UNPAIRED
from tests.support.browsing import (
    Server,
    at,
    keep_screenshot,
    look,
    open_page,
    pixel_of,
    resize,
    until,
)
from tests.support.large_mission import write_mission

IMAGE_COLUMNS = 11
MANY_TIES = 20_500
"""More than the server sends at once."""


def open_table(page, subject: str) -> None:
    page.locator("div.map").focus()
    page.keyboard.press("a")
    page.get_by_label("table", exact=True).select_option(subject)
    page.locator(".table-body .table-row").first.wait_for()


def column(page, number: int) -> list[str]:
    return page.locator(
        f".table-body .table-row > :nth-child({number})",
    ).all_inner_texts()


def count(page) -> str:
    return page.locator(".table-bar output").inner_text()


def sideways(page) -> int:
    """Pixels that the table scrolls sideways."""
    return page.locator(".table-grid").evaluate("one => one.scrollWidth - one.clientWidth")


def chosen(page) -> list[str]:
    rows = page.locator('.table-row[aria-selected="true"]').all()
    return [row.get_attribute("data-row") for row in rows]


def save(page, name: str, folder) -> str:
    with page.expect_download() as download:
        page.locator(".table-bar").get_by_role("button", name=name, exact=True).click()
    path = folder / download.value.suggested_filename
    download.value.save_as(path)
    return path.read_text()


def centre(page) -> list[float]:
    return [float(value) for value in page.url.split("at=")[1].split("&")[0].split(",")[:2]]


@pytest.mark.both_browsers
def test_stops_have_their_uncertainty_and_sort_by_the_error_of_telemetry(page, url):
    look(page, url + at(0.1, "mer2/stops"))
    open_table(page, "stops")
    page.get_by_role("button", name="telemetry error", exact=False).click()
    page.get_by_role("button", name="telemetry error", exact=False).click()
    telemetry_order = [STOPS[2][0], STOPS[1][0], STOPS[0][0]]
    assert column(page, 1) == telemetry_order
    assert column(page, 4)[0] == "14.00 ± 0.06"  # north of the last stop
    heading = page.locator('[role="columnheader"]', has_text="telemetry error")
    assert heading.get_attribute("aria-sort") == "descending"
    assert "table=of%3Dstops%26sort%3D-moved_m" in page.url
    page.reload()
    page.locator(".table-body .table-row").first.wait_for()
    assert column(page, 1) == telemetry_order
    keep_screenshot(page, "table-stops")


def test_images_are_filtered_by_words_and_by_sol_and_saved_as_listed(page, url, tmp_path):
    look(page, url + at(0.1, "mer2/stops"))
    open_table(page, "images")
    assert count(page) == "15 rows"
    page.get_by_label("only sol").select_option("156")
    assert count(page) == "5 of 15 rows"
    page.get_by_label("filter rows").fill("single")
    assert count(page) == "1 of 15 rows"
    (row,) = csv.DictReader(save(page, "CSV", tmp_path).splitlines())
    assert (row["sol"], row["unpaired_because"]) == ("156", UNPAIRED)
    (feature,) = json.loads(save(page, "GeoJSON", tmp_path))["features"]
    assert feature["properties"]["image"] == row["image"]
    longitude, latitude = feature["geometry"]["coordinates"][0][0]
    assert longitude == pytest.approx(175.473, abs=0.001)
    assert latitude == pytest.approx(-14.569, abs=0.001)


def test_a_row_shows_its_place_and_a_click_on_the_map_its_row(page, url):
    look(page, url + at(0.05, "mer2/stops", 100.0, 100.0))
    open_table(page, "stops")
    grid = page.get_by_role("grid")
    grid.focus()
    page.keyboard.press("End")
    assert chosen(page) == [STOPS[2][0]]
    active = grid.get_attribute("aria-activedescendant")
    assert page.locator(f"#{active}").get_attribute("data-row") == STOPS[2][0]
    east, north = STOPS[2][3]
    until(page, lambda: math.dist(centre(page), (east, north)) < 1.0)
    look(page, url + at(0.1, "mer2/stops") + "&table=of%3Dstops")
    page.locator(".table-body .table-row").first.wait_for()
    page.mouse.click(*pixel_of(page, *STOPS[0][3], 0.1))
    until(page, lambda: chosen(page) == [STOPS[0][0]])


def test_an_opened_image_selects_its_row(page, url):
    look(page, url + at(0.1, "mer2/footprints"))
    open_table(page, "images")
    page.get_by_role("grid").focus()
    page.keyboard.press("Home")
    page.keyboard.press("Enter")  # opens it
    (name,) = chosen(page)
    page.wait_for_selector(f'.image[data-image="{name}"]')
    page.get_by_role("button", name="close", exact=True).first.click()


@pytest.fixture(scope="module")
def large_url(tmp_path_factory) -> Iterator[str]:
    root = tmp_path_factory.mktemp("table") / "store"
    write_mission(root, 3, 1_500, MANY_TIES)
    with Server(root) as server:
        yield server.url


@pytest.mark.parametrize("subject", [pytest.param("images", marks=pytest.mark.slow), "ties"])
def test_only_visible_rows_are_in_the_page(page, large_url, subject):
    look(page, large_url + at(0.5))
    open_table(page, subject)
    total = {"images": 1_500, "ties": MANY_TIES}[subject]
    until(page, lambda: count(page) == f"{total:,} rows")
    grid = page.get_by_role("grid")
    assert grid.get_attribute("aria-rowcount") == str(total + 1)
    grid.focus()
    page.keyboard.press("End")
    until(page, lambda: page.locator(f'[aria-rowindex="{total + 1}"]').is_visible())
    assert page.locator(".table-body .table-row").count() < 60
    keep_screenshot(page, f"table-{subject}-end")


def test_the_table_fits_a_phone(browser, url):
    with open_page(browser, 390, 844) as page:
        look(page, url + at(0.1, "mer2/stops") + "&table=of%3Dimages")
        page.locator(".table-body .table-row").first.wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        assert page.locator(".table-grid").bounding_box()["height"] > 150
        keep_screenshot(page, "table-narrow")
        headings = page.get_by_role("columnheader")
        for width in (390, 1280):
            resize(page, width, 844)
            until(page, lambda: sideways(page) == 0)
            page.get_by_role("button", name="all columns").click()
            assert (headings.count(), sideways(page) > 0) == (IMAGE_COLUMNS, True)
            page.get_by_role("button", name="columns that fit").click()
            assert 1 <= headings.count() < IMAGE_COLUMNS
