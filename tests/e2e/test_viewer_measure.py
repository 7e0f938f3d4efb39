"""Measuring in the viewer on the bowl, z = d^2 / 100, where every answer is known."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest

from solmap.products.crs import east_north
from tests.support.bowl_store import LANDING, elevation_at
from tests.support.browsing import (
    at,
    colour_at,
    keep_screenshot,
    look,
    pixel_of,
    ready,
    screenshot,
    until,
)

RESOLUTION = 0.1
CLICKED = ("slope", "plane", "sight", "viewshed")
"""Shapes that a single click ends; the others end with a double-click."""


@pytest.fixture
def measuring(page, url):
    look(page, url + at(RESOLUTION, "mer2/orthophoto"))
    page.locator('[data-tab="measure"]').click()
    return page


def draw(page, mode, places):
    """Draw a shape through places; a double-click ends a line of more than two, or an area."""
    page.locator(f'[data-mode="{mode}"]').click()
    for east, north in places[:-1]:
        page.mouse.click(*pixel_of(page, east, north, RESOLUTION))
        page.wait_for_timeout(350)  # two quick clicks would end the shape
    last = pixel_of(page, *places[-1], RESOLUTION)
    (page.mouse.click if mode in CLICKED else page.mouse.dblclick)(*last)
    if mode == "plane":
        page.keyboard.press("Enter")
    page.wait_for_selector(f'[data-measured="{mode}"]')
    ready(page)
    return page.locator(f'[data-measured="{mode}"]').first


def value(item, name):
    """A quantity and its standard deviation as printed."""
    text = item.locator(f'[data-quantity="{name}"] td').inner_text()
    number, _, sigma = text.replace("−", "-").rstrip("° m²³%").partition(" ± ")
    return float(number), float(sigma) if sigma else None


def saved(page, name):
    with page.expect_download() as download:
        page.get_by_role("button", name=name, exact=True).click()
    return download.value.path().read_text()


def test_rise_and_slope_equal_those_of_the_ground_with_their_errors(measuring):
    item = draw(measuring, "slope", [(10.0, 0.0), (20.0, 0.0)])
    keep_screenshot(measuring, "measure_slope")
    length, _ = value(item, "length on the map")
    assert length == pytest.approx(10.0, abs=2 * RESOLUTION)
    rise, sigma = value(item, "rise")
    assert rise == pytest.approx(3.0, abs=0.08)  # a pixel at either end: 0.1 m of a slope of 0.4
    assert sigma == pytest.approx(0.02 * math.sqrt(2), abs=2e-3)
    slope, _ = value(item, "slope")
    assert slope == pytest.approx(math.degrees(math.atan2(3.0, 10.0)), abs=0.3)
    for azimuth in ("azimuth on the map", "azimuth from true north"):
        assert value(item, azimuth)[0] == pytest.approx(90.0, abs=0.9)


def test_a_square_has_its_area_and_the_bowl_its_volume(measuring):
    square = [(-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)]
    item = draw(measuring, "area", square)
    assert value(item, "area on the map")[0] == pytest.approx(400.0, abs=40 * 2 * RESOLUTION)
    assert value(item, "highest ground")[0] == pytest.approx(2.0, abs=0.05)
    measuring.keyboard.press("Escape")
    item = draw(measuring, "volume", square)
    # The rim's mean is 4/3, the ground's 2/3 of a^2 / 100: a hollow of 8 a^4 / 300.
    assert value(item, "net")[0] == pytest.approx(-8 * 10.0**4 / 300, rel=0.03)
    keep_screenshot(measuring, "measure_volume")


def test_strike_and_dip_equal_those_of_the_plane_through_the_points(measuring):
    places = [(10.0, 0.0), (20.0, 0.0), (15.0, 12.0)]
    item = draw(measuring, "plane", places)
    heights = [elevation_at(*place) for place in places]
    design = np.column_stack([places, np.ones(3)])
    east_slope, north_slope, _ = np.linalg.solve(design, heights)
    dip, sigma = value(item, "dip")
    steepest = math.hypot(east_slope, north_slope)
    assert dip == pytest.approx(math.degrees(math.atan(steepest)), abs=0.5)
    assert 0.05 < sigma < 0.5  # 2 cm at the ends of some 10 m
    downhill = math.degrees(math.atan2(-east_slope, -north_slope)) % 360
    assert value(item, "dip direction")[0] == pytest.approx(downhill, abs=1.5)
    assert value(item, "strike")[0] == pytest.approx((downhill - 90) % 360, abs=1.5)


def test_statistics_are_those_of_the_values_inside_the_outline(measuring):
    measuring.locator('[data-mode="zone"]').click()
    measuring.get_by_label("layer", exact=True).select_option("mer2/dtm")
    measuring.keyboard.press("Escape")
    item = draw(measuring, "zone", [(-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)])
    assert value(item, "mean")[0] == pytest.approx(200.0 / 300.0, abs=0.02)
    assert value(item, "greatest")[0] == pytest.approx(2.0, abs=0.05)
    # Half of the square is nearer to its middle than sqrt(200 / pi) = 7.98 m.
    assert value(item, "median")[0] == pytest.approx(200.0 / math.pi / 100.0, abs=0.02)


def test_in_a_bowl_every_place_sees_every_other(measuring):
    item = draw(measuring, "sight", [(-25.0, 10.0), (25.0, -5.0)])
    assert item.locator('[data-quantity="line of sight"] td').inner_text() == "free"
    length = math.hypot(50.0, 15.0)
    assert value(item, "length on the map")[0] == pytest.approx(length, abs=2 * RESOLUTION)
    # The ground hangs below a line of length l by s (l - s) / 100 at s metres from the eye, which
    # is 1.5 m higher than the ground, the target 0.1 m: least at the target's end.
    end = 0.3 + 0.08  # nearer ground carries the target; and a station
    least = 0.1 + end * 1.4 / length + end * (length - end) / 100.0
    clearance = value(item, "least height over the ground")[0]
    assert clearance == pytest.approx(least, abs=0.06)
    measuring.keyboard.press("Escape")
    item = draw(measuring, "viewshed", [(5.0, 0.0)])  # 50 m around it lies all of the bowl
    seen = value(item, "ground seen")[0]
    assert seen == pytest.approx(math.pi * 38.0**2, rel=0.01)  # nothing was mapped beyond 38 m
    assert value(item, "ground hidden")[0] == 0.0
    not_known = math.pi * (50.0**2 - 38.0**2)
    assert value(item, "not known")[0] == pytest.approx(not_known, rel=0.01)


@pytest.mark.both_browsers
def test_a_profile_and_the_map_share_one_cursor(measuring):
    draw(measuring, "profile", [(-20.0, 0.0), (20.0, 0.0)])
    caption = measuring.locator(".below figcaption").inner_text()
    assert re.search(r"Elevation \S+ ± 0.02\d* m to 4.\d+ ± 0.02\d* m\.", caption), caption
    assert "100 % measured" in caption
    measuring.locator('[data-mode="profile"]').click()  # the pointer is free again
    ready(measuring)
    place = pixel_of(measuring, -10.0, 6.0, RESOLUTION)
    field = measuring.locator(".chart-field").bounding_box()
    readout = measuring.locator(".chart-readout")
    # On the chart: a quarter of the way along; a cross is drawn at that place on the map.
    before = screenshot(measuring, "measure_profile_before")
    left, right = field["x"] + 56, field["x"] + field["width"] - 14
    measuring.mouse.move(left + 0.25 * (right - left), field["y"] + 50)
    until(measuring, lambda: readout.inner_text() != "")
    distance, _, reported = readout.inner_text().partition(" m: elevation ")
    assert float(distance) == pytest.approx(10.0, abs=0.1)
    assert float(reported.split(" ± ")[0]) == pytest.approx(1.0, abs=0.03)
    assert float(reported.split(" ± ")[1].split()[0]) == pytest.approx(0.02, abs=2e-3)
    measuring.wait_for_timeout(200)
    after = screenshot(measuring, "measure_profile")
    x, y = (round(pixel) for pixel in pixel_of(measuring, -10.0, 0.0, RESOLUTION))
    arm = np.s_[y - 10 : y - 5, x - 3 : x + 4]  # of the cross, above the line
    assert np.abs(after[arm].astype(int) - before[arm]).max() > 60
    # On the map, near the line: the chart's cursor goes to that distance.
    measuring.mouse.move(place[0], y - 20)
    until(measuring, lambda: readout.inner_text().startswith("10.0"))
    measuring.mouse.move(place[0], y - 150)  # 15 m off: no longer at the line
    until(measuring, lambda: readout.inner_text() == "")


def test_arrow_keys_move_along_the_profile(measuring):
    draw(measuring, "profile", [(-20.0, 0.0), (20.0, 0.0)])
    chart = measuring.get_by_role("slider", name="Profile of the ground")
    chart.focus()
    chart.press("End")
    assert float(chart.get_attribute("aria-valuenow")) == pytest.approx(40.0, abs=0.2)
    assert "elevation 4.0" in chart.get_attribute("aria-valuetext")
    chart.press("ArrowLeft")
    assert float(chart.get_attribute("aria-valuenow")) == pytest.approx(39.8, abs=0.2)


def test_measurements_are_exported_as_table_and_geojson(measuring):
    draw(measuring, "slope", [(10.0, 0.0), (20.0, 0.0)])
    table = saved(measuring, "CSV")
    assert "1,slope,rise," in table
    collection = json.loads(saved(measuring, "GeoJSON"))
    (feature,) = collection["features"]
    lon, lat = zip(*feature["geometry"]["coordinates"], strict=True)
    east, north = east_north(LANDING, np.array(lon), np.array(lat))
    np.testing.assert_allclose(east, [10.0, 20.0], atol=RESOLUTION)
    np.testing.assert_allclose(north, [0.0, 0.0], atol=RESOLUTION)
    assert feature["properties"]["layers"][0].startswith("mer2/dtm/")


def test_lengths_beyond_mapped_ground_are_measured_on_the_map(page, url):
    look(page, url + at(RESOLUTION, "mer2/orthophoto", 200.0, 0.0))  # 200 m east of the bowl
    page.locator('[data-tab="measure"]').click()
    item = draw(page, "distance", [(-5.0, 0.0), (5.0, 0.0)])
    assert value(item, "length on the map")[0] == pytest.approx(10.0, abs=2 * RESOLUTION)


def test_a_removed_measurement_disappears_from_list_and_map(measuring):
    empty = screenshot(measuring, "measure_none")
    draw(measuring, "slope", [(10.0, 3.0), (20.0, 3.0)])
    measuring.keyboard.press("Escape")
    spot = pixel_of(measuring, 15.0, 3.0, RESOLUTION)
    drawn = screenshot(measuring, "measure_one")
    assert np.abs(colour_at(drawn, spot).astype(int) - colour_at(empty, spot)).max() > 40
    measuring.get_by_role("button", name="remove measurement 1").click()
    measuring.wait_for_timeout(300)
    gone = screenshot(measuring, "measure_gone")
    assert np.abs(colour_at(gone, spot).astype(int) - colour_at(empty, spot)).max() <= 3
    assert measuring.locator(".measurement").count() == 0
