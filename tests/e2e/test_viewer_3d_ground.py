"""Ground of several stops in 3D: one surface, layers over it, measuring, identifying, walking."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
import rasterio

from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind
from tests.e2e.test_viewer_3d import (
    TOLERANCE_M,
    adjust,
    canvas,
    middle,
    only_ground,
    seen_at,
    settled_image,
    spots,
    switch,
)
from tests.support.bowl_store import STOPS, elevation_at
from tests.support.browsing import Server, at, look, ready, until
from tests.support.scene_store import LAST, RAISED_M, fill_overlapping_scene

pytestmark = pytest.mark.slow  # draws in three dimensions without a graphics card

MEASURED = np.array([0x21, 0x91, 0x8C])
"""Colour of ground that was measured, among the classes of ground."""
BORDER_M = 1.0
PIXEL_M = 0.5
"""A pixel of the view on the ground, seen aslant: clicks have whole pixels."""


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    opened = Workspace.open(tmp_path_factory.mktemp("ground") / "store")
    fill_overlapping_scene(opened)
    return opened


@pytest.fixture(scope="module")
def url(workspace: Workspace) -> Iterator[str]:
    with Server(workspace.store.root) as server:
        yield server.url


@pytest.fixture(scope="module")
def merged(workspace: Workspace) -> Iterator[rasterio.DatasetReader]:
    """The merged terrain model."""
    layers = workspace.catalogue.layers("MER2")
    (model,) = (one.ref for one in layers if one.ref.kind is ProductKind.REGION_DTM)
    with rasterio.open(workspace.store.path(model)) as opened:
        yield opened


def settled(page) -> None:
    page.wait_for_selector('.scene[data-settled="true"]', timeout=60_000)


@pytest.fixture
def scene(page, url):
    look(page, url + at(0.1, "mer2/orthophoto"))
    page.get_by_role("button", name="3D view (3)").click()
    settled(page)
    ready(page)
    only_ground(page)
    return page


def nearer_to_first(east: float, north: float) -> float:
    """Metres by which a place is nearer to the first stop than to the last one."""
    first, last = (math.dist((east, north), STOPS[k][3]) for k in (0, -1))
    return last - first


def test_at_every_place_the_nearer_stop_is_shown_alone_and_as_bright_as_the_other(scene):
    picture = settled_image(scene, "merged")
    shades: dict[tuple[bool, bool], list[float]] = defaultdict(list)
    for x, y in spots(scene, 24, 12):
        place = seen_at(scene, x, y)
        if place is None or abs(nearer_to_first(*place[:2])) < BORDER_M:
            continue
        if all(abs((value % 4.0) - 2.0) < 1.0 for value in place[:2]):  # within a square
            is_first = nearer_to_first(*place[:2]) > 0
            is_bright = (math.floor(place[0] / 4) + math.floor(place[1] / 4)) % 2 != is_first
            shades[is_first, is_bright].append(picture[round(y), round(x)].mean())
    assert all(len(shades[key]) >= 2 for key in product((False, True), repeat=2)), shades
    for is_bright in (True, False):
        first, last = (shades[is_first, is_bright] for is_first in (True, False))
        assert np.median(first) == pytest.approx(np.median(last), abs=8)
    assert np.median(shades[True, True]) > np.median(shades[True, False]) + 80
    scene.locator('.scene select[name="stop"]').select_option(LAST)
    settled_image(scene, "one-stop")
    places = [place for x, y in spots(scene) if (place := seen_at(scene, x, y)) is not None]
    assert len(places) > 10
    for place in places:
        assert place[2] == pytest.approx(elevation_at(*place[:2]), abs=TOLERANCE_M)


def test_the_surfaces_of_stops_are_raised_to_the_merged_model_without_a_step(scene, merged):
    sides = set()
    for pixel in spots(scene, 8, 4):
        place = seen_at(scene, *pixel)
        if place is None:
            continue
        sides.add(nearer_to_first(*place[:2]) > 0)
        expected = next(merged.sample([place[:2]]))[0]
        assert place[2] == pytest.approx(expected, abs=TOLERANCE_M)
        assert elevation_at(*place[:2]) < place[2] < elevation_at(*place[:2]) + RAISED_M
    assert sides == {True, False}


def shares_of_measured(page, name: str) -> float:
    """Share of the ground in the middle of the view that has the colour of measured ground."""
    image = settled_image(page, name)
    x, y, width, height = (round(value) for value in canvas(page))
    inner = image[y + height * 2 // 5 : y + height * 3 // 5, x + width // 3 : x + width * 2 // 3]
    return float((np.abs(inner - MEASURED).max(axis=2) < 6).mean())


def test_a_draped_layer_has_its_colours_and_is_in_the_link(scene):
    assert shares_of_measured(scene, "bare") < 0.01
    scene.locator('.scene select[name="drape"]').select_option("dtm-class")
    assert shares_of_measured(scene, "draped") > 0.95
    assert "measured" in scene.locator(".scene-legend").inner_text()
    until(scene, lambda: "show3d=dtm-class" in scene.evaluate("location.hash"))
    link = scene.url
    scene.locator('.scene select[name="drape"]').select_option("")
    assert shares_of_measured(scene, "taken-off") < 0.01
    look(scene, link)
    settled(scene)
    only_ground(scene)
    assert shares_of_measured(scene, "draped-again") > 0.95
    scene.locator('.scene select[name="drape"]').select_option("dtm-source")
    legend = scene.locator(".scene-legend")
    until(scene, lambda: all(f"{d}" in legend.inner_text() for d in ("drive 64", "drive 0")))


def test_two_clicks_measure_with_standard_deviations(scene):
    scene.locator('.scene button[name="measure"]').click()
    x, y = middle(scene)
    ends = [(x - 70, y + 10), (x + 60, y - 30)]
    places = [seen_at(scene, *end) for end in ends]
    for end in ends:
        scene.mouse.click(*end)
    found = scene.locator(".scene-card.measured dl")
    found.wait_for()
    text = found.inner_text()
    length, sigma = map(
        float, re.search(r"length on the map\s+([\d.]+) ± ([\d.]+) m", text).groups()
    )
    assert length == pytest.approx(math.dist(places[0][:2], places[1][:2]), abs=0.1)
    assert 0 < sigma < 0.2
    assert re.search(r"straight, in space\s+[\d.]+ ± [\d.]+ m", text)
    assert re.search(r"rise\s+\S+ ± [\d.]+ m", text)
    assert "measure=distance:" in scene.evaluate("location.hash")
    scene.locator(".scene-view canvas").press("Escape")
    assert scene.locator(".scene-card.measured").is_hidden()


def test_a_click_and_enter_identify_the_ground(scene):
    x, y = middle(scene)
    place = seen_at(scene, x + 50, y + 20)
    scene.mouse.click(x + 50, y + 20)

    def reported() -> list[float]:
        found = re.search(r"pt=([-\d.]+),([-\d.]+)", scene.evaluate("location.hash"))
        return [float(number) for number in found.groups()] if found else [math.inf] * 2

    until(scene, lambda: math.dist(reported(), place[:2]) < PIXEL_M)
    centre = seen_at(scene, x, y)
    scene.locator(".scene-view canvas").press("Enter")
    until(scene, lambda: math.dist(reported(), centre[:2]) < PIXEL_M)


def test_a_drag_identifies_nothing(scene):
    x, y = middle(scene)
    scene.mouse.move(x, y)
    scene.mouse.down()
    scene.mouse.move(x + 40, y + 10, steps=4)
    scene.mouse.up()
    settled_image(scene, "dragged")
    assert "pt=" not in scene.evaluate("location.hash")


def test_the_walk_goes_along_the_traverse_to_the_last_stop(scene):
    switch(scene, "cameras", on=True)
    adjust(scene, "walkSpeed", 10)
    button = scene.locator('.scene button[name="walk"]')
    button.click()
    assert button.get_attribute("aria-pressed") == "true"
    assert not scene.locator('.scene input[name="cameras"]').is_checked()
    scene.wait_for_selector('.scene button[name="walk"][aria-pressed="false"]')
    text = scene.locator(".scene-place").inner_text().replace("\u2212", "-")
    east, north = map(float, re.search(r"east (\S+)\s+north (\S+)", text).groups())
    assert math.dist((east, north), STOPS[-1][3]) < 0.1
    assert scene.locator('.scene input[name="cameras"]').is_checked()


def test_a_walk_can_be_stopped_midway(scene):
    adjust(scene, "walkSpeed", 0.5)
    button = scene.locator('.scene button[name="walk"]')
    button.click()
    until(scene, lambda: scene.locator(".scene-place").inner_text() != "")
    button.click()
    assert button.get_attribute("aria-pressed") == "false"
    text = scene.locator(".scene-place").inner_text().replace("\u2212", "-")
    east, north = map(float, re.search(r"east (\S+)\s+north (\S+)", text).groups())
    assert math.dist((east, north), STOPS[0][3]) < 5.0


def test_a_link_restores_the_view_at_a_stop(page, url):
    look(page, f"{url}{at(0.1)}&view3d=0,-20,15,1,2,0&show3d=/{LAST}/stand")
    settled(page)
    until(page, lambda: not page.locator('.scene input[name="cameras"]').is_checked())
    assert page.locator('.scene select[name="stop"]').input_value() == LAST
