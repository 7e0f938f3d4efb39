"""Two solutions on the map: the older version of a layer differs by what was put between them."""

from __future__ import annotations

from urllib.parse import unquote

import numpy as np
import pytest

from tests.support.browsing import (
    Server,
    at,
    colour_at,
    colour_now,
    keep_screenshot,
    look,
    pixel_of,
    ready,
    screenshot,
    until,
)
from tests.support.versions_store import GREYS, OFF_M, STEP_NED_M, TILT, fill_versions

RESOLUTION = 0.1


@pytest.fixture(scope="module")
def twice(tmp_path_factory):
    root = tmp_path_factory.mktemp("versions") / "store"
    versions = fill_versions(root)
    with Server(root) as server:
        yield versions, server.url


def open_versions(page, address: str, stop: str, kind: str) -> None:
    look(page, address)
    list_versions(page, stop, kind)


def list_versions(page, stop: str, kind: str) -> None:
    group = page.locator(f'details[data-scope="{stop}"]')
    if group.get_attribute("open") is None:
        group.locator("> summary").click()
    row = page.locator(f'li.layer[data-layer="{stop}/{kind}"]')
    row.locator(".more").click()
    row.locator(".versions summary").click()
    until(page, lambda: row.locator("[data-version]").count() == 2)


def earlier(page, stop: str, kind: str):
    row = page.locator(f'li.layer[data-layer="{stop}/{kind}"]')
    return row.locator("[data-version]").filter(has=page.locator("input"))


def test_the_difference_of_two_solutions_is_the_difference_put_in(page, twice):
    versions, url = twice
    open_versions(page, url + at(RESOLUTION), versions.moved, "dtm")
    assert "sol 156 ·" in earlier(page, versions.moved, "dtm").inner_text()
    latest = page.locator(f'li.layer[data-layer="{versions.moved}/dtm"] [data-version] b')
    assert "sol 156, overall" in latest.inner_text()
    earlier(page, versions.moved, "dtm").get_by_text("difference").click()
    until(page, lambda: page.locator(".difference .amounts").count() == 1)
    ready(page)
    keep_screenshot(page, "versions-difference")
    amounts = page.locator(".difference .amounts").inner_text().replace("\u2212", "-")
    assert float(amounts.split("mean ")[1].split(" ")[0]) == pytest.approx(-OFF_M, abs=0.005)
    here = page.locator(".difference .here")
    for east in (-20.0, 0.0, 20.0):
        page.mouse.move(*pixel_of(page, east, 5.0, RESOLUTION))
        expected = -(OFF_M + TILT * east)
        until(page, lambda e=expected: abs(message(here) - e) < 0.003)


def test_a_comparison_requested_before_its_part_has_loaded_is_shown(page, twice):
    versions, url = twice
    held = []
    page.route("**/later-parts*", lambda route: held.append(route))  # noqa: PLW0108 - needs no self
    page.goto("about:blank")
    page.goto(url + at(RESOLUTION, f"{versions.moved}/orthophoto"))
    list_versions(page, versions.moved, "orthophoto")
    earlier(page, versions.moved, "orthophoto").get_by_text("swipe").click()
    until(page, lambda: held)
    assert page.locator(".divider").count() == 0
    for route in held:
        route.continue_()
    page.wait_for_selector(".divider")
    ready(page)


def message(here) -> float:
    words = here.inner_text().replace("\u2212", "-").split()
    return float(words[1]) if len(words) > 1 and words[0] == "here" else np.nan


def test_two_solutions_are_on_both_sides_of_the_divider_and_the_link_restores_them(page, twice):
    versions, url = twice
    on = f"{versions.moved}/orthophoto"
    open_versions(page, url + at(RESOLUTION, on), versions.moved, "orthophoto")
    earlier(page, versions.moved, "orthophoto").get_by_text("swipe").click()
    page.wait_for_selector(".divider")
    ready(page)
    address = page.url
    assert "orthophoto@" in unquote(address)
    left, right = sides(page, "versions-swipe")
    assert left - right == pytest.approx(GREYS[1] - GREYS[0], abs=8)
    look(page, address)
    page.wait_for_selector(".divider")
    ready(page)
    assert sides(page, "versions-swipe-again") == pytest.approx((left, right), abs=2)


def sides(page, name: str) -> tuple[float, float]:
    page.wait_for_timeout(400)  # images fade in
    shown = screenshot(page, name)
    places = [pixel_of(page, east, 20.0, RESOLUTION) for east in (-10.0, 10.0)]
    left, right = (float(colour_at(shown, place).mean()) for place in places)
    return left, right


def test_the_older_image_flickers_over_the_newer(page, twice):
    versions, url = twice
    on = f"{versions.moved}/orthophoto"
    open_versions(page, url + at(RESOLUTION, on), versions.moved, "orthophoto")
    earlier(page, versions.moved, "orthophoto").get_by_text("flicker").click()
    place = pixel_of(page, 10.0, 20.0, RESOLUTION)
    seen = set()

    def saw_both() -> bool:
        seen.add(round(float(colour_now(page, place).mean()), -1))
        return len({grey for grey in seen if min(abs(grey - g) for g in GREYS) < 15}) > 1

    until(page, saw_both)
    earlier(page, versions.moved, "orthophoto").get_by_role("checkbox").uncheck()
    assert "@" not in page.url


def test_an_unchanged_map_has_one_version_for_both_solutions(page, twice):
    versions, url = twice
    look(page, url + at(RESOLUTION))
    page.locator(f'details[data-scope="{versions.stayed}"] > summary').click()
    row = page.locator(f'li.layer[data-layer="{versions.stayed}/dtm"]')
    row.locator(".more").click()
    row.locator(".versions summary").click()
    until(page, lambda: row.locator("[data-version]").count() == 1)
    assert "holds for 2 solutions" in row.locator("[data-version]").get_attribute("title")
    assert "No other version" in row.locator(".version-list").inner_text()


def test_the_traverses_of_both_solutions_are_listed_side_by_side(page, twice):
    versions, url = twice
    look(page, url + at(RESOLUTION))
    page.locator('[data-tab="stops"]').click()
    page.wait_for_selector(".differences")
    page.locator("select.reference").select_option(
        f"{versions.networks[0].scope.name}/{versions.networks[0].digest}"
    )
    expected = float(np.hypot(*STEP_NED_M[:2]))
    until(page, lambda: abs(off(page) - expected) < 6e-4)


def off(page) -> float:
    cells = page.locator("[data-row]").last.locator("td").all_inner_texts()
    try:
        return float(cells[3].replace("\u2212", "-").rstrip(" %"))
    except ValueError:
        return np.nan
