"""The traverse in the viewer: differences from telemetry and an older solution are known."""

from __future__ import annotations

import csv
import io
import math
import re

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.products.catalogue.oriented_images import OrientedMission
from tests.support.browsing import (
    colour_at,
    keep_screenshot,
    look,
    pixel_of,
    ready,
    screenshot,
    until,
)
from tests.support.stereo_viewer import OLDER_STEP_NED_M, older_solution

RESOLUTION = 0.02
VECTOR = (0x8A, 0x4F, 0xFF)


@pytest.fixture(scope="module")
def places(true_images):
    """(east, north, up) of the stops as adjusted, and by telemetry."""
    network = OrientedMission.latest("MER2", true_images.workspace).network
    stops = network.adjusted.stops
    adjusted = [MAP_FROM_LSL @ stop.lsl_from_rover.translation_m for stop in stops]
    reported = [MAP_FROM_LSL @ network.telemetry[stop.stop].translation_m for stop in stops]
    return np.array(adjusted), np.array(reported)


@pytest.fixture
def traverse(page, images_url):
    look(page, f"{images_url}/#m=MER2&at=0,0,{RESOLUTION}&on=")
    page.locator('[data-tab="stops"]').click()
    page.wait_for_selector(".differences")
    ready(page)
    return page


def cells(page, label):
    return page.locator(f'[data-row="{label}"] td').all_inner_texts()


def last_label(page):
    return page.locator("[data-row]").last.get_attribute("data-row")


def number(text):
    return float(text.replace("−", "-").rstrip(" %"))


def test_accumulated_differences_are_in_metres_and_percent(traverse, places):
    adjusted, reported = places
    _, sol, distance, off, percent, height = cells(traverse, last_label(traverse))
    way = math.hypot(*(adjusted[1] - adjusted[0])[:2])
    away = (reported[1] - reported[0]) - (adjusted[1] - adjusted[0])
    assert sol == "156"
    assert number(distance) == pytest.approx(way, abs=0.06)
    assert number(off) == pytest.approx(math.hypot(*away[:2]), abs=6e-4)
    assert number(percent) == pytest.approx(100 * math.hypot(*away[:2]) / way, abs=0.006)
    assert number(height) == pytest.approx(away[2], abs=6e-4)
    summary = traverse.locator(".comparison .summary").inner_text()
    assert f"{100 * math.hypot(*away[:2]) / way:.2f} %" in summary
    keep_screenshot(traverse, "traverse_table")


def test_an_older_solution_is_compared_with_the_latest(traverse, true_images):
    choices = traverse.locator("select.reference option").all_inner_texts()
    assert sum("made" in text and "on the map" not in text for text in choices) == 2
    traverse.locator("select.reference").select_option(older_solution(true_images.workspace))
    step = math.hypot(*OLDER_STEP_NED_M[:2])
    until(traverse, lambda: cells(traverse, last_label(traverse))[3] == f"{step:.3f}")
    height = number(cells(traverse, last_label(traverse))[5])
    assert height == pytest.approx(-OLDER_STEP_NED_M[2], abs=6e-4)  # down is down


def test_difference_vectors_point_to_the_telemetry_of_the_stop(traverse, places):
    adjusted, reported = places
    before = screenshot(traverse, "vectors_off")
    traverse.locator("input.vectors").check()
    traverse.get_by_label("length of difference vectors").select_option("1")
    traverse.wait_for_timeout(300)
    after = screenshot(traverse, "vectors_on")
    away = (reported[1] - reported[0]) - (adjusted[1] - adjusted[0])
    for share in (0.3, 0.6):
        x, y = pixel_of(traverse, *(adjusted[1] + share * away)[:2], RESOLUTION)
        patch = np.s_[round(y) - 2 : round(y) + 3, round(x) - 2 : round(x) + 3]
        off = np.abs(after[patch].astype(int) - VECTOR).sum(axis=-1)
        assert off.min() < 60
        assert np.abs(before[patch].astype(int) - VECTOR).sum(axis=-1).min() > 150


