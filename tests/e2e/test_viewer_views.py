"""Saved views: names for links, kept in the browser and carried in a file."""

from __future__ import annotations

import json

import pytest

from tests.support.browsing import at, keep_screenshot, look, open_page, ready, until


def on_plain(page, url: str) -> None:
    look(page, url + at(0.05, "mer2/orthophoto"))


def open_views(page) -> None:
    page.locator("div.map").focus()
    page.keyboard.press("b")
    page.locator("dialog[open] .views").wait_for()


def names(page) -> list[str]:
    return page.locator(".saved-views .open").all_inner_texts()


def save(page, name: str) -> None:
    page.get_by_role("textbox", name="name of the view").fill(name)
    page.keyboard.press("Enter")
    until(page, lambda: name in names(page))


@pytest.fixture
def bowl(page, url):
    on_plain(page, url)
    return page


def test_a_saved_view_restores_the_whole_link_after_a_reload(bowl, url):
    look(bowl, url + at(0.02, "mer2/slope*0.5", 2, 1) + "&measure=distance:0,0;3,4&tab=measure")
    link = bowl.evaluate("location.hash")
    assert "*0.5" in link
    open_views(bowl)
    save(bowl, "slope of the bowl")
    on_plain(bowl, url)
    other = bowl.evaluate("location.hash")
    open_views(bowl)
    bowl.get_by_role("button", name="slope of the bowl", exact=True).click()
    until(bowl, lambda: bowl.evaluate("location.hash") == link)
    ready(bowl)
    assert bowl.locator("dialog[open]").count() == 0
    assert bowl.locator("#tab-measure").get_attribute("aria-selected") == "true"
    bowl.locator(".panels").get_by_text("5.00").first.wait_for()
    bowl.locator("div.map").focus()
    bowl.keyboard.press("Control+z")
    until(bowl, lambda: bowl.evaluate("location.hash") == other)


def test_views_are_saved_renamed_replaced_and_deleted_by_keyboard(bowl):
    open_views(bowl)
    save(bowl, "one")
    save(bowl, "one (2)")
    assert bowl.evaluate("document.activeElement.textContent") == "one (2)"
    bowl.keyboard.press("Tab")  # its button Rename
    bowl.keyboard.press("Enter")
    bowl.keyboard.type("two")  # over the old name, which is selected
    bowl.keyboard.press("Enter")
    assert names(bowl) == ["one", "two"]
    bowl.keyboard.press("Tab")
    bowl.keyboard.press("Enter")
    bowl.keyboard.type("three")
    bowl.keyboard.press("Escape")
    assert names(bowl) == ["one", "two"]
    assert bowl.locator("dialog[open]").count() == 1
    for _ in range(3):
        bowl.keyboard.press("Tab")
    bowl.keyboard.press("Enter")  # Delete; the focus goes to the button that restores
    assert names(bowl) == ["one"]
    bowl.keyboard.press("Enter")
    assert names(bowl) == ["one", "two"]
    bowl.keyboard.press("Escape")
    bowl.get_by_role("button", name="zoom in").click()
    until(bowl, lambda: "at=0,0,0.025" in bowl.evaluate("location.hash"))
    open_views(bowl)
    bowl.get_by_role("button", name="Replace one by what is shown now").click()
    kept = json.loads(bowl.evaluate("localStorage.getItem('solmap-views')"))["views"]
    assert [("0.025" in view["link"]) for view in kept] == [True, False]


def test_views_are_moved_between_browsers_in_a_file(bowl, browser, url, tmp_path):
    open_views(bowl)
    save(bowl, "bowl")
    with bowl.expect_download() as download:
        bowl.get_by_role("button", name="Export").click()
    path = tmp_path / "views.json"
    download.value.save_as(path)
    keep_screenshot(bowl, "saved-views")
    with open_page(browser, 390, 844) as page:
        import_views(page, url, path, tmp_path)


def import_views(page, url, path, tmp_path) -> None:
    on_plain(page, url)
    open_views(page)
    assert names(page) == []
    page.set_input_files("dialog input[type=file]", path)
    until(page, lambda: names(page) == ["bowl"])
    box = page.locator("dialog").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= 390
    assert page.locator("dialog").evaluate("it => it.scrollWidth <= it.clientWidth")
    keep_screenshot(page, "saved-views-narrow")
    damaged = tmp_path / "other.json"
    damaged.write_text('{"type": "FeatureCollection"}')
    page.set_input_files("dialog input[type=file]", damaged)
    trouble = page.locator("dialog [role=alert]")
    until(page, lambda: "holds no saved views" in trouble.inner_text())
    assert names(page) == ["bowl"]
