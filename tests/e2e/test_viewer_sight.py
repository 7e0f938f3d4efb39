"""On a dome, z = -d^2 / 100: lines of sight, viewsheds, driving round a wall, and tie points."""

from __future__ import annotations

import math

import numpy as np
import pytest

from solmap.products.catalogue.workspace import Workspace
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
from tests.support.dome_store import (
    LOOKED_FROM,
    STRIP,
    WALL_HALF_M,
    WALL_NORTH_M,
    fill,
    horizon_m,
    tie_place,
)

RESOLUTION = 0.1
CLASSES = ("2b5fc7", "3fa7d6", "7fd6a2", "f2e05b", "f58a2a", "d4141c", "8d8d8d")
"""Colours of the residuals of the store's tie points, as the legend names them."""


@pytest.fixture(scope="module")
def dome_url(tmp_path_factory):
    root = tmp_path_factory.mktemp("dome") / "store"
    fill(Workspace.open(root))
    with Server(root) as server:
        yield server.url


@pytest.fixture
def seeing(page, dome_url):
    look(page, dome_url + at(RESOLUTION, "mer2/orthophoto"))
    page.locator('[data-tab="measure"]').click()
    return page


def draw(page, mode, places, **numbers):
    """Choose heights, click the places, and wait for what is found."""
    page.locator(f'[data-mode="{mode}"]').click()
    for key, number in numbers.items():
        page.locator(f'[data-number="{key}"]').fill(str(number))
    for place in places:
        page.mouse.click(*pixel_of(page, *place, RESOLUTION))
        page.wait_for_timeout(350)  # two quick clicks would end the shape
    page.wait_for_selector(f'[data-measured="{mode}"]')
    ready(page)
    return page.locator(f'[data-measured="{mode}"]').first


def text(item, name):
    return item.locator(f'[data-quantity="{name}"] td').inner_text().replace("−", "-")


def value(item, name):
    return float(text(item, name).rstrip(" m²h"))


def test_the_top_of_the_dome_blocks_a_line_and_is_marked(seeing):
    item = draw(seeing, "sight", [(-15.0, 0.0), (15.0, 0.0)], eye_m=1.0, target_m=1.0)
    assert text(item, "line of sight") == "blocked"
    # Both ends are 2.25 m below the top, and the line 1 m above them.
    assert value(item, "least height over the ground") == pytest.approx(-1.25, abs=0.05)
    assert value(item, "blocked after") == pytest.approx(15.0, abs=1.0)
    assert value(item, "blocked at east") == pytest.approx(0.0, abs=1.0)
    assert value(item, "elevation there") == pytest.approx(0.0, abs=0.02)
    caption = seeing.locator(".below figcaption").inner_text()
    assert "is blocked. It runs 1.2" in caption
    seeing.keyboard.press("Escape")
    seeing.evaluate("document.activeElement.blur()")  # its cross in the middle covers the mark
    seeing.wait_for_timeout(300)
    image = screenshot(seeing, "sight_blocked")
    at_east, at_north = value(item, "blocked at east"), value(item, "blocked at north")
    red, green, blue = colour_at(image, pixel_of(seeing, at_east, at_north, RESOLUTION))
    assert (red - green > 120, red - blue > 120) == (True, True)


def test_a_high_enough_eye_sees_over_the_top(seeing):
    item = draw(seeing, "sight", [(-15.0, 0.0), (15.0, 0.0)], eye_m=3.0, target_m=3.0)
    assert text(item, "line of sight") == "free"
    assert value(item, "least height over the ground") == pytest.approx(0.75, abs=0.05)
    assert item.locator('[data-quantity="blocked after"]').count() == 0


def test_visibility_over_unseen_ground_is_unknown(seeing):
    item = draw(seeing, "sight", [(17.0, 0.0), (31.0, 0.0)], eye_m=10.0, target_m=10.0)
    assert text(item, "line of sight") == "not known"
    assert value(item, "longest unmapped stretch") == pytest.approx(STRIP[1] - STRIP[0], abs=0.2)


