"""Panes beside the map: how many there are at which width, their dividers, what a link restores."""

from __future__ import annotations

import json
import urllib.request

import pytest

from tests.e2e.test_viewer_layout import CUT_OFF
from tests.support.browsing import at, keep_screenshot, look, open_page, ready, until

LEAST_PX = 320


def paired(url: str) -> str:
    """The name of an image with a stereo partner."""
    with urllib.request.urlopen(f"{url}/api/missions/MER2/images", timeout=20) as answer:
        images = json.load(answer)
    found = images if isinstance(images, list) else images["images"]
    return next(one["id"] for one in found if one["partner"] and one["eye"] == "left")


def open_both(page, url: str) -> None:
    """An image and the stereo pair that it is of."""
    look(page, f"{url}{at(0.1)}&image={paired(url)}")
    page.wait_for_selector(".image-view")
    page.get_by_role("button", name="stereo pair (2)").click()
    page.wait_for_selector(".stereo-view")
    ready(page)


def box(page, selector: str, at: int = 0) -> dict[str, float]:
    return page.locator(selector).nth(at).bounding_box()


@pytest.mark.parametrize(
    "size",
    [(1440, 900), (1920, 1080), pytest.param((2560, 1440), marks=pytest.mark.slow)],
    ids=lambda size: str(size[0]),
)
def test_image_and_stereo_panes_are_open_beside_the_map_together(browser, images_url, size):
    with open_page(browser, *size) as page:
        open_both(page, images_url)
        assert page.locator(".pane").count() == 2
        field, first, second = box(page, ".map"), box(page, ".pane"), box(page, ".pane", 1)
        assert min(field["width"], first["width"], second["width"]) >= LEAST_PX
        assert field["x"] + field["width"] <= first["x"]
        if size[0] == 1440:
            assert first["y"] + first["height"] <= second["y"]
        else:
            assert first["x"] + first["width"] <= second["x"]
        assert page.evaluate(CUT_OFF) == []
        keep_screenshot(page, f"panes-{size[0]}")
        page.locator(".pane").first.get_by_role("button", name="close").click()
        assert page.locator(".pane").count() == 1
        assert page.locator(".stereo-view").is_visible()
        assert "image=" not in page.evaluate("location.hash")


def test_on_small_screens_one_pane_replaces_the_other(browser, images_url):
    with open_page(browser, 1024, 768) as page:
        open_both(page, images_url)
        assert page.locator(".pane").count() == 1
        assert page.locator(".image-view").count() == 0
        assert page.evaluate(CUT_OFF) == []


def test_a_link_restores_all_panes(browser, images_url):
    with open_page(browser, 1920, 1080) as page:
        open_both(page, images_url)
        until(page, lambda: "stereo=" in page.evaluate("location.hash"))
        link = page.url
        pair = page.locator('.pane select[name="pair"]').input_value()
        look(page, link)
        until(page, lambda: page.locator(".pane").count() == 2)
        page.wait_for_selector(".stereo-view")
        assert page.locator('.pane select[name="pair"]').input_value() == pair
        assert page.locator(".image-view").is_visible()


def test_dividers_resize_panes_by_mouse_and_arrow_keys_and_are_remembered(browser, images_url):
    with open_page(browser, 1920, 1080, is_new=True) as page:
        open_both(page, images_url)
        divider = page.locator(".pane-divider").first
        before = box(page, ".map")["width"]
        divider.focus()
        page.keyboard.press("ArrowLeft")
        until(page, lambda: box(page, ".map")["width"] == pytest.approx(before - 24, abs=2))
        place = box(page, ".pane-divider", 1)
        x, y = place["x"] + 3, place["y"] + 200
        widths = [box(page, ".pane", k)["width"] for k in (0, 1)]
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 60, y, steps=3)
        page.mouse.up()
        moved = [box(page, ".pane", k)["width"] for k in (0, 1)]
        assert moved[0] == pytest.approx(widths[0] + 60, abs=4)
        assert sum(moved) == pytest.approx(sum(widths), abs=2)
        page.reload()
        ready(page)
        until(page, lambda: page.locator(".pane").count() == 2)
        until(page, lambda: box(page, ".map")["width"] == pytest.approx(before - 24, abs=2))