@pytest.mark.both_browsers
def test_the_vertical_profile_and_the_map_share_one_cursor(traverse, places):
    adjusted, _ = places
    traverse.locator(".comparison .profile").click()
    traverse.wait_for_selector('.below path[data-series="adjusted"]')
    readout = traverse.locator(".below .chart-readout")
    way = math.hypot(*(adjusted[1] - adjusted[0])[:2])
    middle = (adjusted[0] + adjusted[1]) / 2
    # From the map to the profile.
    traverse.mouse.move(*pixel_of(traverse, middle[0], middle[1], RESOLUTION))
    # The ground below the traverse arrives while the pointer rests: the chart keeps its cursor.
    traverse.wait_for_selector('.below path[data-series="ground below"]')
    until(traverse, lambda: ", adjusted " in readout.inner_text())
    distance, reported = re.split(" m: .*, adjusted ", readout.inner_text())
    assert number(distance) == pytest.approx(way / 2, abs=0.1)
    assert number(reported.split(" ± ")[0]) == pytest.approx(middle[2], abs=0.02)
    # From the profile to the map: the cross is where the rover was.
    before = screenshot(traverse, "profile_before")
    chart = traverse.get_by_role("slider", name="Vertical profile of the traverse")
    chart.focus()
    chart.press("End")
    until(traverse, lambda: readout.inner_text().startswith(f"{way:.1f}"))
    traverse.wait_for_timeout(300)
    after = screenshot(traverse, "profile_cursor")
    x, y = pixel_of(traverse, adjusted[1][0], adjusted[1][1], RESOLUTION)
    arm = np.s_[round(y) - 10 : round(y) - 5, round(x) - 3 : round(x) + 4]
    assert np.abs(after[arm].astype(int) - before[arm]).max() > 60


def test_a_clicked_stop_shows_the_error_of_telemetry(page, images_url, places):
    look(page, f"{images_url}/#m=MER2&at=0,0,{RESOLUTION}&on=mer2/stops")
    ready(page)
    adjusted, reported = places
    page.mouse.click(*pixel_of(page, adjusted[1][0], adjusted[1][1], RESOLUTION))
    card = page.locator(".stop-card")
    card.wait_for()
    away = (reported[1] - reported[0]) - (adjusted[1] - adjusted[0])
    text = card.inner_text()
    for name, length in (("horizontal", math.hypot(*away[:2])), ("3D", np.linalg.norm(away))):
        reported_m, sign = text.split(f"{name} ")[1].split()[:2]
        assert (float(reported_m), sign) == (pytest.approx(length, abs=6e-4), "±")
    keep_screenshot(page, "stop_card")
    card.get_by_role("button", name="Images").click()
    until(page, lambda: page.locator("#panel-images").is_visible())
    stop = page.locator("#panel-images select").first.input_value()
    assert stop == card.get_attribute("data-stop")
    # Another place is not a stop.
    page.mouse.click(*pixel_of(page, adjusted[1][0] - 2.0, adjusted[1][1], RESOLUTION))
    until(page, lambda: card.count() == 0)


def test_the_differences_are_exported_as_a_table(traverse, places):
    with traverse.expect_download() as download:
        traverse.locator(".comparison .csv").click()
    rows = list(csv.DictReader(io.StringIO(download.value.path().read_text())))
    assert len(rows) == 2
    found = [float(rows[1][name]) for name in ("east", "north", "elevation_m")]
    np.testing.assert_allclose(found, places[0][1], atol=1e-4)
    assert rows[1]["reference"] == "telemetry"


def test_solutions_have_the_colours_of_the_paper(page, images_url, places):
    look(page, f"{images_url}/#m=MER2&at=0,0,{RESOLUTION}&on=mer2/traverse")
    adjusted, _ = places
    image = screenshot(page, "traverse_colours")
    middle = (adjusted[0] + adjusted[1]) / 2
    red, green, blue = colour_at(image, pixel_of(page, middle[0], middle[1], RESOLUTION))
    assert red > 200
    assert max(green, blue) < 100


def test_legs_and_stops_of_later_sols_are_not_drawn(page, images_url, places):
    adjusted, _ = places
    middle = adjusted[:, :2].mean(axis=0)
    leg = adjusted[0, :2] + 0.6 * (adjusted[1, :2] - adjusted[0, :2])
    for sols, is_drawn in (("155", False), ("150-155", False), ("155-156", True), ("156", True)):
        link = f"/#m=MER2&at={middle[0]},{middle[1]},{RESOLUTION}&on=mer2/traverse,mer2/stops"
        look(page, f"{images_url}{link}&sol={sols}")
        image = screenshot(page, f"legs-{sols}")
        for place in (leg, adjusted[1, :2]):
            at_place = colour_at(image, pixel_of(page, *(place - middle), RESOLUTION))
            assert (at_place[0] > at_place[2] + 60) == is_drawn, (sols, at_place)