def test_an_end_on_unmapped_ground_is_refused_with_the_reason(seeing):
    seeing.locator('[data-mode="sight"]').click()
    for east in (10.0, 24.0):
        seeing.mouse.click(*pixel_of(seeing, east, 0.0, RESOLUTION))
        seeing.wait_for_timeout(350)
    until(seeing, lambda: "has no elevation" in seeing.locator(".banner").inner_text())
    assert seeing.locator(".measurement").count() == 0


def test_a_viewshed_ends_at_the_horizon_and_is_removed_with_its_measurement(seeing):
    seen_at, hidden_at = (pixel_of(seeing, 0.0, -d, RESOLUTION) for d in (10.0, 18.0))
    bare = screenshot(seeing, "viewshed_none")
    item = draw(seeing, "viewshed", [(0.0, 0.0)], mast_m=1.0, target_m=0.25, radius_m=20)
    horizon = horizon_m(1.0, 0.25)
    assert value(item, "ground seen") == pytest.approx(math.pi * horizon**2, rel=0.02)
    hidden = math.pi * (20.0**2 - horizon**2)
    assert value(item, "ground hidden") == pytest.approx(hidden, rel=0.03)
    assert value(item, "elevation of the eye") == pytest.approx(1.0, abs=0.01)
    seeing.keyboard.press("Escape")

    def differs():
        return np.abs(colour_now(seeing, seen_at) - grey).max() > 10

    grey = colour_at(bare, seen_at)
    until(seeing, differs)
    laid = screenshot(seeing, "viewshed")
    for spot, colour in ((seen_at, "77aadd"), (hidden_at, "664422")):
        # The server draws it with an opacity of 160 / 255 over the orthophoto.
        mixed = (np.array(list(bytes.fromhex(colour))) * 160 + colour_at(bare, spot) * 95) / 255
        np.testing.assert_allclose(colour_at(laid, spot), mixed, atol=4)
    outside = pixel_of(seeing, 0.0, -21.0, RESOLUTION)
    np.testing.assert_array_equal(colour_at(laid, outside), colour_at(bare, outside))
    link = item.get_by_role("link", name="GeoTIFF").evaluate("a => a.href")
    assert seeing.request.get(link).ok
    seeing.get_by_role("button", name="remove measurement 1").click()
    seeing.wait_for_timeout(300)
    gone = screenshot(seeing, "viewshed_gone")
    for spot in (seen_at, hidden_at):
        np.testing.assert_array_equal(colour_at(gone, spot), colour_at(bare, spot))


def test_a_height_out_of_range_is_clamped(seeing):
    seeing.locator('[data-mode="viewshed"]').click()
    mast = seeing.get_by_label("mast above the ground")
    assert mast.input_value() == "1.5"
    mast.fill("500")
    mast.press("Tab")
    assert mast.input_value() == "100"


def test_the_reachable_area_ends_behind_the_wall_and_is_drawn_on_the_map(seeing):
    near, behind = (pixel_of(seeing, 0.0, north, RESOLUTION) for north in (-12.0, -8.0))
    bare = screenshot(seeing, "reach_none")
    item = draw(seeing, "reach", [(0.0, -15.0)], farthest_m=10, interval_m=2)
    assert value(item, "longest drive") == pytest.approx(10.0, abs=0.2)
    assert value(item, "ground reached") < math.pi * 10**2 - 2 * 2 * WALL_HALF_M[0]
    assert value(item, "time at 36 m an hour") == pytest.approx(10 / 36, abs=0.01)
    seeing.keyboard.press("Escape")
    grey = colour_at(bare, near)
    until(
        seeing,
        lambda: np.abs(colour_now(seeing, near) - grey).max() > 10,
    )
    np.testing.assert_array_equal(colour_now(seeing, behind), colour_at(bare, behind))
    link = item.get_by_role("link", name="GeoTIFF").evaluate("a => a.href")
    assert seeing.request.get(link).ok


