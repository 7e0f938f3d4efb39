"""Places in the viewer: coordinates typed, shown and copied, and the context menu of the map."""

from __future__ import annotations

import math

import numpy as np
import pytest

from solmap.products.catalogue.workspace import Workspace
from tests.support.bowl_store import LANDING, STOPS
from tests.support.browsing import (
    Server,
    at,
    colour_at,
    field,
    keep_screenshot,
    look,
    pixel_of,
    ready,
    resolution_of,
    screenshot,
    until,
)
from tests.support.scene_store import fill_scene

RESOLUTION = 0.1
PLAIN_HTTP = "Object.defineProperty(navigator, 'clipboard', { value: undefined })"
"""As on plain http, where a browser gives scripts no clipboard."""


@pytest.fixture(scope="module")
def scene_url(tmp_path_factory):
    root = tmp_path_factory.mktemp("places") / "store"
    fill_scene(Workspace.open(root))
    with Server(root) as server:
        yield server.url


def centre(page) -> tuple[float, float]:
    east, north = page.url.split("at=")[1].split("&")[0].split(",")[:2]
    return float(east), float(north)


def go_to(page, text: str) -> None:
    page.keyboard.press("/")
    page.keyboard.type(text)
    page.wait_for_selector("#search-list li")
    page.keyboard.press("Enter")


def degrees(east: float, north: float) -> tuple[float, float]:
    """Latitude and longitude of a place near the landing point."""
    turn = 180.0 / math.pi / LANDING.radius_m
    latitude = LANDING.latitude + north * turn
    return latitude, LANDING.longitude + east * turn / math.cos(math.radians(latitude))


def open_menu(page, east: float, north: float):
    page.mouse.click(*pixel_of(page, east, north, RESOLUTION), button="right")
    page.wait_for_selector(".place-menu")
    return page.locator(".place-menu")


def pasted(page) -> str:
    """What is in the clipboard."""
    box = page.get_by_label("search", exact=True)
    box.fill("")
    box.press("Control+V")
    text = box.input_value()
    box.fill("")
    box.press("Escape")
    return text


@pytest.mark.both_browsers
def test_latitude_and_longitude_go_to_their_place(page, url):
    look(page, url + at(RESOLUTION))
    for form, place in (("{:.7f} {:.7f}", (10.0, -8.0)), ("S{s:.7f} W{w:.7f}", (-9.0, 5.0))):
        latitude, longitude = degrees(*place)
        go_to(page, form.format(latitude, longitude, s=-latitude, w=360.0 - longitude))
        until(page, lambda p=place: math.dist(centre(page), p) < 0.5)  # bars make it off centre


def test_rover_frame_coordinates_go_to_their_place(page, scene_url):
    look(page, scene_url + at(RESOLUTION))
    _, site, drive, (east, north), _ = STOPS[1]
    go_to(page, f"{site}/{drive}: 4 1")  # heading 30 degrees
    forward, right = np.array([0.5, math.sqrt(0.75)]), np.array([math.sqrt(0.75), -0.5])
    place = np.array([east, north]) + 4.0 * forward + right
    until(page, lambda: math.dist(centre(page), place) < 0.5)


def test_the_3d_view_turns_to_the_chosen_place(page, scene_url):
    look(page, scene_url + at(RESOLUTION))
    open_menu(page, 6.0, 4.0).get_by_role("menuitem", name="3D here").click()
    page.wait_for_selector('.scene[data-visited="true"]')
    keep_screenshot(page, "places_3d")


def test_the_coordinate_format_is_chosen_and_remembered(page, url):
    look(page, url + at(RESOLUTION))
    page.get_by_label("coordinate format").select_option("dms")
    page.mouse.move(*pixel_of(page, 0.0, 0.0, RESOLUTION))
    until(page, lambda: page.locator('[data-field="lat"]').count() == 1)
    assert field(page, "lat").startswith("14°34′09.")
    assert field(page, "lat").endswith("S")
    keep_screenshot(page, "places_dms")
    page.reload()
    ready(page)
    assert page.get_by_label("coordinate format").input_value() == "dms"


