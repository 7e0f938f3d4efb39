"""Links and history of the viewer: back and forward, undo, what a link restores and what not."""

from __future__ import annotations

import math
from urllib.parse import unquote

import pytest

from tests.support.browsing import at, look, ready, until


def fragment(page) -> str:
    return unquote(page.evaluate("location.hash"))


def moved(page) -> None:
    """Let the map settle, so that what is done next is another gesture."""
    ready(page)
    page.wait_for_timeout(200)


@pytest.fixture
def bowl(page, url):
    look(page, url + at(0.05, "mer2/orthophoto"))
    return page


def box(page, kind: str):
    return page.locator(f".layers [data-kind='{kind}'] input[type=checkbox]").first


@pytest.mark.both_browsers
def test_back_and_forward_restore_layers_and_place(bowl):
    box(bowl, "slope").check()
    until(bowl, lambda: "/slope" in fragment(bowl))
    moved(bowl)
    bowl.get_by_role("button", name="zoom in").click()
    until(bowl, lambda: "at=0,0,0.025" in fragment(bowl))
    bowl.go_back()
    until(bowl, lambda: "at=0,0,0.05&" in fragment(bowl))
    assert box(bowl, "slope").is_checked()
    bowl.go_back()
    until(bowl, lambda: "/slope" not in fragment(bowl))
    assert not box(bowl, "slope").is_checked()
    bowl.go_forward()
    until(bowl, lambda: box(bowl, "slope").is_checked())


def test_undo_and_redo_by_keys(bowl):
    moved(bowl)
    box(bowl, "slope").check()
    until(bowl, lambda: "/slope" in fragment(bowl))
    bowl.locator("div.map").focus()
    bowl.keyboard.press("Control+z")
    until(bowl, lambda: not box(bowl, "slope").is_checked())
    bowl.keyboard.press("Control+y")
    until(bowl, lambda: box(bowl, "slope").is_checked())


def test_undo_stays_on_the_page(bowl):
    bowl.locator("div.map").focus()
    for _ in range(3):
        bowl.keyboard.press("Control+z")
    bowl.wait_for_timeout(300)
    assert "at=0,0,0.05" in fragment(bowl)


@pytest.mark.both_browsers
def test_a_link_restores_place_tab_and_measurements(page, url):
    requested = "&pt=2,1&measure=distance:0,0;3,4&tab=measure"
    look(page, url + at(0.05, "mer2/orthophoto") + requested)
    page.locator(".panels").get_by_text("5.00").first.wait_for()
    assert page.locator("#tab-measure").get_attribute("aria-selected") == "true"
    page.locator("#tab-point").click()
    assert "Loading" not in page.locator("#panel-point").inner_text()
    assert page.locator("#panel-point .facts, #panel-point table").first.is_visible()
    now = fragment(page)
    assert "pt=2,1" in now
    assert "measure=distance:0,0;3,4" in now
    assert "tab=" not in now  # the first tab needs no name


def test_an_identified_place_and_its_tab_can_be_undone(bowl):
    moved(bowl)
    bowl.locator("#tab-sun").click()
    until(bowl, lambda: "tab=sun" in fragment(bowl))
    moved(bowl)
    frame = bowl.locator("div.map").bounding_box()
    bowl.mouse.click(frame["x"] + frame["width"] / 2 + 40, frame["y"] + frame["height"] / 2)
    until(bowl, lambda: "pt=" in fragment(bowl))
    place = fragment(bowl).split("pt=")[1].split("&")[0].split(",")
    assert math.isclose(float(place[0]), 2.0, abs_tol=0.1)
    bowl.go_back()
    until(bowl, lambda: "pt=" not in fragment(bowl))
    assert bowl.locator("#tab-sun").get_attribute("aria-selected") == "true"


def test_unknown_parts_of_a_link_are_named(page, url):
    banner = page.locator(".banner")
    for part, reported in (
        ("&on=mer2/craters", "layer mer2/craters"),
        ("&zoom=3", "zoom"),
        ("&sol=soon", "sol=soon"),
        ("&tab=weather", "weather"),
    ):
        look(page, url + "/#m=MER2&at=0,0,0.05" + part)
        banner.wait_for()
        assert reported in banner.inner_text()


def test_a_link_restores_the_image_beside_the_map(page, images_url):
    image = page_images(page, images_url)[0]
    look(page, f"{images_url}/#m=MER2&at=0,0,0.05&image={image}")
    page.wait_for_selector(f'.image-view[data-image="{image}"]')
    page.locator(".pane").get_by_role("button", name="close").click()
    until(page, lambda: "image=" not in fragment(page))
    page.go_back()
    page.wait_for_selector(f'.image-view[data-image="{image}"]')


def page_images(page, url) -> list[str]:
    answer = page.request.get(f"{url}/api/missions/MER2/images").json()
    return [image["id"] for image in answer]