def test_a_route_goes_round_the_end_of_the_wall(seeing):
    start, end = (0.0, WALL_NORTH_M - 5.0), (0.0, WALL_NORTH_M + 5.0)
    item = draw(seeing, "route", [start, end])
    half_length, half_width = WALL_HALF_M
    shortest = 2 * math.hypot(half_length, 5.0 - half_width) + 2 * half_width
    assert shortest - 0.1 < value(item, "drive") < 1.04 * shortest
    assert value(item, "straight on the map") == pytest.approx(10.0, abs=0.2)
    assert "up and" in seeing.locator(".below figcaption").inner_text()
    seeing.keyboard.press("Escape")
    seeing.wait_for_timeout(300)
    drawn = screenshot(seeing, "route")
    greens = []
    for side in (-1, 1):  # it passes one of the wall's ends
        x, y = pixel_of(seeing, side * half_length, WALL_NORTH_M, RESOLUTION)
        across = drawn[round(y), round(x) - 12 : round(x) + 13].astype(int)
        greens.append((across[:, 1] - np.maximum(across[:, 0], across[:, 2])).max())
    assert max(greens) > 60


def test_a_missing_safe_route_is_reported(seeing):
    seeing.locator('[data-mode="route"]').click()
    for place in ((0.0, -15.0), (0.0, WALL_NORTH_M)):
        seeing.mouse.click(*pixel_of(seeing, *place, RESOLUTION))
        seeing.wait_for_timeout(350)
    until(seeing, lambda: "no path free of hazards" in seeing.locator(".banner").inner_text())


def rgb(colour):
    return list(bytes.fromhex(colour))


def test_tie_points_have_the_residual_colours_of_the_legend(page, dome_url):
    look(page, dome_url + at(RESOLUTION, "mer2/orthophoto,mer2/tie-points"))
    page.get_by_role("button", name="details of Tie points, mer2").click()
    page.wait_for_timeout(300)
    swatches = page.locator('[data-layer="mer2/tie-points"] .swatch')
    assert swatches.count() == len(CLASSES)
    image = screenshot(page, "ties")
    for number, colour in enumerate(CLASSES):
        reported = (
            swatches.nth(number).locator("i").evaluate("i => getComputedStyle(i).backgroundColor")
        )
        assert reported == "rgb({}, {}, {})".format(*rgb(colour))
        spot = pixel_of(page, *tie_place(number), RESOLUTION)
        np.testing.assert_allclose(colour_at(image, spot), rgb(colour), atol=12)
    assert swatches.nth(3).inner_text() == "0.3 to 1 px"


def test_a_tie_point_under_the_pointer_shows_residual_kind_and_images(page, dome_url):
    look(page, dome_url + at(RESOLUTION, "mer2/orthophoto,mer2/tie-points"))
    tip = page.locator(".tip")
    for number, reported in ((3, "residual 0.50 px"), (5, "residual 26.00 px"), (6, "not known")):
        page.mouse.move(*pixel_of(page, *tie_place(number), RESOLUTION))
        until(page, lambda text=reported: text in tip.inner_text())
        for part in ("cross-site", "0.03 m", "2N1400L0M1", "2N1401L0M1"):
            assert part in tip.inner_text()
        keep_screenshot(page, f"ties_tip_{number}")
        page.mouse.move(*pixel_of(page, 0.0, -10.0, RESOLUTION))
        until(page, lambda: not tip.is_visible())


def test_a_click_on_a_tie_point_selects_the_pointing_line_below(page, dome_url):
    look(page, dome_url + at(RESOLUTION, "mer2/orthophoto,mer2/pointing,mer2/tie-points"))
    spot = pixel_of(page, *tie_place(LOOKED_FROM), RESOLUTION)
    page.mouse.move(*spot)
    until(page, lambda: "tie point" in page.locator(".tip").inner_text())
    page.mouse.click(*spot)
    page.wait_for_selector(".pane h2", state="visible")
    until(page, lambda: "2N14000000" in page.locator(".pane").inner_text())