def test_the_place_menu_identifies_and_copies_coordinates_that_search_accepts(new_page, url):
    page = new_page
    page.add_init_script(PLAIN_HTTP)
    look(page, url + at(RESOLUTION))
    menu = open_menu(page, 6.0, 4.0)
    keep_screenshot(page, "places_menu")
    offered = menu.get_by_role("menuitem").all_inner_texts()
    assert offered == [
        "Identify",
        "Images here",
        "Measure from here",
        "Viewshed from here",
        "3D here",
        "Copy coordinates",
        "Copy link",
    ]
    menu.get_by_role("menuitem", name="Copy coordinates").click()
    until(page, lambda: "Coordinates copied" in page.locator(".toast").inner_text())
    latitude, longitude = (
        float(part.strip().replace("−", "-").rstrip("° E")) for part in pasted(page).split(",")
    )
    assert (latitude, longitude) == pytest.approx(degrees(6.0, 4.0), abs=3e-6)
    open_menu(page, 6.0, 4.0).get_by_role("menuitem", name="Copy link").click()
    until(page, lambda: "Link copied" in page.locator(".toast").inner_text())
    address = pasted(page)
    assert address.startswith(url)
    east, north = (float(part) for part in address.split("at=")[1].split(",")[:2])
    assert math.dist((east, north), (6.0, 4.0)) < 2 * RESOLUTION
    page.get_by_label("copy the link to this view").click()
    until(page, lambda: page.locator(".toast").inner_text().count("Link copied") == 2)
    assert pasted(page) == page.url
    open_menu(page, 6.0, 4.0).get_by_role("menuitem", name="Identify").click()
    page.wait_for_selector("#panel-point .coordinates")
    assert "elevation" in page.locator("#panel-point").inner_text()
    keep_screenshot(page, "places_identified")


def test_the_place_menu_works_by_keyboard(page, url):
    look(page, url + at(RESOLUTION))
    page.locator("div.map").focus()
    page.keyboard.press("Shift+F10")
    page.wait_for_selector(".place-menu")
    assert page.evaluate("document.activeElement.textContent") == "Identify"
    page.keyboard.press("ArrowDown")
    assert page.evaluate("document.activeElement.textContent") == "Images here"
    page.keyboard.press("Escape")
    until(page, lambda: page.locator(".place-menu").count() == 0)
    assert page.evaluate("document.activeElement.className").startswith("map")


def test_images_measurements_and_viewsheds_start_from_the_place_menu(page, url):
    look(page, url + at(RESOLUTION))
    open_menu(page, 6.0, 4.0).get_by_role("menuitem", name="Images here").click()
    page.wait_for_selector(".at-place")
    assert int(page.locator("#panel-images .count").inner_text().split()[0]) >= 0
    page.get_by_role("button", name="show all").click()
    open_menu(page, 6.0, 4.0).get_by_role("menuitem", name="Viewshed from here").click()
    page.wait_for_selector('[data-measured="viewshed"]')
    ready(page)
    open_menu(page, 6.0, 4.0).get_by_role("menuitem", name="Measure from here").click()
    page.mouse.click(*pixel_of(page, 6.0, 14.0, RESOLUTION))
    page.keyboard.press("Enter")
    page.wait_for_selector('[data-measured="distance"]')
    shown = page.locator('[data-measured="distance"] [data-quantity="length on the map"] td')
    assert float(shown.inner_text().split()[0]) == pytest.approx(10.0, abs=2 * RESOLUTION)


def test_enter_ends_a_line_and_a_double_click_does_not_zoom(page, url):
    look(page, url + at(RESOLUTION))
    page.keyboard.press("m")
    places = [(-10.0, 0.0), (0.0, 0.0), (0.0, 10.0)]
    for place in places:
        page.mouse.click(*pixel_of(page, *place, RESOLUTION))
        page.wait_for_timeout(350)  # two quick clicks would be a double-click
    page.mouse.move(*pixel_of(page, 8.0, 8.0, RESOLUTION))
    page.keyboard.press("Enter")
    page.wait_for_selector('[data-measured="distance"]')
    shown = page.locator('[data-measured="distance"] [data-quantity="length on the map"] td')
    assert float(shown.inner_text().split()[0]) == pytest.approx(20.0, abs=4 * RESOLUTION)
    page.keyboard.press("Enter")  # with nothing drawn it does nothing
    page.mouse.click(*pixel_of(page, -10.0, -5.0, RESOLUTION))
    page.wait_for_timeout(350)
    page.mouse.dblclick(*pixel_of(page, 5.0, -5.0, RESOLUTION))
    until(page, lambda: page.locator('[data-measured="distance"]').count() == 2)
    page.wait_for_timeout(500)
    assert resolution_of(page) == pytest.approx(RESOLUTION)


def test_stops_of_other_sols_are_hidden_by_the_sol_filter(page, url):
    place = STOPS[1][3]
    for sol, is_drawn in ((155, True), (156, False)):  # all stops are of sol 155
        look(page, url + at(RESOLUTION, "mer2/stops") + f"&sol={sol}")
        image = screenshot(page, f"places_sol_{sol}")
        red, green, blue = colour_at(image, pixel_of(page, *place, RESOLUTION))
        assert (red > 200 and green < 90 and blue < 90) == is_drawn
