"""The panorama of a stop in a real browser, over images whose geometry is true."""

from __future__ import annotations

import math

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.measure.ground_point import range_to_ground
from solmap.photogrammetry.terrain.orthophoto.panorama_grid import AngleGrid
from tests.support.browsing import look, pixel_of, screenshot, until

pytestmark = pytest.mark.slow  # a world is rendered first
RESOLUTION = 0.03


@pytest.fixture(scope="module")
def known(images_url, chromium):
    """The first stop's panorama as the server describes it."""
    page = chromium.new_page()
    answer = page.request.get(f"{images_url}/api/missions/MER2/panoramas").json()
    page.close()
    return answer[0]


@pytest.fixture(scope="module")
def place(true_images, known):
    """A pixel's true place (east, north, up), its image, and its direction from the panorama."""
    world = true_images.world
    image = next(e for e in true_images.entries if e.eye == "left" and e.stop == known["scope"])
    camera = world.true_camera(*true_images.shot(image.id))
    ray = camera.rays(np.array([[128.0, 170.0]]))[0]
    met = range_to_ground(camera.centre, ray, true_images.elevation, 30.0, 0.01)
    there = camera.centre + met * ray
    grid = AngleGrid(*(known[k] for k in ("west_deg", "top_deg", "cell_deg", "rows", "cols")))
    away = there - MAP_FROM_LSL.T @ np.array(known["centre"])
    (row,), (col,) = grid.pixels_of(away[None])
    return MAP_FROM_LSL @ there, image.id, (float(row), float(col))


@pytest.fixture
def strip(page, images_url, known):
    east, north, _ = known["centre"]
    look(page, f"{images_url}/#m=MER2&at={east},{north},{RESOLUTION}&on=mer2/stops")
    page.get_by_role("button", name="panorama (p)").click()
    page.wait_for_selector('.panorama[data-settled="true"]', timeout=60_000)
    return page


def on_screen(page, known, place):
    """Where on the page a pixel of the panorama is, while the panorama is shown whole."""
    box = page.locator(".panorama-view").bounding_box()
    resolution = max(known["rows"] / box["height"], known["cols"] / box["width"])
    row, col = place
    x = box["x"] + box["width"] / 2 + (col + 0.5 - known["cols"] / 2) / resolution
    return x, box["y"] + box["height"] / 2 + (row + 0.5 - known["rows"] / 2) / resolution


def test_a_panorama_shows_direction_and_ground_under_the_pointer(strip, known, place):
    (east, north, _), _, pixel = place
    x, y = on_screen(strip, known, pixel)
    plain = screenshot(strip, "panorama").astype(int)
    strip.mouse.move(x + 3, y)
    strip.mouse.move(x, y)
    panorama = strip.locator(".panorama")
    until(strip, lambda: panorama.get_attribute("data-ground"))
    found = [float(text) for text in panorama.get_attribute("data-ground").split(",")]
    assert math.dist(found, (east, north)) < 0.3
    message = strip.locator(".panorama-readout").inner_text().replace("\u2212", "-")
    azimuth = float(message.split("azimuth ")[1].split("°")[0])
    expected = known["west_deg"] + (pixel[1] + 0.5) * known["cell_deg"]
    assert abs((azimuth - expected + 180) % 360 - 180) < 0.5  # two pixels of the screen
    marked = screenshot(strip, "panorama-cursor").astype(int)
    map_box = strip.locator("div.map").bounding_box()
    centre = map_box["x"] + map_box["width"] / 2, map_box["y"] + map_box["height"] / 2
    e, n, _ = known["centre"]
    u = round(centre[0] + (found[0] - e) / RESOLUTION)
    v = round(centre[1] - (found[1] - n) / RESOLUTION)
    near = np.s_[v - 9 : v + 10, u - 9 : u + 10]
    assert np.abs(marked[near] - plain[near]).max() > 60  # the cursor
    half = round((u + centre[0]) / 2), round((v + centre[1]) / 2)
    along = np.s_[half[1] - 12 : half[1] + 13, half[0] - 12 : half[0] + 13]
    yellow = np.abs(marked[along] - [255, 212, 0]).max(axis=2) < 60
    assert yellow.sum() > 5  # the ray of its azimuth


def test_a_place_on_the_map_is_marked_in_the_panorama(strip, known, place):
    (east, north, _), _, pixel = place
    e, n, _ = known["centre"]
    strip.mouse.move(*pixel_of(strip, east - e, north - n, RESOLUTION))
    panorama = strip.locator(".panorama")
    until(strip, lambda: panorama.get_attribute("data-marked"))
    azimuth, above = map(float, panorama.get_attribute("data-marked").split(","))
    expected = (
        (known["west_deg"] + (pixel[1] + 0.5) * known["cell_deg"]) % 360,
        known["top_deg"] - (pixel[0] + 0.5) * known["cell_deg"],
    )
    assert abs((azimuth - expected[0] + 180) % 360 - 180) < 1.0  # a pixel of the map is 3 cm
    assert above == pytest.approx(expected[1], abs=0.7)
    strip.wait_for_timeout(300)
    png = screenshot(strip, "panorama-marked").astype(int)
    x, y = (round(value) for value in on_screen(strip, known, pixel))
    near = png[y - 14 : y + 15, x - 14 : x + 15]
    assert (np.abs(near - [255, 212, 0]).max(axis=2) < 60).sum() > 15


def test_a_click_in_the_panorama_opens_its_image(strip, known, place):
    _, image, pixel = place
    strip.mouse.click(*on_screen(strip, known, pixel))
    strip.wait_for_selector("section.image")
    assert strip.locator("section.image").get_attribute("data-image") == image


def test_keys_move_and_close_the_panorama(strip, known, place):
    *_, pixel = place
    before = on_screen(strip, known, pixel)
    box = strip.locator(".panorama-view").bounding_box()
    first = screenshot(strip, "panorama-keys-before").astype(int)
    view = strip.locator(".panorama-view")
    view.focus()
    view.press("+")
    view.press("ArrowRight")
    strip.wait_for_timeout(800)
    second = screenshot(strip, "panorama-keys-after").astype(int)
    x, y = (round(value) for value in before)
    part = np.s_[y - 20 : y + 20, x - 20 : x + 20]
    assert np.abs(first[part] - second[part]).mean() > 3
    assert box["height"] > 150
    strip.locator(".below .pane button[aria-label=close]").click()
    assert strip.locator(".panorama").count() == 0
