"""axe-core goes through every panel of the viewer, light and dark: it finds no issue at all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from solmap.products.catalogue.workspace import Workspace
from tests.support.browsing import (
    ROOT,
    Server,
    at,
    keep_screenshot,
    look,
    open_page,
    ready,
    resize,
    until,
)
from tests.support.scene_store import fill_scene

AXE = ROOT / "gis_server" / "viewer" / "node_modules" / "axe-core" / "axe.min.js"
RUN = "async () => (await axe.run({ resultTypes: ['violations'] })).violations"


@pytest.fixture(scope="module")
def full_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    root: Path = tmp_path_factory.mktemp("axe") / "store"
    fill_scene(Workspace.open(root))
    with Server(root) as server:
        yield server.url


SLOW = pytest.mark.slow


@pytest.fixture(params=["light", pytest.param("dark", marks=SLOW)])
def themed(request, browser, full_url):
    if not AXE.is_file():
        pytest.skip("axe-core is not installed: run `npm ci` in gis_server/viewer")
    with open_page(browser) as page:
        page.emulate_media(color_scheme=request.param)
        page.theme = request.param
        look(page, full_url + at(0.1, "mer2/orthophoto,mer2/stops,mer2/tie-points"))
        page.evaluate(AXE.read_text())  # by the driver: the page's own policy lets no text run
        yield page


def issues_of(page, name: str) -> list[str]:
    """One line an element that breaks a rule."""
    page.wait_for_timeout(200)
    keep_screenshot(page, f"axe-{page.theme}-{name}")
    found = page.evaluate(RUN)
    return [
        f"{name}: {issue['id']} ({issue['impact']}): {node['target']}: {node['failureSummary']}"
        for issue in found
        for node in issue["nodes"]
    ]


@pytest.mark.parametrize(
    ("themed", "width"),
    [
        ("light", 1280),
        ("dark", 1280),
        pytest.param("light", 390, marks=SLOW),
        pytest.param("dark", 390, marks=SLOW),
    ],
    indirect=["themed"],
)
def test_no_tab_has_an_accessibility_issue(themed, width):
    issues = issues_of(themed, "first")
    resize(themed, width, 800)
    for tab in themed.locator("[data-tab]").all():
        tab.click()
        ready(themed)
        issues += issues_of(themed, f"tab-{tab.get_attribute('data-tab')}-{width}")
    assert issues == []


def test_no_tool_opens_an_element_with_an_accessibility_issue(themed):
    issues = []
    for tool in themed.locator(".toolbar button").all():
        name = tool.get_attribute("aria-label")
        if name.startswith(("zoom", "show everything", "copy")):
            continue
        tool.click()
        ready(themed)
        for view in ("scene", "stereo"):
            half_drawn = themed.locator(f'.{view}:not([data-settled="true"])')
            until(themed, lambda found=half_drawn: found.count() == 0)
        issues += issues_of(themed, f"tool-{name.split(' (')[0].replace(' ', '-')}")
        themed.keyboard.press("Escape")
        if tool.get_attribute("aria-pressed") == "true":
            tool.click()
        for dialog in themed.locator("dialog[open]").all():
            dialog.get_by_role("button", name="close").first.click()
    assert issues == []


def test_the_tour_has_no_accessibility_issue(themed):
    themed.get_by_role("button", name="Help").click()
    themed.get_by_role("button", name="Take the tour").click()
    themed.wait_for_selector(".driver-popover")
    themed.wait_for_timeout(400)  # faded in
    assert issues_of(themed, "tour") == []
    themed.keyboard.press("Escape")


def test_an_open_image_and_an_identified_place_have_no_accessibility_issue(themed):
    themed.locator('[data-tab="images"]').click()
    themed.locator(".images button").first.click()
    ready(themed)
    issues = issues_of(themed, "image")
    box = themed.locator("div.map").bounding_box()
    themed.mouse.click(box["x"] + box["width"] / 2 + 30, box["y"] + box["height"] / 2)
    themed.wait_for_selector(".point table")
    issues += issues_of(themed, "place")
    row = themed.locator("li.layer").first
    row.locator(".more").click()
    issues += issues_of(themed, "layer")
    assert issues == []


def test_every_control_is_reachable_and_named_by_keyboard(themed):
    """Tab goes through the page: what is focused has a name, and is seen to be focused."""
    themed.locator("body").press("Tab")
    seen = set()
    for _ in range(60):
        name, outlined = themed.evaluate(
            """() => {
              const e = document.activeElement;
              const label = e.getAttribute('aria-label') || e.getAttribute('title')
                || e.labels?.[0]?.innerText || e.innerText || '';
              return [e.tagName + ' ' + label.trim(), getComputedStyle(e).outlineStyle];
            }"""
        )
        tag, _, label = name.partition(" ")
        if tag != "BODY":
            assert label, f"a {tag} without a name has the focus"
            assert outlined != "none", f"{name} does not show that it has the focus"
            seen.add(name)
        themed.keyboard.press("Tab")
    assert len(seen) > 20


def test_the_checker_finds_seeded_issues(themed):
    themed.evaluate(
        """() => document.querySelector('.readout').insertAdjacentHTML('beforeend',
          '<button></button><b style="color:#888;background:#999">faint</b>')"""
    )
    found = " ".join(issues_of(themed, "spoilt"))
    assert "button-name" in found
    assert "color-contrast" in found
