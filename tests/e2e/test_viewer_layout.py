"""The page from a phone to a wall screen: nothing is cut off, and the map keeps its room."""

from __future__ import annotations

from itertools import combinations

import pytest

from tests.support.browsing import at, keep_screenshot, load, look, open_page, ready, until

NARROW = 1100
SIZES = [
    pytest.param((width, height), marks=marks)
    for marks, sizes in (
        ((), ((390, 844), (1440, 900))),
        (pytest.mark.slow, ((768, 1024), (1024, 768), (1920, 1080), (2560, 1440))),
    )
    for width, height in sizes
]
"""Below and above `NARROW` the page is arranged in two ways: one window of each at first."""
CUT_OFF = """() => {
  const clipping = (element) => {
    for (let each = element.parentElement; each; each = each.parentElement)
      if (getComputedStyle(each).overflowX !== "visible") return each;
    return document.documentElement;
  };
  const found = [];
  for (const each of document.querySelectorAll("#app *")) {
    if (each.closest(".off-screen, .skip, .ol-viewport, svg, input, [hidden]")) continue;
    const { left, right, width, height } = each.getBoundingClientRect();
    if (!width || !height) continue;
    const name = `${each.tagName}.${each.className}: ${(each.textContent ?? "").slice(0, 40)}`;
    const around = clipping(each);
    const room = around.getBoundingClientRect();
    const scrolls = ["auto", "scroll"].includes(getComputedStyle(around).overflowX);
    if (!scrolls && (left < room.left - 1 || right > room.right + 1)) found.push(name);
    const { overflowX, textOverflow } = getComputedStyle(each);
    const hides = ["hidden", "clip"].includes(overflowX) && textOverflow !== "ellipsis";
    if (hides && !each.children.length && each.scrollWidth > each.clientWidth + 1) found.push(name);
  }
  if (document.documentElement.scrollWidth > innerWidth) found.push("the page");
  return found;
}"""
"""What lies outside of the element that clips it, or is wider than its own room."""


SMALL = """() => {
  const found = [];
  const all = "button, a[href], input, select, summary, [role=tab], [role=slider]";
  const shown = [...document.querySelectorAll(all)].filter((each) =>
    each.checkVisibility({ visibilityProperty: true, opacityProperty: true }) &&
    !each.closest(".skip, p, td, label"));
  const middle = (box) => [box.left + box.width / 2, box.top + box.height / 2];
  const boxes = shown.map((each) => each.getBoundingClientRect());
  for (const [k, each] of shown.entries()) {
    const { width, height } = boxes[k];
    if (!width || !height || (width >= 24 && height >= 24)) continue;
    const [x, y] = middle(boxes[k]);
    const isNear = boxes.some((other, j) => {
      if (j === k || !other.width) return false;
      if (shown[j].contains(each) || each.contains(shown[j])) return false;
      const dx = Math.max(other.left - x, 0, x - other.right);
      const dy = Math.max(other.top - y, 0, y - other.bottom);
      return Math.hypot(dx, dy) < 12;
    });
    const name = each.getAttribute("aria-label") || each.textContent.slice(0, 30);
    if (isNear) found.push(`${each.tagName} ${name}: ${width.toFixed()} x ${height.toFixed()}`);
  }
  return found;
}"""
"""What is smaller than 24 pixels and within 12 of another target (WCAG 2.2, 2.5.8)."""


@pytest.fixture(params=SIZES, ids=lambda size: str(size[0]))
def window(request, browser):
    width, height = request.param
    with open_page(browser, width, height) as page:
        page.width = width
        yield page


@pytest.fixture
def sized(window, url):
    look(window, url + at(0.1, "mer2/stops,mer2/traverse"))
    return window


def test_no_panel_clips_its_content_and_targets_are_24_pixels_wide_and_high(sized):
    faults, small = sized.evaluate(CUT_OFF), sized.evaluate(SMALL)
    box = sized.locator(".map").bounding_box()
    sized.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    until(sized, lambda: sized.locator("#panel-point .facts").count() > 0)
    for tab in sized.locator("[data-tab]").all():
        tab.click()
        ready(sized)
        name = tab.get_attribute("data-tab")
        assert sized.locator(f"#panel-{name}").is_visible()
        faults += [f"{name}: {fault}" for fault in sized.evaluate(CUT_OFF)]
        small += sized.evaluate(SMALL)
        keep_screenshot(sized, f"layout-{sized.width}-{name}")
    if sized.width < NARROW:
        sized.get_by_role("button", name="layers panel").click()
    assert sized.locator(".left").is_visible()
    faults += sized.evaluate(CUT_OFF)
    small += sized.evaluate(SMALL)
    assert faults == []
    assert sorted(set(small)) == []


