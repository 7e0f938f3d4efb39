"""The sun of the viewer in a real browser: light, shadows, thresholds on ground of known shape."""

from __future__ import annotations

import math

import numpy as np
import pytest

from solmap.photogrammetry.terrain.insolation.sun import Season, sun_directions
from tests.support.bowl_store import LANDING
from tests.support.browsing import (
    at,
    colour_at,
    colour_now,
    keep_screenshot,
    look,
    pixel_of,
    screenshot,
    until,
)

NOTHING = np.array([0xCF, 0xCB, 0xC4])
"""Colour of the page where no layer is, `--ground` of the light page."""


def test_relief_brightness_follows_the_sun(page, url):
    resolution = 0.1
    look(page, url + at(resolution) + "&sun=270,30&live=relief")
    image = screenshot(page, "sun-west")
    for east, north in ((10.0, 0.2), (-10.0, 0.2), (0.3, 14.0)):
        rise_east, rise_north = east / 50.0, north / 50.0
        light = (0.5 + math.cos(math.radians(30.0)) * rise_east) / math.sqrt(
            1.0 + rise_east**2 + rise_north**2
        )
        shown = colour_at(image, pixel_of(page, east, north, resolution))
        assert np.abs(shown - 255.0 * light).max() <= 3


def test_a_low_sun_leaves_the_shaded_part_of_the_bowl_dark(page, url):
    resolution = 0.12
    look(page, url + at(resolution, "mer2/orthophoto") + "&sun=90,5&live=shadow")
    page.wait_for_timeout(500)
    image = screenshot(page, "shadow")
    # The rim at 38 m east shades all from which it rises by more than 5 degrees:
    # (38 + east) / 100 > tan 5.
    edge = 100.0 * math.tan(math.radians(5.0)) - 38.0
    dark = colour_at(image, pixel_of(page, edge + 1.0, 0.2, resolution))
    lit = colour_at(image, pixel_of(page, edge - 1.0, 0.2, resolution))
    assert lit.mean() - dark.mean() > 40


def test_north_facing_ground_is_shown_from_the_threshold_on(page, url):
    resolution = 0.1
    look(page, url + at(resolution))
    page.locator('[data-tab="sun"]').click()
    angle = page.get_by_label("least ground that tilts north, degrees")
    angle.fill("10")
    page.get_by_label("ground that tilts north from", exact=True).check()
    page.wait_for_timeout(500)
    until(page, lambda: "live=tilt:10" in page.url)
    image = screenshot(page, "tilt")
    begins = 50.0 * math.tan(math.radians(10.0))  # metres south of the middle
    hidden = colour_at(image, pixel_of(page, 0.0, -(begins - 0.5), resolution))
    drawn = colour_at(image, pixel_of(page, 0.0, -(begins + 0.5), resolution))
    assert np.abs(hidden - NOTHING).max() <= 2
    assert np.abs(drawn - NOTHING).max() > 20
    assert page.locator(".sun .ticks span").all_inner_texts()[0] == "−20"


def test_the_sun_position_at_a_solar_time_equals_the_library(page, url):
    look(page, url + at(0.1) + "&sun=sol:155,15.5&live=relief")
    page.locator('[data-tab="sun"]').click()
    until(page, lambda: "Ls" in page.locator(".sun dl").inner_text())
    keep_screenshot(page, "sun")
    solar_longitude = float(page.locator(".sun dl dd").first.inner_text().rstrip("°"))
    assert solar_longitude == pytest.approx(46.5, abs=1.0)  # of the images' date, 2004-06-11
    flatness = 3376.2 / 3396.19
    latitude = math.atan(math.tan(math.radians(LANDING.latitude)) / flatness**2)
    hour_angle = np.radians([15.0 * (15.5 - 12.0)])
    season = Season(solar_longitude)
    north, east, up = sun_directions(latitude, season.declination, hour_angle)[0]
    azimuth, elevation = (float(text.rstrip("°")) for text in shown_angles(page))
    assert azimuth == pytest.approx(math.degrees(math.atan2(east, north)) % 360, abs=0.1)
    assert elevation == pytest.approx(math.degrees(math.asin(up)), abs=0.1)


def shown_angles(page) -> list[str]:
    return page.locator(".sun output").all_inner_texts()[-2:]


def test_the_light_follows_the_slider(page, url):
    resolution = 0.1
    look(page, url + at(resolution) + "&sun=180,40&live=relief")
    page.locator('[data-tab="sun"]').click()
    place = pixel_of(page, 0.0, -15.0, resolution)
    before = colour_now(page, place).mean()
    slider = page.get_by_label("azimuth of the sun")
    slider.evaluate(
        "node => { node.value = '0'; node.dispatchEvent(new Event('input', {bubbles: true})); }"
    )
    page.wait_for_timeout(500)
    after = colour_now(page, place).mean()
    assert "sun=0,40" in page.url
    rise = -15.0 / 50.0
    lit = [
        255 * (math.sin(0.698) - sign * math.cos(0.698) * rise) / math.hypot(1, rise)
        for sign in (-1, 1)
    ]
    assert [before, after] == pytest.approx(lit, abs=4)
