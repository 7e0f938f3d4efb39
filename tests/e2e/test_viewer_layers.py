"""The layers of the viewer in a real browser: order, style, sols, search, swipe and difference."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.raster.raster import summarise, write_dtm
from solmap.products.model import Layer, ProductKind, Recipe, Scope, ScopeLevel
from tests.support.bowl_store import CRS, GRID, STOPS, dtm, fill
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

STOP = STOPS[2][0]
STOP_SOL = 156
MEASURED = np.array([0x21, 0x91, 0x8C])
"""Of the classes of the ground."""
SIGMA_2_CM = np.array([0x21, 0x0C, 0x4A]) * 0.4 + np.array([0x57, 0x10, 0x6E]) * 0.6
"""Of eight parts of 10 cm, 0.6 of the way through the second."""
VIRIDIS = ((0x44, 0x01, 0x54), (0xFD, 0xE7, 0x25))


def moved(east, north):
    """How much higher the model of the stop lies than that of the region, metres."""
    return 0.1 + 0.01 * east + 0.0 * north


@pytest.fixture(scope="module")
def url(tmp_path_factory) -> Iterator[str]:
    """Address of a server over the bowl, and a second model of it from one stop."""
    root = tmp_path_factory.mktemp("layers") / "store"
    workspace = Workspace.open(root)
    fill(workspace)
    publish_model_of_a_stop(workspace)
    publish_image_of_another_camera(workspace)
    with Server(root) as server:
        yield server.url


def publish_model_of_a_stop(workspace: Workspace) -> None:
    east, north = GRID.centres()
    known = dtm()
    height = (known.elevation + moved(east[None, :], north[:, None])).astype(np.float32)
    model = replace(known, elevation=height)
    recipe = Recipe(ProductKind.DTM, Scope(ScopeLevel.STOP, STOP))
    ref = workspace.store.make(recipe, lambda path: write_dtm(path, model, CRS))
    grid, bands = summarise(workspace.store.path(ref))
    facts = (grid.bounds, grid.cell_m, "m", bands[0].range, (STOP_SOL,))
    layer = Layer(ref, "MER2", "a model", "raster", *facts, workspace.store.made_at(ref))
    workspace.catalogue.publish(layers=[layer])


def publish_image_of_another_camera(workspace: Workspace) -> None:
    known = workspace.catalogue.images("MER2", stop=STOP)[0]
    other = replace(known, id=known.id.replace("2n", "2p", 1), instrument="PANCAM", partner=None)
    workspace.catalogue.publish(images=[other])


def shown_order(page) -> list[str]:
    rows = page.locator("ul.shown li")
    return [row.get_attribute("data-layer") for row in rows.all()]


@pytest.mark.both_browsers
def test_a_layer_moves_above_the_next_one_and_the_link_restores_it(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/hillshade,mer2/orthophoto"))
    assert shown_order(page) == ["mer2/orthophoto", "mer2/hillshade"]
    place = pixel_of(page, 2.0, 2.0, resolution)
    assert np.abs(colour_now(page, place) - 91).max() <= 3
    page.get_by_role("button", name="Hillshade: up").click()
    assert shown_order(page) == ["mer2/hillshade", "mer2/orthophoto"]
    page.wait_for_timeout(200)
    lit = 255 * math.sqrt(0.5)  # the bottom of the bowl is nearly level
    assert np.abs(colour_now(page, place) - lit).max() <= 8
    assert "order=1" in page.url
    look(page, page.url)
    assert shown_order(page) == ["mer2/hillshade", "mer2/orthophoto"]


def test_a_dragged_layer_stays_at_its_new_position(page, url):
    look(page, url + at(0.1, "mer2/hillshade,mer2/orthophoto,mer2/slope"))
    assert shown_order(page) == ["mer2/slope", "mer2/orthophoto", "mer2/hillshade"]
    rows = page.locator("ul.shown li")
    box = rows.nth(0).bounding_box()
    rows.nth(2).drag_to(rows.nth(0), target_position={"x": 40, "y": box["height"] * 0.25})
    assert shown_order(page) == ["mer2/hillshade", "mer2/slope", "mer2/orthophoto"]


def test_one_layer_is_shown_alone_and_a_second_click_restores_all(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/hillshade,mer2/orthophoto"))
    place = pixel_of(page, 2.0, 2.0, resolution)
    alone = page.get_by_role("button", name="Hillshade alone")
    alone.click()
    page.wait_for_timeout(300)
    assert colour_now(page, place).mean() > 150
    assert alone.get_attribute("aria-pressed") == "true"
    alone.click()
    page.wait_for_timeout(300)
    assert colour_now(page, place).mean() == pytest.approx(91, abs=3)


def test_a_flickering_layer_is_shown_and_hidden(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/hillshade,mer2/orthophoto"))
    place = pixel_of(page, 2.0, 2.0, resolution)
    page.get_by_role("button", name="Orthophoto: flicker").click()
    seen = set()

    def saw_both() -> bool:
        seen.add(bool(colour_now(page, place).mean() > 150))
        return seen == {True, False}

    until(page, saw_both)


@pytest.mark.both_browsers
def test_slope_drawn_by_the_viewer_equals_slope_drawn_by_the_server(page, url):
    resolution = 0.16
    look(page, url + at(resolution, "mer2/slope"))
    there = screenshot(page, "slope-there").astype(int)
    look(page, url + at(resolution, "mer2/dtm~slope"))
    here = screenshot(page, "slope-here").astype(int)
    places = np.meshgrid(np.arange(-30.0, 30.1, 2.5), np.arange(-20.0, 20.1, 2.5))
    x, y = np.rint(pixel_of(page, *places, resolution)).astype(int)
    apart = np.abs(here[y, x] - there[y, x]).max(axis=-1)
    assert np.percentile(apart, 95) <= 12  # 254 steps over 40 degrees; the centre is steep there


def test_relief_drawn_by_the_viewer_has_no_seams(page, url):
    resolution = 0.08
    look(page, url + at(resolution, "mer2/dtm~relief"))
    image = screenshot(page, "relief").astype(int)
    # Tiles meet at multiples of 20.48 m: across these lines the light changes slowly.
    places = np.meshgrid((-20.48, 0.0, 20.48), np.arange(-15.0, 15.1, 1.5))
    x, y = np.rint(pixel_of(page, *places, resolution)).astype(int)
    rows = image[y[..., None], x[..., None] + np.arange(-4, 5), 0]
    assert np.abs(np.diff(rows)).max() <= 2
    level = colour_at(image, pixel_of(page, 0.3, 0.3, resolution))
    assert np.abs(level - 255 * math.sin(math.radians(45))).max() <= 3


def test_colours_follow_the_chosen_limits_and_so_does_the_legend(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/dtm"))
    row = page.locator('li[data-layer="mer2/dtm"].layer')
    row.locator(".more").click()
    row.get_by_label("lowest colour at").fill("1")
    row.get_by_label("highest colour at").fill("4")
    row.get_by_label("highest colour at").press("Enter")
    ready(page)
    assert row.locator(".ticks span").all_inner_texts() == [
        "1.00",
        "1.75",
        "2.50",
        "3.25",
        "4.00 m",
    ]
    page.wait_for_timeout(300)
    image = screenshot(page, "stretch")
    for radius, colour in ((5.0, VIRIDIS[0]), (25.0, VIRIDIS[1])):
        shown = colour_at(image, pixel_of(page, radius, 0.0, resolution))
        assert np.abs(shown - colour).max() <= 4
    assert "mer2/dtm~::1:4" in page.url
    look(page, page.url)
    page.locator('li[data-layer="mer2/dtm"].layer .more').click()
    assert page.get_by_label("highest colour at").input_value() == "4"


NOTHING = np.array([0xCF, 0xCB, 0xC4])
"""Colour of the page where no layer is, `--ground` of the light page."""


def test_values_below_a_floor_are_not_drawn(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/dtm*1~tilt::::10"))
    image = screenshot(page, "floor")
    # To the south of the middle the ground falls to the north, by 10 degrees at 8.8 m.
    hidden = colour_at(image, pixel_of(page, 0.0, -7.0, resolution))
    drawn = colour_at(image, pixel_of(page, 0.0, -12.0, resolution))
    assert np.abs(hidden - NOTHING).max() <= 2
    assert np.abs(drawn - NOTHING).max() > 20


def test_the_standard_deviation_of_a_model_is_a_layer_with_a_legend(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/dtm-sigma*1"))
    row = page.locator('li[data-layer="mer2/dtm-sigma"].layer')
    assert row.locator("input[type=checkbox]").first.is_checked()
    name = "Elevation σ"
    assert name in row.inner_text()
    until(page, lambda: name in page.locator(".map-legend").inner_text())
    shown = colour_now(page, pixel_of(page, 5.0, 5.0, resolution))
    assert np.abs(shown - SIGMA_2_CM).max() <= 4


def test_classes_of_the_ground_are_a_layer_with_names(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/dtm-class*1"))
    until(page, lambda: "interpolated" in page.locator(".map-legend").inner_text())
    shown = colour_now(page, pixel_of(page, 5.0, 5.0, resolution))
    assert np.abs(shown - MEASURED).max() <= 2


def test_a_model_fades_by_its_standard_deviation(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/dtm*1"))
    place = pixel_of(page, 5.0, 5.0, resolution)
    whole = colour_now(page, place)
    row = page.locator('li[data-layer="mer2/dtm"].layer')
    row.locator(".more").click()
    row.get_by_label("fade by standard deviation").check()
    row.get_by_label("not drawn from this standard deviation on").fill("0.04")
    row.get_by_label("not drawn from this standard deviation on").press("Enter")
    ready(page)
    until(page, lambda: "none from 0.04" in page.locator(".map-legend").inner_text())
    page.wait_for_timeout(300)
    half = colour_now(page, place)  # 2 cm of 4
    assert np.abs(half - (whole + NOTHING) / 2).max() <= 4
    assert "mer2/dtm~:::::::0.04" in page.url
    look(page, page.url)
    assert np.abs(colour_now(page, place) - half).max() <= 2


def test_colours_stretch_to_the_values_on_the_screen(page, url):
    look(page, url + at(0.02, "mer2/dtm", 20.0, 0.0))
    row = page.locator('li[data-layer="mer2/dtm"].layer')
    row.locator(".more").click()
    row.get_by_text("stretch to view").click()
    until(page, lambda: "~" in page.url)
    low = float(row.get_by_label("lowest colour at").input_value())
    high = float(row.get_by_label("highest colour at").input_value())
    assert 1.7 < low < 2.6
    assert 5.5 < high < 7.7


def test_the_sol_slider_hides_layers_of_other_sols(page, url):
    look(page, url + at(0.1, f"mer2/orthophoto,{STOP}/dtm"))
    assert page.locator(f'details[data-scope="{STOP}"]').is_visible()
    page.get_by_label("last sol").press("ArrowLeft")
    assert page.locator(f'details[data-scope="{STOP}"]').is_hidden()
    assert "sol=155" in page.url
    with page.expect_popup() as opened:
        page.get_by_role("link", name="report of sol 155").click()
    report = opened.value
    report.wait_for_load_state()
    assert "sol 155" in report.title()
    page.get_by_label("last sol").press("ArrowRight")
    assert page.locator(f'details[data-scope="{STOP}"]').is_visible()
    assert "sol=" not in page.url


def test_playback_shows_the_sols_in_order_and_ends_with_all(page, url):
    look(page, url + at(0.1, f"mer2/orthophoto,{STOP}/dtm"))
    reported = page.locator(".sol-filter output")
    page.get_by_role("button", name="Play").click()
    until(page, lambda: reported.inner_text() == "sol 155")
    assert page.get_by_role("button", name="Stop", exact=True).is_visible()
    until(page, lambda: reported.inner_text() == "sol 156")
    until(page, lambda: reported.inner_text() == "all sols")
    assert page.get_by_role("button", name="Play").is_visible()


def test_layers_are_filtered_by_name_and_group(page, url):
    look(page, url + at(0.1, "mer2/orthophoto"))
    listed = page.locator(".layers li.layer:visible")
    page.get_by_label("filter layers").fill("elevation")
    until(page, lambda: listed.count() > 0)
    kinds = {one.get_attribute("data-kind") for one in listed.all()}
    assert {kind.removeprefix("far-").removeprefix("region-")[:3] for kind in kinds} == {"dtm"}
    page.get_by_label("filter layers").fill("elevation site drive")
    scopes = {one.get_attribute("data-layer").split("/")[0] for one in listed.all()}
    assert scopes == {STOP}
    page.get_by_label("filter layers").fill("no such layer")
    assert listed.count() == 0
    page.get_by_label("filter layers").fill("")
    until(page, lambda: listed.count() > 3)


def test_layers_are_listed_by_kind_and_by_instrument(page, url):
    look(page, url + at(0.1, "mer2/orthophoto"))
    listed = page.locator(".layers li.layer:visible")
    page.get_by_label("kind of layers").select_option("Elevation (DTM)")
    until(page, lambda: listed.count() == 2)
    ids = {one.get_attribute("data-layer") for one in listed.all()}
    assert ids == {"mer2/dtm", f"{STOP}/dtm"}
    instrument = page.get_by_label("instrument of layers")
    instrument.focus()
    until(page, lambda: "PANCAM" in instrument.inner_text())
    instrument.select_option("PANCAM")
    assert [one.get_attribute("data-layer") for one in listed.all()] == [f"{STOP}/dtm"]
    page.wait_for_timeout(200)
    keep_screenshot(page, "kind-and-instrument")
    page.get_by_label("kind of layers").select_option("")
    instrument.select_option("")
    until(page, lambda: listed.count() > 3)


def test_a_multiplying_layer_darkens_those_below_and_the_link_restores_it(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/hillshade,mer2/orthophoto"))
    place = pixel_of(page, 2.0, 2.0, resolution)
    row = page.locator('li[data-layer="mer2/orthophoto"].layer')
    row.locator(".more").click()
    row.get_by_label("blend").select_option("multiply")
    requested = 91 * math.sqrt(0.5)  # of the shades of both; the bottom of the bowl is nearly level

    def is_multiplied() -> bool:
        return bool(np.abs(colour_now(page, place) - requested).max() <= 4)

    until(page, is_multiplied)
    assert "mer2/orthophoto**multiply" in page.url
    look(page, page.url)
    until(page, is_multiplied)


def test_an_active_layer_takes_one_line_and_shows_its_opacity_on_request(page, url):
    look(page, url + at(0.1, "mer2/hillshade,mer2/orthophoto"))
    row = page.locator("ul.shown li").first
    assert row.bounding_box()["height"] <= 32
    tools = row.locator(".tools")
    assert tools.evaluate("one => getComputedStyle(one).opacity") == "0"
    row.hover()
    assert tools.evaluate("one => getComputedStyle(one).opacity") == "1"
    row.get_by_label("opacity of Orthophoto").fill("0.5")
    until(page, lambda: "mer2/orthophoto*0.5" in page.url)


def test_the_map_frame_is_labelled_with_round_metres(page, url):
    look(page, url + at(0.1))
    frame = page.locator("div.map").bounding_box()
    for label in page.locator(".frame.eastings span").all():
        box = label.bounding_box()
        east = (box["x"] + box["width"] / 2 - frame["x"] - frame["width"] / 2) * 0.1
        text = label.inner_text().replace("E ", "").replace("W ", "-").replace(" m", "")
        assert float(text) == pytest.approx(east, abs=0.11)
    assert page.locator(".frame.eastings span").count() >= 2
    for side in (".frame.northings:not(.opposite)", ".frame.northings.opposite"):
        assert page.locator(f"{side} span").count() >= 2


def test_grid_lines_pass_through_the_labels_and_are_in_the_link(page, url):
    look(page, url + at(0.1))
    assert page.locator(".grid").is_hidden()
    page.get_by_role("button", name="grid lines").click()
    until(page, lambda: "grid=1" in page.url)
    places = "all => all.map((one) => Math.round(parseFloat(one.style.%s)))"
    for line, label, side in (("easting", "eastings", "left"), ("northing", "northings", "top")):
        lines = page.locator(f".grid .{line}").evaluate_all(places % side)
        labels = page.locator(f".frame.{label} span").evaluate_all(places % side)
        assert len(labels) >= 2
        assert set(labels) <= set(lines)
    keep_screenshot(page, "grid")
    page.keyboard.press("#")
    until(page, lambda: "grid=1" not in page.url)
    assert page.locator(".grid").is_hidden()


def centre(page) -> tuple[float, float]:
    east, north = page.url.split("at=")[1].split("&")[0].split(",")[:2]
    return float(east), float(north)


def test_search_opens_a_stop_and_an_image(page, url):
    look(page, url + at(0.1))
    page.locator("div.map").click(position={"x": 300, "y": 600})
    page.keyboard.press("/")
    page.keyboard.type("10/102")
    page.wait_for_selector("#search-list li")
    keep_screenshot(page, "search")
    page.keyboard.press("Enter")
    until(page, lambda: math.dist(centre(page), (2.0, -3.0)) < 0.5)  # bars make it off centre
    page.keyboard.press("/")
    page.keyboard.type("2n1402")
    found = page.locator("#search-list li span").all_inner_texts()
    assert len(found) == 5
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.wait_for_selector(f'[data-image="{found[1]}"]')
    page.keyboard.press("/")
    page.keyboard.type("sol 156")
    page.keyboard.press("Enter")
    until(page, lambda: "sol=156" in page.url)
    assert page.locator("input.sol").input_value() == "2"  # the images' own slider follows
    assert [page.get_by_label(f"{end} sol").input_value() for end in ("first", "last")] == ["1"] * 2


def test_the_divider_shows_one_layer_on_each_side(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/hillshade,mer2/orthophoto") + compare("swipe"))
    left, right = (pixel_of(page, east, 2.0, resolution) for east in (-6.0, 2.0))
    image = screenshot(page, "swipe")
    assert np.abs(colour_at(image, left) - 91).max() <= 3  # the orthophoto, A
    assert colour_at(image, right).mean() > 160  # the hillshade, B
    line = page.locator(".divider")
    box = line.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, 500)
    page.mouse.down()
    page.mouse.move(box["x"] + 120, 500, steps=4)
    page.mouse.up()
    page.wait_for_timeout(300)
    assert np.abs(colour_now(page, right) - 91).max() <= 3
    share = float(page.url.split("compare=swipe,")[1].split("&")[0].split(",")[2])
    assert share == pytest.approx(0.5 + 112.5 / 664, abs=0.01)
    before = int(line.get_attribute("aria-valuenow"))
    line.press("ArrowLeft")
    assert int(line.get_attribute("aria-valuenow")) == before - 2


def compare(mode: str, a: str = "mer2/orthophoto", b: str = "mer2/hillshade") -> str:
    return f"&compare={mode},{a},{b}"


def test_the_difference_of_two_models_is_the_difference_put_in(page, url):
    resolution = 0.1
    pair = compare("difference", f"{STOP}/dtm", "mer2/dtm")
    look(page, url + at(resolution) + pair + ",0.4")
    page.locator('[data-tab="compare"]').click()
    image = screenshot(page, "difference")
    assert page.locator(".difference .ticks span").all_inner_texts() == [
        "−0.4",
        "−0.2",
        "0.0",
        "0.2",
        "0.4 m",
    ]
    same = colour_at(image, pixel_of(page, -10.0, 5.0, resolution))
    higher = colour_at(image, pixel_of(page, 25.0, 5.0, resolution))
    lower = colour_at(image, pixel_of(page, -31.0, 5.0, resolution))
    assert np.abs(same - 0xF7).max() <= 4
    assert higher[0] > higher[2] + 60
    assert lower[2] > lower[0] + 30
    page.mouse.move(*pixel_of(page, 25.0, 5.0, resolution))
    until(page, lambda: "here" in page.locator(".here").inner_text())
    here = float(page.locator(".here").inner_text().split()[1])
    assert here == pytest.approx(moved(25.0, 5.0), abs=0.01)
    assert "mean" in page.locator(".amounts").inner_text()


def test_a_difference_of_metres_and_degrees_is_refused(page, url):
    look(page, url + at(0.1) + compare("difference", "mer2/dtm", "mer2/slope"))
    page.locator('[data-tab="compare"]').click()
    assert "choose two of one unit" in page.locator(".refused").inner_text()
    assert "compare=" not in page.url
