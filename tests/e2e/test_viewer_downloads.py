"""Downloads of the viewer in a real browser: the map as an image, parts, URLs."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest
from rasterio.io import MemoryFile

from tests.support.bowl_store import GRID, elevation_at
from tests.support.browsing import at, keep_screenshot, look, pixel_of, until

STRIP = 92
"""Height of what stands below the map at 96 dots an inch."""
INCH_M = 0.0254


def image_of(page, name: str) -> tuple[bytes, np.ndarray]:
    with page.expect_download() as waiting:
        page.get_by_role("button", name="PNG of the map").click()
    path = waiting.value.path()
    body = path.read_bytes()
    assert waiting.value.suggested_filename == "MER2_map.png"
    image = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    keep(name, body)
    return body, image


def keep(name: str, body: bytes) -> None:
    import os  # noqa: PLC0415 - where screenshots are kept
    from pathlib import Path  # noqa: PLC0415

    if folder := os.environ.get("SOLMAP_SCREENSHOTS"):
        (Path(folder) / f"{name}.png").write_bytes(body)


def bar_length(image: np.ndarray, factor: float) -> int:
    """Dots of the scale bar, the only dark thing in its row at the left."""
    top = image.shape[0] - round(STRIP * factor)
    row = image[top + round(32.5 * factor), : round(200 * factor)]
    dark = np.flatnonzero(row.max(axis=1) < 90)
    assert dark[-1] - dark[0] + 1 == len(dark)
    return len(dark)


def bar_text(metres: float, dots: int, resolution: float) -> None:
    assert dots * resolution == pytest.approx(metres, abs=1.5 * resolution)


def test_the_exported_image_equals_the_map_and_has_a_true_scale_bar(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/orthophoto,mer2/slope*0"))
    page.locator('[data-tab="downloads"]').click()
    box = page.locator("div.map").bounding_box()
    body, image = image_of(page, "sheet-screen")
    assert image.shape[:2] == (round(box["height"]) + STRIP, round(box["width"]))
    for east, north, grey in ((2.0, 2.0, 90), (6.0, 2.0, 170), (-6.0, -6.0, 90)):
        x, y = pixel_of(page, east, north, resolution)
        shown = image[round(y - box["y"]), round(x - box["x"])].astype(int)
        assert np.abs(shown - (grey + 1)).max() <= 3
    bar_text(10.0, bar_length(image, 1.0), resolution)
    assert body[37:41] == b"pHYs"
    assert struct.unpack(">I", body[41:45])[0] == round(96 / INCH_M)


def test_grid_lines_of_the_map_are_in_the_exported_image(page, url):
    resolution = 0.1  # 80 px are 8 m: a line every 10 m
    look(page, url + at(resolution, "mer2/orthophoto") + "&grid=1")
    page.locator('[data-tab="downloads"]').click()
    _, with_lines = image_of(page, "sheet-grid")
    page.locator("div.map").focus()
    page.keyboard.press("#")
    _, without = image_of(page, "sheet-no-grid")
    height, width = without.shape[0] - STRIP, without.shape[1]
    is_line = np.abs(with_lines[:height].astype(int) - without[:height]).sum(axis=2) > 30
    columns = [x for x in range(width) if is_line[:, x].mean() > 0.9]
    rows = [y for y in range(height) if is_line[y].mean() > 0.9]
    assert 0 < len(columns) < 20
    assert np.allclose((np.array(columns) - width / 2) * resolution % 10, 0.0, atol=0.1)
    assert np.allclose((height / 2 - np.array(rows)) * resolution % 10, 0.0, atol=0.1)


def test_a_metre_on_paper_has_the_length_that_the_scale_gives(page, url):
    look(page, url + at(0.1, "mer2/orthophoto"))
    page.locator('[data-tab="downloads"]').click()
    page.get_by_label("paper").select_option("a4")
    page.get_by_label("dots an inch").fill("100")
    page.get_by_label("scale, 1 to").fill("400")
    body, image = image_of(page, "sheet-a4")
    resolution = 400 * INCH_M / 100
    assert image.shape[1] == round(277 / 25.4 * 100)
    assert struct.unpack(">I", body[41:45])[0] == round(100 / INCH_M)
    factor = 100 / 96
    bar_text(10.0, bar_length(image, factor), resolution)
    # Squares of 4 m: the change from dark to bright between 2 m and 6 m east lies at 4 m.
    middle = (image.shape[0] - round(STRIP * factor)) // 2
    row = image[middle - round(2.0 / resolution), :, 0].astype(int)
    start = image.shape[1] // 2 + round(2.0 / resolution)
    edge = start + int(np.argmax(row[start : start + 60] > 130))
    assert (edge - image.shape[1] / 2) * resolution == pytest.approx(4.0, abs=2 * resolution)
    until(page, lambda: "at=0,0,0.1" in page.url)  # the map is as it was


def test_a_box_cuts_a_part_out_of_a_layer(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/dtm,mer2/stops"))
    page.locator('[data-tab="downloads"]').click()
    page.get_by_role("button", name="Draw a box").click()
    page.mouse.click(*pixel_of(page, -4.0, 12.0, resolution))
    page.wait_for_timeout(400)
    page.mouse.click(*pixel_of(page, 10.0, -6.0, resolution))
    link = page.locator('a[href*="/dtm/"][href*="clip"]')
    link.wait_for()
    keep_screenshot(page, "downloads")
    assert page.locator('a[href*="/stops/"][href*="clip"]').count() == 2
    body = page.request.get(url + link.get_attribute("href")).body()
    with MemoryFile(body) as file, file.open() as part:
        assert part.bounds.left == pytest.approx(-4.0, abs=2 * resolution)
        assert part.bounds.top == pytest.approx(12.0, abs=2 * resolution)
        heights = part.read(1)
        row, column = part.index(3.0, 5.0)
        assert heights[row, column] == pytest.approx(elevation_at(3.0, 5.0), abs=GRID.cell_m)


def test_a_list_that_arrives_late_leaves_focus_and_open_sections(page, url):
    held = []

    def hold(route) -> None:
        held.append(route)

    page.route("**/addresses", hold)
    look(page, url + at(0.1, "mer2/orthophoto"))
    page.locator('[data-tab="downloads"]').click()
    files = page.locator("#panel-downloads")
    link = files.get_by_text("GeoTIFF").first
    link.focus()
    files.locator("summary", has_text="Addresses").evaluate(
        "one => (one.parentElement.open = true)"
    )
    until(page, lambda: len(held) == 1)
    held[0].continue_()
    files.locator("li", has_text="QGIS").first.wait_for()
    assert link.evaluate("one => one === document.activeElement")


def test_feature_files_and_service_urls_are_offered_and_answer(page, url):
    look(page, url + at(0.1))
    page.locator('[data-tab="downloads"]').click()
    page.get_by_text("Features of the mission").click()
    forms = page.locator('a[href*="/items?f="]')
    until(page, lambda: forms.count() >= 8)
    stops = page.locator('a[href*="/collections/stops/items?f=fgb"]')
    assert page.request.get(stops.evaluate("a => a.href")).body()[:3] == b"fgb"
    page.get_by_text("Addresses for QGIS").click()
    keep_screenshot(page, "addresses")
    values = [box.input_value() for box in page.locator('input[aria-label^="address"]').all()]
    maps = next(value for value in values if "WMTS" in value)
    assert b"<Capabilities" in page.request.get(maps).body()
    assert any(value.startswith("/vsicurl/http") for value in values)
