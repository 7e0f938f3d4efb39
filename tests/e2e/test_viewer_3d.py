"""The 3D view in a real browser, over a bowl whose every point is known."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from solmap.products.catalogue.workspace import Workspace
from tests.e2e.test_viewer_layout import CUT_OFF
from tests.support.bowl_store import STOPS, elevation_at
from tests.support.browsing import (
    Server,
    at,
    keep_screenshot,
    look,
    pixel_of,
    ready,
    resize,
    screenshot,
    until,
)
from tests.support.scene_store import POINT_GREYS, POINTS, fill_scene, heading, place_of

pytestmark = pytest.mark.slow  # draws in three dimensions without a graphics card

TOLERANCE_M = 0.12
"""Triangles two levels above the finest: 8 cm; what is read: 1 cm; a pixel on a slope: the rest."""
NUMBER = re.compile(r"east (\S+)\s+north (\S+)\s+elevation (\S+) m")
MOST_TRIANGLES = 20_000


@pytest.fixture(scope="module")
def scene_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    root: Path = tmp_path_factory.mktemp("scene") / "store"
    fill_scene(Workspace.open(root))
    with Server(root) as server:
        yield server.url


@pytest.fixture
def scene(page, scene_url):
    """The page with the 3D view open and all ground loaded."""
    look(page, scene_url + at(0.1, "mer2/orthophoto"))
    page.get_by_role("button", name="3D view (3)").click()
    page.wait_for_selector('.scene[data-settled="true"]', timeout=60_000)
    ready(page)
    return page


def canvas(page) -> tuple[float, float, float, float]:
    box = page.locator(".scene-view canvas").bounding_box()
    return box["x"], box["y"], box["width"], box["height"]


def seen_at(page, x: float, y: float) -> np.ndarray | None:
    """(east, north, elevation) that the view reads at a pixel of the page; None: no ground."""
    page.mouse.move(float(x) + 1.0, float(y))
    page.mouse.move(float(x), float(y))
    text = page.locator(".scene-place").inner_text().replace("\u2212", "-")
    found = NUMBER.search(text)
    return np.array([float(value) for value in found.groups()]) if found else None


def linked_camera(page) -> list[float]:
    """East, north and up of the eye and of what it looks at, as the link has them."""
    written = page.evaluate("location.hash").split("view3d=")[1].split("&")[0].split(",")
    return [float(number) for number in written]


def middle(page) -> tuple[float, float]:
    x, y, width, height = canvas(page)
    return x + width / 2, y + height / 2


@contextmanager
def options(page) -> Iterator[None]:
    """The options of the view, which lie over it while they are open."""
    button = page.locator('.scene button[name="options"]')
    button.click()
    yield
    button.click()


def switch(page, *names: str, on: bool = False) -> None:
    with options(page):
        for name in names:
            page.locator(f'.scene input[name="{name}"]').set_checked(on)


def adjust(page, name: str, value: float) -> None:
    with options(page):
        page.locator(f'.scene input[name="{name}"]').fill(str(value))


def only_ground(page) -> None:
    switch(page, "rover", "cameras", "traverse", "ellipsoids")


def settled_image(page, name: str) -> np.ndarray:
    """A screenshot after the last frame: levels of detail come one after the other."""
    page.mouse.move(5, 5)
    page.wait_for_timeout(400)
    page.wait_for_selector('.scene[data-settled="true"]', timeout=30_000)
    return screenshot(page, f"3d-{name}").astype(int)


def spots(page, columns: int = 6, rows: int = 5) -> list[tuple[float, float]]:
    x, y, width, height = canvas(page)
    across, down = np.linspace(0.2, 0.8, columns), np.linspace(0.3, 0.7, rows)
    return [(x + u * width, y + v * height) for v in down for u in across]


def test_the_ground_has_its_true_position_and_its_photograph(scene):
    only_ground(scene)
    assert 100 < int(scene.locator(".scene").get_attribute("data-triangles")) < MOST_TRIANGLES
    image = settled_image(scene, "ground")
    right = compared = 0
    for x, y in spots(scene, 9, 8):
        place = seen_at(scene, x, y)
        if place is None:
            continue
        east, north, up = place
        assert up == pytest.approx(elevation_at(east, north), abs=TOLERANCE_M)
        inside = [abs((value % 4.0) - 2.0) < 1.5 for value in (east, north)]
        if all(inside):  # half a metre from any edge of a square
            expected = 170 if (math.floor(east / 4) + math.floor(north / 4)) % 2 else 90
            compared += 1
            right += abs(image[round(y), round(x)].mean() - expected) < 12
    assert compared >= 10
    assert right == compared


def test_the_controls_leave_the_view_its_room_and_cut_nothing_off(scene):
    for width, height in ((1440, 900), (1280, 800), (390, 844)):
        resize(scene, width, height)
        pane = scene.locator(".panes .dock-body").bounding_box()
        assert canvas(scene)[3] > 0.75 * pane["height"]
        assert scene.evaluate(CUT_OFF) == []
        with options(scene):
            box = scene.locator(".scene-options").bounding_box()
            assert box["y"] >= pane["y"]
            assert scene.evaluate(CUT_OFF) == []
            keep_screenshot(scene, f"3d-options-{width}")
    scene.locator('.scene button[name="options"]').click()
    scene.locator(".scene-options input").first.press("Escape")
    assert scene.locator(".scene-options").is_hidden()


def test_a_link_restores_the_camera(page, scene_url):
    look(page, scene_url + at(0.1, "mer2/orthophoto") + "&view3d=0,-20,15,1,2,0")
    page.wait_for_selector('.scene[data-settled="true"]', timeout=60_000)
    page.wait_for_timeout(800)
    assert linked_camera(page) == pytest.approx([0, -20, 15, 1, 2, 0], abs=0.02)


def test_the_map_and_the_view_share_one_cursor(scene):
    only_ground(scene)
    before = settled_image(scene, "no-cursor")
    east, north = 6.0, -9.0
    resolution = 0.1
    scene.mouse.move(*pixel_of(scene, east, north, resolution))
    scene.wait_for_timeout(400)
    after = screenshot(scene, "3d-cursor-from-map").astype(int)
    x, y, width, height = (round(value) for value in canvas(scene))
    yellow = (np.abs(after - [255, 212, 0]).max(axis=2) < 60)[y : y + height, x : x + width]
    changed = (np.abs(after - before).max(axis=2) > 30)[y : y + height, x : x + width]
    rows, columns = np.nonzero(yellow & changed)
    assert len(rows) > 20
    # The cross lies on the ground: its middle is where the pole's foot is.
    foot = columns.mean() + x, rows.max() + y - 2
    place = seen_at(scene, *foot)
    assert place is not None
    distance = math.dist(*np.array(linked_camera(scene)).reshape(2, 3))
    assert math.dist(place[:2], (east, north)) < distance / 50 + 0.5  # as far the arms reach
    # And back: the map marks the place under the pointer of the view.
    plain = screenshot(scene, "3d-plain-map").astype(int)
    spot = middle(scene)
    place = seen_at(scene, *spot)
    scene.wait_for_timeout(300)
    marked = screenshot(scene, "3d-cursor-on-map").astype(int)
    u, v = (round(value) for value in pixel_of(scene, place[0], place[1], resolution))
    patch = np.s_[v - 9 : v + 10, u - 9 : u + 10]
    assert np.abs(marked[patch] - plain[patch]).max() > 60
    scene.mouse.move(5, 5)


def test_heights_may_be_exaggerated_and_are_reported_true(scene):
    only_ground(scene)
    spot = (middle(scene)[0] + 40, middle(scene)[1] - 40)
    before = seen_at(scene, *spot)
    adjust(scene, "exaggeration", 3)
    settled_image(scene, "exaggerated")
    after = seen_at(scene, *spot)
    assert not np.allclose(before[:2], after[:2], atol=0.5)
    assert after[2] == pytest.approx(elevation_at(*after[:2]), abs=TOLERANCE_M)


def test_a_click_on_a_camera_opens_its_image(scene):
    switch(scene, "traverse", "ellipsoids")
    scene.locator('.scene select[name="stop"]').select_option(STOPS[2][0])
    x = canvas(scene)[0]
    image = settled_image(scene, "cameras")
    teal = np.abs(image - [11, 143, 134]).max(axis=2) < 25
    teal[:, : round(x)] = False
    assert teal.sum() > 30
    dense = cv2.boxFilter(teal.astype(np.float32), -1, (9, 9))
    row, column = np.unravel_index(np.argmax(dense), dense.shape)
    scene.mouse.click(float(column), float(row))
    card = scene.locator(".scene-card .link")
    assert card.inner_text() in {"2N140200000EDN1100P1600L0M1", "2N140200000EDN1100P1600R0M1"}
    chosen = settled_image(scene, "camera-chosen")
    assert (np.abs(chosen - [255, 212, 0]).max(axis=2) < 40).sum() > 30
    name = card.inner_text()
    card.click()
    scene.wait_for_selector("section.image")
    assert scene.locator("section.image").get_attribute("data-image") == name


def test_the_view_at_a_stop_faces_the_heading_of_the_rover(scene):
    only_ground(scene)
    scene.locator('.scene select[name="stop"]').select_option(STOPS[2][0])
    scene.locator('.scene button[name="stand"]').click()
    settled_image(scene, "standing")
    index = 2
    east, north, _ = place_of(index)
    place = seen_at(scene, *middle(scene))
    azimuth = math.atan2(place[0] - east, place[1] - north)
    assert math.degrees(azimuth) == pytest.approx(math.degrees(heading(index)), abs=6.0)
    eye_m = 1.5
    reach = math.dist(place[:2], (east, north))
    assert eye_m < reach < 15.0  # 12 degrees down from 1.5 m, on ground that rises ahead
    scene.locator(".scene-view canvas").press("Escape")
    far = seen_at(scene, *middle(scene))
    assert not np.allclose(far[:2], place[:2], atol=1.0)


def test_outlines_are_hidden_at_a_stop_and_shown_again_in_flight(scene):
    outlines = [
        scene.locator(f'.scene input[name="{name}"]')
        for name in ("cameras", "traverse", "ellipsoids")
    ]
    assert all(one.is_checked() for one in outlines)
    scene.locator('.scene button[name="stand"]').click()
    until(scene, lambda: not any(one.is_checked() for one in outlines))
    scene.locator(".scene-view canvas").press("Escape")
    until(scene, lambda: all(one.is_checked() for one in outlines))


def test_the_view_at_a_stop_has_sky_above_the_ground(scene):
    only_ground(scene)
    scene.locator('.scene button[name="stand"]').click()
    image = settled_image(scene, "sky")
    x, y, width, _ = canvas(scene)
    above = image[int(y) + 4, int(x + width / 2)]
    dark, bright = np.array([0xA9, 0x8F, 0x78]), np.array([0xDC, 0xC9, 0xAF])  # zenith, horizon
    assert (dark - 3 <= above).all()
    assert (above <= bright + 3).all()


def test_arrow_keys_turn_the_view_about_its_target(scene):
    only_ground(scene)
    x, y = middle(scene)
    first, right = seen_at(scene, x, y), seen_at(scene, x + 60, y)
    assert right[0] > first[0] + 1
    for _ in range(18):
        scene.locator(".scene-view canvas").press("ArrowRight")  # 5 degrees each: a quarter turn
    scene.wait_for_timeout(300)
    second, beside = seen_at(scene, x, y), seen_at(scene, x + 60, y)
    assert math.dist(first[:2], second[:2]) < 0.6
    assert beside[1] > second[1] + 1  # from the east, north is to the right
    assert "at=" in scene.url


def test_the_sun_lights_the_slope_that_faces_it(scene):
    only_ground(scene)
    with options(scene):
        scene.locator('.scene select[name="shading"]').select_option("relief")
        scene.locator('.scene input[name="elevation"]').fill("20")
    shades = {}
    x, y, width, height = canvas(scene)
    for azimuth in (90, 270):
        adjust(scene, "azimuth", azimuth)
        image = settled_image(scene, f"sun-{azimuth}")
        row = round(y + height / 2)
        strip = image[row - 3 : row + 4, :, :].mean(axis=(0, 2))
        shades[azimuth] = strip[round(x + 0.3 * width)], strip[round(x + 0.7 * width)]
    west, east = 0, 1  # sides of the bowl: each faces the sun that stands across
    assert shades[90][west] > shades[90][east] + 15
    assert shades[270][east] > shades[270][west] + 15


def test_red_and_cyan_views_differ(scene):
    only_ground(scene)
    x, y, width, height = (round(value) for value in canvas(scene))
    rows = slice(y + height * 2 // 5, y + height * 3 // 5)  # ground alone, no sky
    part = np.s_[rows, x + width // 4 : x + 3 * width // 4]
    plain = settled_image(scene, "one-eye")[part]
    switch(scene, "anaglyph", on=True)
    double = settled_image(scene, "anaglyph")[part]
    apart = [np.abs(eyes[..., 0] - eyes[..., 2]).mean() for eyes in (plain, double)]
    assert apart[0] < 3
    assert apart[1] > 5


def test_tie_points_and_telemetry_are_shown_in_3d(scene):
    x = round(canvas(scene)[0])
    image = settled_image(scene, "all")[:, x:]
    red = (np.abs(image - [224, 45, 37]).max(axis=2) < 40).sum()
    blue = (np.abs(image - [23, 105, 224]).max(axis=2) < 40).sum()
    assert red > 100
    assert blue > 50
    switch(scene, "ties", on=True)
    scene.wait_for_timeout(600)
    image = settled_image(scene, "ties")[:, x:]
    assert (np.abs(image - [122, 77, 216]).max(axis=2) < 40).sum() > 40


def test_the_rover_outline_on_the_map_has_its_true_size(page, scene_url):
    resolution = 0.01
    east, north, _ = place_of(0)  # it heads north there
    look(page, scene_url + at(resolution, "", east, north))
    ready(page)
    page.wait_for_timeout(400)
    image = screenshot(page, "3d-outline").astype(int)
    ink = np.abs(image - [28, 47, 87]).max(axis=2) < 40
    box = page.locator("div.map").bounding_box()
    ink[:, : round(box["x"] + 80)] = False  # tools
    ink[:, round(box["x"] + box["width"] - 60) :] = False
    ink[: round(box["y"] + 60)] = False
    ink[round(box["y"] + box["height"] - 60) :] = False  # labels of the grid
    rows, columns = np.nonzero(ink)
    assert (columns.max() - columns.min()) * resolution == pytest.approx(2.3, abs=0.04)
    assert (rows.max() - rows.min()) * resolution == pytest.approx(1.7, abs=0.3)  # and its arrow
    centre = box["x"] + box["width"] / 2
    assert (columns.max() + columns.min()) / 2 == pytest.approx(centre, abs=2)


def test_dense_points_have_their_brightness_and_the_chosen_size(scene):
    only_ground(scene)
    switch(scene, "ground")
    bare = settled_image(scene, "no-ground")
    switch(scene, "points", on=True)
    points = lambda: int(scene.locator(".scene").get_attribute("data-points") or 0)  # noqa: E731
    until(scene, lambda: points() > 2000)
    small = settled_image(scene, "points")
    assert points() <= POINTS
    adjust(scene, "pointSize", 6)
    large = settled_image(scene, "points-large")
    x, y, width, height = (round(value) for value in canvas(scene))
    middle_x = x + width // 2
    inner = slice(y + height // 3, y + 2 * height // 3)
    sides = slice(x + 60, middle_x - 60), slice(middle_x + 60, x + width - 60)
    for side, grey in zip(sides, POINT_GREYS, strict=True):
        shown = (np.abs(large - bare).max(axis=2) > 20)[inner, side]
        assert shown.sum() > 300
        assert np.median(large[inner, side][shown]) == pytest.approx(grey, abs=12)
    drawn = [
        (np.abs(image - bare).max(axis=2) > 20)[y : y + height, x : x + width].sum()
        for image in (small, large)
    ]
    assert drawn[1] > 1.5 * drawn[0] > 0
    switch(scene, "points")
    gone = settled_image(scene, "points-gone")
    assert (np.abs(gone - bare).max(axis=2) > 20)[y + 60 : y + height, x : x + width].sum() < 50
