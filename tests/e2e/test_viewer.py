"""The viewer in a real browser, on the real server, over a store whose every value is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import lon_lat
from tests.support.bowl_store import (
    CONTOUR_RADIUS_M,
    GALE,
    GRID,
    LANDING,
    STOPS,
    UNPAIRED,
    azimuth_of,
    elevation_at,
)
from tests.support.browsing import (
    WAIT_MS,
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
    turn_of_arrow,
    until,
)


@pytest.mark.both_browsers
def test_relief_image_contours_stops_and_traverse_are_shown_at_first(page, url):
    look(page, url)
    keep_screenshot(page, "first")
    shown = {
        box.get_attribute("data-kind") for box in page.locator("li.layer:has(input:checked)").all()
    }
    assert shown == {"hillshade", "orthophoto", "contours", "stops", "traverse"}
    assert page.locator("h1").inner_text() == "solmap"
    assert "Columbia Memorial Station" in page.locator(".mission").inner_text()


@pytest.mark.both_browsers
def test_squares_of_the_orthophoto_are_at_their_true_coordinates(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/orthophoto"))
    image = screenshot(page, "orthophoto")
    for east, north, grey in ((2.0, 2.0, 90), (6.0, 2.0, 170), (-2.0, 2.0, 170), (-6.0, -6.0, 90)):
        shown = colour_at(image, pixel_of(page, east, north, resolution))
        assert np.abs(shown - (grey + 1)).max() <= 3  # half a grey step in store, tile and screen
    # The edge between squares at 4 m east: half a cell of 8 cm is less than a pixel here.
    y = pixel_of(page, 0.0, 2.0, resolution)[1]
    row = image[round(y), :, 0].astype(int)
    start = round(pixel_of(page, 2.0, 0.0, resolution)[0])
    edge = start + int(np.argmax(row[start : start + 40] > 130))
    assert abs(edge - pixel_of(page, 4.0, 0.0, resolution)[0]) <= 1.5


def test_a_contour_is_at_the_elevation_of_its_label(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/contours"))
    image = screenshot(page, "contours").astype(int)
    # Between the labels, to the north-east of the bowl's middle.
    radius = CONTOUR_RADIUS_M
    turns = np.radians(np.arange(0, 360, 3.0))
    places = radius * np.sin(turns), radius * np.cos(turns)
    x, y = np.rint(pixel_of(page, *places, resolution)).astype(int)
    beside = np.arange(-1, 2)
    patches = image[y[:, None, None] + beside[:, None], x[:, None, None] + beside]
    brown = (patches[..., 0] - patches[..., 2]) > 40
    on_line = brown.any(axis=(1, 2)).sum()
    assert on_line >= 0.8 * len(turns)  # its label interrupts it


def test_the_scale_bar_has_the_length_of_its_label_on_the_ground(page, url):
    for resolution in (0.02, 0.1, 0.37):
        look(page, url + at(resolution))
        bar = page.locator(".scale i")
        metres = float(bar.get_attribute("data-metres"))
        width = bar.bounding_box()["width"]
        assert width * resolution == pytest.approx(metres, rel=0.01)  # a pixel of a hundred
        assert 60 < width <= 161


def test_the_wheel_zooms_about_the_pointer_before_any_click(page, url):
    look(page, url + at(0.1))
    page.mouse.move(*pixel_of(page, 8.0, 4.0, 0.1))
    page.mouse.wheel(0, 240)
    until(page, lambda: resolution_of(page) > 0.11)
    ready(page)
    assert float(field(page, "east").split()[0]) == pytest.approx(8.0, abs=0.2)
    assert float(field(page, "north").split()[0]) == pytest.approx(4.0, abs=0.2)


@pytest.mark.both_browsers
def test_the_pointer_shows_metres_degrees_and_elevation(page, url):
    resolution = 0.05
    look(page, url + at(resolution, "mer2/slope"))
    east, north = 9.0, -6.0
    page.mouse.move(*pixel_of(page, east, north, resolution))
    until(page, lambda: "m" in field(page, "elevation"))
    assert float(field(page, "east").split()[0]) == pytest.approx(east, abs=resolution)
    assert float(field(page, "north").split()[0]) == pytest.approx(north, abs=resolution)
    lon, lat = (float(value[0]) for value in lon_lat(LANDING, east, north))
    degrees_a_pixel = math.degrees(resolution / LANDING.radius_m)
    assert float(field(page, "lon").split("°")[0]) == pytest.approx(lon, abs=2 * degrees_a_pixel)
    assert float(field(page, "lat").split("°")[0]) == pytest.approx(lat, abs=2 * degrees_a_pixel)
    elevation = float(field(page, "elevation").split()[0])
    cell_and_pixel = (GRID.cell_m + resolution) * math.hypot(east, north) / 50.0
    assert elevation == pytest.approx(elevation_at(east, north), abs=cell_and_pixel)
    steep = math.degrees(math.atan(math.hypot(east, north) / 50.0))
    assert float(field(page, "value").split("°")[0]) == pytest.approx(steep, abs=0.2)


@pytest.mark.both_browsers
def test_a_click_lists_every_layer_and_the_images_that_see_the_place(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/orthophoto"))
    name, _, _, (east, north), _ = STOPS[1]
    there = (east + 7 * math.sin(azimuth_of(0)), north + 7 * math.cos(azimuth_of(0)))
    page.mouse.click(*pixel_of(page, *there, resolution))
    page.wait_for_selector(".point table")
    ready(page)
    keep_screenshot(page, "identify")
    kinds = {row.get_attribute("data-layer") for row in page.locator(".point tr[data-layer]").all()}
    assert kinds == {f"mer2/{kind}" for kind in ("dtm", "orthophoto", "slope", "hillshade")}
    seen = page.locator(".image-ids button").all_inner_texts()
    assert sorted(seen) == ["2N14010000" + f"0EFFA000P1600{eye}0M1" for eye in "LR"]
    assert name


@pytest.mark.both_browsers
def test_a_click_on_a_pointing_line_opens_its_image(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/pointing"))
    _, _, _, (east, north), _ = STOPS[2]
    there = (east + 8 * math.sin(azimuth_of(2)), north + 8 * math.cos(azimuth_of(2)))
    page.mouse.move(*pixel_of(page, *there, resolution))
    page.wait_for_selector(".tip:not([hidden])")
    assert UNPAIRED in page.locator(".tip").inner_text()
    page.mouse.click(*pixel_of(page, *there, resolution))
    page.wait_for_selector("section.image")
    ready(page)
    keep_screenshot(page, "image")
    section = page.locator("section.image")
    assert section.get_attribute("data-image") == "2N140200002EFFA000P1600L0M1"
    assert UNPAIRED in section.inner_text()
    browse = section.locator(".browse img")
    until(page, lambda: browse.evaluate("image => image.naturalWidth") == 256)
    original = page.request.get(url + section.locator("a.download").get_attribute("href"))
    assert original.body() == b"label"


def test_one_click_opens_the_partner_of_an_image(page, url):
    look(page, url)
    page.locator('[data-tab="images"]').click()
    assert page.locator(".count").inner_text() == "15 images, 3 without partner"
    page.locator(".images button").first.click()
    first = page.locator("section.image").get_attribute("data-image")
    page.locator("section.image .facts .link").click()
    second = page.locator("section.image").get_attribute("data-image")
    assert {first[-4], second[-4]} == {"L", "R"}
    assert first[:-4] == second[:-4]


def test_the_sol_slider_keeps_the_images_of_one_sol(page, url):
    look(page, url + at(0.1, "mer2/footprints"))
    page.locator('[data-tab="images"]').click()
    page.locator("input.sol").press("ArrowRight")
    assert page.locator(".count").inner_text() == "10 images, 2 without partner"
    assert "sol=155" in page.url
    page.locator("input.sol").press("ArrowRight")
    assert page.locator(".count").inner_text() == "5 images, 1 without partner"
    keep_screenshot(page, "sol")


def test_a_measured_distance_equals_the_distance_on_the_ground(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/orthophoto"))
    page.locator(".measure").click()
    page.mouse.click(*pixel_of(page, 0.0, 0.0, resolution))
    page.wait_for_timeout(400)  # two quick clicks would end the line
    page.mouse.move(*pixel_of(page, 15.0, 10.0, resolution))
    page.mouse.dblclick(*pixel_of(page, 15.0, 20.0, resolution))
    keep_screenshot(page, "measure")
    text = page.locator(".ruler").inner_text()
    assert float(text.split(" m")[0]) == pytest.approx(25.0, abs=2 * resolution)
    azimuth = float(text.split("azimuth ")[1].split("°")[0])
    assert azimuth == pytest.approx(math.degrees(math.atan2(15, 20)), abs=0.5)
    page.keyboard.press("Escape")
    assert page.locator(".ruler").is_hidden()


def test_a_link_restores_view_and_layers(page, url):
    look(page, url + at(0.25, "mer2/slope*0.35,mer2/stops", 5.0, -7.5))
    boxes = page.locator("li.layer:has(input:checked)").all()
    assert {box.get_attribute("data-layer") for box in boxes} == {"mer2/slope", "mer2/stops"}
    page.locator('li[data-layer="mer2/dtm"] input').check()
    ready(page)
    assert "at=5,-7.5,0.25" in page.url
    assert set(page.url.split("on=")[1].split("&")[0].split(",")) == {
        "mer2/slope*0.35",
        "mer2/stops",
        "mer2/dtm*0.6",
    }


def test_a_layer_offers_legend_download_and_history(page, url):
    look(page, url)
    row = page.locator('li[data-layer="mer2/slope"]')
    row.locator("input").first.check()
    row.locator(".more").click()
    ready(page)
    keep_screenshot(page, "slope")
    assert row.locator(".ticks span").all_inner_texts() == ["0", "10", "20", "30", "40°"]
    file = page.request.get(url + row.locator("a.download").get_attribute("href"))
    assert file.body()[:2] in (b"II", b"MM")
    row.locator("button.provenance").click()
    page.wait_for_selector("dialog[open]")
    assert '"kind": "slope"' in page.locator("dialog pre").inner_text()


def test_the_table_of_stops_gives_the_error_of_telemetry(page, url):
    look(page, url)
    page.locator('[data-tab="stops"]').click()
    keep_screenshot(page, "stops")
    rows = page.locator("[data-stop]").all()
    assert [row.locator("td").first.inner_text() for row in rows] == ["10/64", "10/102", "11/0"]
    moved = [float(row.locator("td").last.inner_text()) for row in rows]
    expected = [math.dist(adjusted, telemetry) for *_, adjusted, telemetry in STOPS]
    assert moved == pytest.approx(expected, abs=5e-3)  # to the digits that sigma leaves


def test_another_mission_is_opened_by_one_choice(page, url):
    look(page, url)
    page.get_by_label("mission", exact=True).select_option("MSL")
    until(page, lambda: "Bradbury Landing" in page.locator(".mission").inner_text())
    ready(page)
    assert page.url.split("#")[1].startswith("m=MSL&at=")
    assert "No layer is published yet" in page.locator("aside.left").inner_text()
    x, y = pixel_of(page, 0.0, 0.0, 1.0)
    page.mouse.move(x, y)
    until(page, lambda: field(page, "elevation") == "not measured")
    assert float(field(page, "lon").split("°")[0]) == pytest.approx(GALE.longitude, abs=1e-5)


def test_the_north_arrow_follows_the_rotation_of_the_map(page, url):
    look(page, f"{url}/#m=MER2&at=0,0,0.1,90&on=mer2/orthophoto")
    assert turn_of_arrow(page) == "rotate(90deg)"
    page.locator(".north button").click()
    until(page, lambda: turn_of_arrow(page) == "rotate(0deg)")


def test_the_dark_theme_has_a_dark_background(page, url):
    page.emulate_media(color_scheme="dark")
    look(page, url)
    image = screenshot(page, "dark")
    assert image[788, 1200].mean() < 60
    page.get_by_role("button", name="light or dark").click()
    assert screenshot(page, "light")[788, 1200].mean() > 200


def test_an_unreachable_server_is_reported(browser, tmp_path):
    fill_nothing = Workspace.open(tmp_path / "store")
    mission = MissionEntry("MER2", "Spirit", LANDING, None)
    fill_nothing.catalogue.publish(missions=[mission])
    with Server(tmp_path / "store") as server:
        page = browser.new_page()
        look(page, server.url)
        assert "No layer is published yet" in page.locator("aside.left").inner_text()
    page.mouse.click(600, 400)
    page.wait_for_selector(".banner:not([hidden])", timeout=WAIT_MS)
    assert "does not answer" in page.locator(".banner").inner_text()
    page.close()


@pytest.mark.parametrize("resolution", [0.05])
def test_adjusted_and_telemetry_have_the_colours_of_the_paper(page, url, resolution):
    look(page, url + at(resolution, "mer2/traverse"))
    image = screenshot(page, "traverse").astype(int)
    (_, _, _, from_east_north, _), (_, _, _, to_east_north, _) = STOPS[0], STOPS[1]
    middle = tuple((a + b) / 2 for a, b in zip(from_east_north, to_east_north, strict=True))
    red, green, blue = colour_at(image, pixel_of(page, *middle, resolution))
    assert red > 200
    assert max(green, blue) < 90
