"""Twelve tasks, by mouse and by keyboard alone, and how many clicks each takes from the map.

A click on the page counts 1, a key or a combination of keys 1, a text that is typed (a coordinate,
a name) 1, whatever its length. The counts are those of the table in docs/reference/viewer.md.
By keyboard, shortcuts open tabs, and the Tab key must reach what else the mouse clicks.
"""

from __future__ import annotations

import math
import shutil

import pytest

from solmap.products.catalogue.edits import EditLog
from solmap.products.catalogue.tokens import Role, Tokens
from solmap.products.catalogue.workspace import Workspace
from tests.e2e.test_viewer_editor import click_pixel, pane, shared_pixel, size_of
from tests.support.bowl_store import STOPS, azimuth_of
from tests.support.browsing import (
    ROOT,
    Server,
    at,
    keep_screenshot,
    look,
    pixel_of,
    ready,
    resize,
    until,
)
from tests.support.scene_store import fill_scene

RESOLUTION = 0.1
MOST_STOPS = 300
TAB_KEYS = {"stops": "T", "measure": "M", "downloads": "D", "notes": "N"}


class Mouse:
    """Mouse of a page, and keys for what has one, which count."""

    name = "mouse"

    def __init__(self, page) -> None:
        self.page, self.count = page, 0

    def click(self, target) -> None:
        self.count += 1
        target.click()

    def choose(self, target, value: str) -> None:
        self.count += 1
        target.select_option(value)

    def tab(self, name: str) -> None:
        self.click(self.page.locator(f'[data-tab="{name}"]'))

    def place(self, east: float, north: float) -> None:
        self.count += 1
        self.page.mouse.click(*pixel_of(self.page, east, north, RESOLUTION))
        self.page.wait_for_timeout(350)  # else two clicks are a double-click

    def menu(self) -> None:
        """Open the context menu in the middle of the map."""
        self.count += 1
        self.page.mouse.click(*pixel_of(self.page, 0.0, 0.0, RESOLUTION), button="right")

    def pick(self, name: str, pixel: tuple[float, float]) -> None:
        self.count += 1
        click_pixel(self.page, name, pixel, size_of(self.page, name))

    def pick_middle(self, name: str) -> None:
        self.count += 1
        pane(self.page, name).locator("canvas").click()

    def press(self, key: str) -> None:
        self.count += 1
        self.page.keyboard.press(key)

    def type(self, text: str) -> None:
        self.count += 1
        self.page.keyboard.type(text)


class Keyboard(Mouse):
    """The keyboard alone: Tab to what is meant, then a key."""

    name = "keyboard"

    def focus(self, target) -> None:
        target.wait_for()
        for _ in range(MOST_STOPS):
            if target.evaluate("one => one === document.activeElement"):
                return
            self.press("Tab")
        pytest.fail(f"the Tab key does not reach {target}")

    def click(self, target) -> None:
        self.focus(target)
        self.press("Space" if target.get_attribute("type") == "checkbox" else "Enter")

    def choose(self, target, value: str) -> None:
        self.focus(target)
        values = target.locator("option").evaluate_all("all => all.map((one) => one.value)")
        steps = values.index(value) - values.index(target.input_value())
        for _ in range(abs(steps)):
            self.press("ArrowDown" if steps > 0 else "ArrowUp")

    def tab(self, name: str) -> None:
        self.press(TAB_KEYS[name])
        assert self.page.locator(f'[data-tab="{name}"][aria-selected="true"]').is_visible()

    def to_map(self) -> None:
        self.press("g")
        assert self.page.evaluate("document.activeElement.matches('.map')")

    def place(self, east: float, north: float) -> None:
        """Bring a place to the middle, by steps of the arrow keys."""
        for key, forward, back in (
            ("east", "ArrowRight", "ArrowLeft"),
            ("north", "ArrowUp", "ArrowDown"),
        ):
            off = {"east": east, "north": north}[key] - self.middle()[key == "north"]
            for _ in range(round(abs(off) / (128 * RESOLUTION))):
                before = self.middle()
                self.press(forward if off > 0 else back)
                until(self.page, lambda before=before: self.middle() != before)
        self.press("Space")

    def middle(self) -> tuple[float, float]:
        east, north = self.page.url.split("at=")[1].split("&")[0].split(",")[:2]
        return float(east), float(north)

    def menu(self) -> None:
        self.to_map()
        self.press("Shift+F10")

    def pick(self, name: str, pixel: tuple[float, float]) -> None:
        """Bring a pixel to the middle as near as a step of the arrow keys, and pick it there."""
        canvas = pane(self.page, name).locator("canvas")
        self.focus(canvas)
        size, box = size_of(self.page, name), canvas.bounding_box()
        self.press("+")
        scale = 1.5 * min(box["width"] / size[0], box["height"] / size[1])
        for k, keys in enumerate((("ArrowRight", "ArrowLeft"), ("ArrowDown", "ArrowUp"))):
            steps = round((pixel[k] - size[k] / 2) * scale / 60)
            for _ in range(abs(steps)):
                self.press(keys[steps < 0])
        self.press("Enter")

    def pick_middle(self, name: str) -> None:
        self.focus(pane(self.page, name).locator("canvas"))
        self.press("Enter")


