"""A walk through the whole page on a store that a run filled: nothing is empty or goes wrong."""

from __future__ import annotations

import re

import pytest

from tests.support.browsing import Server, keep_screenshot, look, open_page, ready, until

TABS = {
    "point": r"\d",
    "images": r"sol \d+|\d+ images",
    "stops": r"\d+\.\d+",
    "measure": r"[Dd]istance",
    "network": r"\d+",
    "compare": r"Swipe",
    "sun": r"\d+",
    "downloads": r"GeoTIFF|GeoPackage",
    "notes": r"[Nn]ote|[Ss]ign in",
    "runs": r"\d{4}-\d{2}-\d{2}|downlink|run",
}
"""What is to be read in every tab."""


@pytest.fixture
def server(mapped):
    with Server(mapped.store) as running:
        yield running


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_every_tab_and_tool_opens_without_an_error(browser, server, theme):
    with open_page(browser) as page:
        page.emulate_media(color_scheme=theme)
        errors = []
        page.on(
            "console",
            lambda message: errors.append(message.text) if message.type == "error" else None,
        )
        page.on(
            "response",
            lambda answer: (
                errors.append(f"{answer.status} {answer.url}") if answer.status >= 500 else None
            ),
        )
        look(page, server.url)
        box = page.locator("div.map").bounding_box()
        page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        walk_tabs(page, theme)
        walk_tools(page, theme)
        assert errors == []


def walk_tabs(page, theme: str) -> None:
    found = page.locator(".tabs [data-tab]")
    until(page, lambda: found.count() >= len(TABS))
    names = [tab.get_attribute("data-tab") for tab in found.all()]
    assert set(TABS) <= set(names)
    for name in names:
        page.locator(f'[data-tab="{name}"]').click()
        ready(page)
        panel = page.locator(f"#panel-{name}")
        requested = TABS.get(name, r"\w")
        until(page, lambda p=panel, w=requested: re.search(w, p.inner_text()) is not None)
        assert not panel.locator('[role="alert"]').count()
        keep_screenshot(page, f"panel-{theme}-{name}")


def walk_tools(page, theme: str) -> None:
    """Every tool opens its content, or leaves the map unchanged; Escape closes."""
    names = [tool.get_attribute("aria-label") for tool in page.locator(".toolbar button").all()]
    assert len(names) >= 6
    for number, name in enumerate(names):
        tool = page.locator(".toolbar button").nth(number)
        if not tool.is_enabled() or not tool.is_visible():
            continue
        tool.click()
        page.wait_for_timeout(400)
        ready(page)
        for dock in page.locator("section.dock:visible").all():
            until(page, lambda d=dock: d.locator("img, canvas, svg").count() > 0)
        slug = re.sub(r"\W+", "-", name.lower()).strip("-")[:40]
        keep_screenshot(page, f"tool-{theme}-{number}-{slug}")
        for close in page.locator('section.dock:visible button[aria-label="close"]').all():
            close.click()
        page.keyboard.press("Escape")
        if page.locator("dialog[open]").count():
            page.keyboard.press("Escape")
        until(page, lambda: page.locator("section.dock:visible").count() == 0)