def test_at_200_percent_no_panel_clips_its_content(browser, url):
    """The browser's zoom of 200 % on a window of 1440 x 900 halves its width in CSS pixels."""
    with open_page(browser, 720, 450, scale=2.0) as page:
        look(page, url + at(0.1, "mer2/stops,mer2/traverse"))
        assert page.evaluate("[innerWidth, devicePixelRatio]") == [720, 2]
        faults = page.evaluate(CUT_OFF)
        for tab in page.locator("[data-tab]").all():
            tab.click()
            ready(page)
            name = tab.get_attribute("data-tab")
            assert page.locator(f"#panel-{name}").is_visible()
            faults += [f"{name}: {fault}" for fault in page.evaluate(CUT_OFF)]
            keep_screenshot(page, f"zoomed-{name}")
        assert faults == []


def test_the_map_has_room_is_reached_within_five_tab_stops_and_nothing_on_it_overlaps(window, url):
    sized = window
    load(sized, url + at(0.1, "mer2/stops,mer2/traverse"))  # the Tab key begins at the top
    box = sized.locator(".map").bounding_box()
    assert box["width"] > sized.width / 2
    assert box["height"] > sized.viewport_size["height"] / 2
    for _ in range(5):
        sized.keyboard.press("Tab")
        if sized.evaluate("document.activeElement.matches('.skip')"):
            sized.keyboard.press("Enter")
            break
    assert sized.evaluate("document.activeElement.matches('.map')")
    sized.locator("div.map").focus()
    sized.keyboard.press("m")  # a measurement begins: the line with the instructions appears
    sized.locator(".ruler").wait_for()
    title = sized.locator(".map-title")
    assert title.inner_text().split("\n")[0] == "Spirit, Gusev crater"
    boxes = {
        name: sized.locator(name).bounding_box()
        for name in (".map-title", ".toolbar", ".north", ".scale", ".map-legend", ".ruler")
    }
    for one, other in combinations(boxes, 2):
        a, b = boxes[one], boxes[other]
        is_apart = (
            a["x"] + a["width"] <= b["x"]
            or b["x"] + b["width"] <= a["x"]
            or a["y"] + a["height"] <= b["y"]
            or b["y"] + b["height"] <= a["y"]
        )
        assert is_apart, (one, other, a, b)
    keep_screenshot(sized, f"furniture-{sized.width}")
    sized.keyboard.press("Escape")
    sized.keyboard.press("a")
    sized.locator(".panes.below .table-body").wait_for()
    ready(sized)
    sized.locator('[data-tab="images"]').click()
    assert sized.locator(".map").bounding_box()["height"] > 100
    assert sized.evaluate(CUT_OFF) == []
    keep_screenshot(sized, f"layout-{sized.width}-table")


def test_a_pane_leaves_room_for_the_map_and_the_tab(window, url):
    look(window, f"{url}{at(0.1)}&tab=images&image=2N140000000EFFA000P1600L0M1")
    window.locator(".panes .pane").wait_for()
    assert window.locator(".map").bounding_box()["height"] > 100
    assert window.locator(".panes .pane").bounding_box()["height"] > 150
    assert window.evaluate(CUT_OFF) == []
    keep_screenshot(window, f"layout-{window.width}-pane")


def test_panels_collapse_and_reopen_when_a_tab_is_selected(sized):
    layers = sized.get_by_role("button", name="layers panel")
    panel = sized.get_by_role("button", name="side panel")
    for fold, place in ((layers, ".left"), (panel, ".panels")):
        is_open = sized.width >= NARROW
        for _ in range(2):
            assert sized.locator(place).is_visible() == is_open
            assert fold.get_attribute("aria-expanded") == str(is_open).lower()
            fold.click()
            is_open = not is_open
    if sized.width >= NARROW:
        panel.click()
    else:
        layers.click()
    sized.locator('[data-tab="images"]').click()
    until(sized, lambda: sized.locator("#panel-images").is_visible())
    assert sized.locator(".left").is_visible() == (sized.width >= NARROW)