MAP = at(RESOLUTION, "mer2/dtm,mer2/orthophoto,mer2/stops,mer2/traverse")


@pytest.fixture(params=[Mouse, Keyboard], ids=lambda one: one.name)
def hand(request, page):
    return request.param(page)


same_by_keyboard = pytest.mark.parametrize(
    "hand",
    [
        pytest.param(Mouse, id="mouse"),
        pytest.param(Keyboard, id="keyboard", marks=pytest.mark.slow),
    ],
    indirect=True,
)
"""Of tasks whose keys are those of other tasks: `make test` counts their clicks only."""


@pytest.fixture
def bowl(hand, url):
    look(hand.page, url + MAP)
    return hand


def stated_counts() -> dict[str, dict[str, list[int]]]:
    """Clicks and keys of each task in the documentation, by hand."""
    text = (ROOT / "docs" / "reference" / "viewer.md").read_text()
    table = text.split("| task | mouse | keyboard alone | MMGIS |")[1].split("\n\n")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]
    return {
        task: {
            hand: [int(count.split()[0]) for count in cell.split(",")]
            for hand, cell in (("mouse", mouse), ("keyboard", keyboard))
        }
        for task, mouse, keyboard, _ in rows
    }


def done(task: str, hand: Mouse, variant: int = 0) -> None:
    """Compare the count of a task with the documentation's, the last one of several variants."""
    counts = STATED[task][hand.name]
    assert hand.count == counts[min(variant, len(counts) - 1)]


STATED = stated_counts()


def copied(page) -> str:
    return page.evaluate("navigator.clipboard.readText()")


def sign_in(page, workspace: Workspace) -> None:
    _, text = Tokens.of(workspace.store.root).add("Ann", Role.ANALYST)
    page.get_by_role("button", name="Sign in").click()
    page.locator('dialog input[type="password"]').fill(text)
    page.locator('dialog button[type="submit"]').click()
    until(page, lambda: "Ann (analyst)" in page.locator(".account").inner_text())


@same_by_keyboard
def test_the_error_of_a_stop(bowl):
    bowl.tab("stops")
    until(bowl.page, lambda: "1.56" in bowl.page.locator("#panel-stops").inner_text())
    done("error of every stop", bowl)


@same_by_keyboard
def test_go_to_a_latitude_and_longitude(bowl):
    bowl.press("/")
    bowl.type("14.5693S 175.4730E")
    bowl.page.wait_for_selector("#search-list li")
    bowl.press("Enter")
    until(bowl.page, lambda: "at=0,0," not in bowl.page.url)
    done("go to a latitude and longitude", bowl)


def test_measure_with_a_standard_deviation(bowl):
    bowl.tab("measure")
    bowl.click(bowl.page.locator('[data-mode="slope"]'))
    bowl.place(0.0, 0.0)
    bowl.place(12.8, 0.0)
    item = bowl.page.locator('[data-quantity="rise"] td')
    item.wait_for()
    assert "±" in item.inner_text()
    done("slope between two places with its standard deviation", bowl)


def test_images_that_see_a_rock(hand, url):
    page = hand.page
    _, _, _, (east, north), _ = STOPS[1]
    rock = (east + 7 * math.sin(azimuth_of(0)), north + 7 * math.cos(azimuth_of(0)))
    look(page, url + at(RESOLUTION, "mer2/orthophoto", *rock))
    hand.menu()
    item = page.get_by_role("menuitem", name="Images here")
    if hand.name == "keyboard":
        while not item.evaluate("one => one === document.activeElement"):
            hand.press("ArrowDown")
    hand.click(item)
    page.locator(".at-place").wait_for()
    assert page.locator(".images li").count() == 2
    done("images that see a rock", hand)


def test_map_the_standard_deviation(bowl):
    if bowl.name == "keyboard":
        bowl.press("l")
        bowl.type("sigma")
    bowl.click(bowl.page.locator('li[data-layer="mer2/dtm-sigma"] input[type=checkbox]').first)
    until(bowl.page, lambda: "Elevation σ" in bowl.page.locator(".map-legend").inner_text())
    done("map of the standard deviation", bowl)


def test_download_a_layer_and_copy_what_qgis_opens(bowl):
    page = bowl.page
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    bowl.tab("downloads")
    files = page.locator("#panel-downloads")
    with page.expect_download() as waiting:
        bowl.click(files.get_by_text("GeoTIFF").first)
    assert waiting.value.path().stat().st_size > 1000
    done("download of a layer as GeoTIFF", bowl)
    bowl.click(files.locator("summary", has_text="Addresses for QGIS"))
    row = files.locator("li", has_text="QGIS").first
    bowl.click(row.get_by_role("button", name="copy"))
    until(page, lambda: copied(page) == row.locator("input").input_value())
    done("download, and copy of an address that QGIS opens", bowl)


def test_add_a_tie_and_preview_the_adjustment(hand, true_images, tmp_path):
    root, page = tmp_path / "store", hand.page
    shutil.copytree(true_images.workspace.store.root, root)
    (mission,) = (one.mission for one in Workspace.open(root).catalogue.missions())
    with Server(root) as server:
        look(page, server.url)
        hand.press("t")
        page.wait_for_selector('[data-pane="second"][data-image]')
        ready(page)
        stop = pane(page, "second").locator("select").first.input_value()
        image = pane(page, "first").get_attribute("data-image")
        size = size_of(page, "first")
        hand.pick("first", shared_pixel(server.url, mission, image, stop, size))
        page.wait_for_selector('[data-pane="second"][data-predicted]')
        ready(page)
        resize(page, 1280, 760)
        hand.pick_middle("second")
        until(page, lambda: "sample" in page.locator('[data-pick="second"]').inner_text())
        hand.click(page.locator('[data-act="plan"]'))
        hand.click(page.locator('[data-act="trial"]'))
        until(page, lambda: "would move by" in page.locator(".editor-status").inner_text())
        keep_screenshot(page, f"task-tie-{hand.name}")
    done("tie point between two stops, and preview of the adjustment", hand)


def test_draw_a_keep_out_area_and_publish_it(hand, workspace, live):
    page = hand.page
    look(page, live + MAP)
    sign_in(page, workspace)
    hand.tab("notes")
    hand.click(page.locator('[data-shape="area"]'))
    for place in ((0.0, 0.0), (12.8, 0.0), (12.8, 12.8)):
        hand.place(*place)
    keep_screenshot(page, f"task-draw-{hand.name}")
    hand.press("Enter")
    hand.choose(page.locator("dialog select"), "keep-out")
    hand.count += 1
    if hand.name == "keyboard":
        hand.focus(page.locator("dialog textarea"))
        page.keyboard.type("loose sand")
    else:
        page.locator("dialog textarea").fill("loose sand")
    hand.click(page.locator('dialog button[type="submit"]'))
    page.locator("[data-note]").wait_for()
    (edit,) = EditLog.of(workspace.store.root).edits("MER2")
    assert edit.document["category"] == "keep-out"
    (corners,) = edit.document["geometry"]["coordinates"]
    assert len(corners) == 4
    assert corners[1][0] - corners[0][0] == pytest.approx(12.8, abs=0.2)
    assert corners[2][1] - corners[1][1] == pytest.approx(12.8, abs=0.2)
    ogc = f"{live}/ogc/MER2/collections/annotations/items?f=json"
    assert len(page.request.get(ogc).json()["features"]) == 1
    done("keep-out area of three corners, published", hand)


@pytest.mark.slow  # draws in three dimensions without a graphics card
def test_share_a_link_with_a_3d_view(hand, tmp_path):
    root, page = tmp_path / "store", hand.page
    fill_scene(Workspace.open(root))
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    with Server(root) as server:
        look(page, server.url + at(RESOLUTION, "mer2/orthophoto"))
        hand.press("3")
        page.wait_for_selector('.scene[data-settled="true"]', timeout=60_000)
        until(page, lambda: "view3d=" in page.url)
        if hand.name == "keyboard":
            hand.press("u")
        else:
            hand.click(page.get_by_role("button", name="copy the link to this view"))
        until(page, lambda: "view3d=" in copied(page))
        done("link to a 3D view", hand)
        look(page, copied(page))
        page.wait_for_selector('.scene[data-settled="true"]', timeout=60_000)


@same_by_keyboard
def test_compare_two_solutions(hand, images_url):
    page = hand.page
    look(page, f"{images_url}/#m=MER2&at=0,0,0.02&on=")
    hand.tab("stops")
    reference = page.locator("select.reference")
    reference.wait_for()
    off = page.locator("[data-row]").last.locator("td").nth(3)
    before = off.inner_text()
    older = reference.locator("option").evaluate_all(
        "all => all.findIndex(({ text }) => text.includes('made') && !text.includes('on the map'))"
    )
    hand.choose(reference, reference.locator("option").nth(older).get_attribute("value"))
    until(page, lambda: off.inner_text() not in ("", before))
    done("two solutions compared", hand)


@same_by_keyboard
def test_images_of_an_instrument_and_a_sol(bowl):
    bowl.press("a")
    subject = bowl.page.locator(".table-bar select").first
    subject.wait_for()
    bowl.choose(subject, "images")
    bowl.click(bowl.page.get_by_placeholder("filter rows"))
    bowl.type("navcam 155")
    rows = bowl.page.locator(".below [role=row]")
    until(bowl.page, lambda: rows.count() > 1)
    done("images of an instrument and a sol", bowl)


@same_by_keyboard
@pytest.mark.parametrize(
    ("variant", "form", "start"), [(0, "PNG", b"\x89PNG"), (1, "PDF", b"%PDF-1.4")]
)
def test_export_the_map(bowl, variant, form, start):
    bowl.tab("downloads")
    with bowl.page.expect_download() as waiting:
        bowl.click(bowl.page.get_by_role("button", name=f"{form} of the map"))
    assert waiting.value.suggested_filename == f"MER2_map.{form.lower()}"
    assert waiting.value.path().read_bytes().startswith(start)
    done("map as PNG, or as PDF", bowl, variant)
