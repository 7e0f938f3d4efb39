"""Original images beside the map, over images whose geometry is true."""

from __future__ import annotations

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.products.catalogue.oriented_images import OrientedMission
from tests.support.browsing import (
    ROOT,
    field,
    keep_screenshot,
    look,
    pixel_of,
    ready,
    screenshot,
    until,
)
from tests.support.stereo_viewer import RESIDUAL_PX

RESOLUTION = 0.03


@pytest.fixture(scope="module")
def oriented(true_images):
    return OrientedMission.latest("MER2", true_images.workspace)


@pytest.fixture(scope="module")
def entry(oriented):
    """A left image of the first stop."""
    entries = oriented.workspace.catalogue.images("MER2")
    return next(one for one in entries if one.eye == "left" and one.partner)


@pytest.fixture(scope="module")
def ground(entry, oriented, true_images):
    """A pixel of the image's lower half and the place that it shows, (east, north, up)."""
    image = oriented.oriented_image(entry)
    size = np.array(image.size)
    for share in (0.6, 0.7, 0.8):
        pixel = size * (0.5, share)
        ray = MAP_FROM_LSL @ image.camera.rays(pixel[None])[0]
        centre = MAP_FROM_LSL @ image.camera.centre
        along = np.arange(0.5, 9.0, 0.005)
        points = centre + along[:, None] * ray
        below = points[:, 2] <= true_images.elevation(points[:, :2])
        if below.any():
            return pixel, points[np.argmax(below)]
    raise AssertionError("the image shows no ground")


@pytest.fixture
def viewer(page, images_url, entry):
    look(page, f"{images_url}/#m=MER2&at=0,0,{RESOLUTION}&on=mer2/stops")
    page.locator('[data-tab="images"]').click()
    page.locator(f'.images button:has-text("{entry.id}")').click()
    page.wait_for_selector('.image-view[data-ties]:not([data-ties="0"])')
    ready(page)
    return page


def view_of(page):
    return page.locator(".image-view")


def on_screen(page, pixel, size):
    """Where on the page a pixel of the image is, while it is shown whole."""
    box = page.locator("canvas.image-canvas").bounding_box()
    scale = min(box["width"] / size[0], box["height"] / size[1])
    left = box["x"] + (box["width"] - scale * size[0]) / 2
    top = box["y"] + (box["height"] - scale * size[1]) / 2
    return left + (pixel[0] + 0.5) * scale, top + (pixel[1] + 0.5) * scale


def cross_of(page):
    text = view_of(page).get_attribute("data-cross") or ""
    sample, line, sight = text.split(",") if text else ("nan", "nan", "")
    return float(sample), float(line), sight


def test_a_pointing_line_opens_its_image_beside_the_map(page, images_url, oriented, entry):
    look(page, f"{images_url}/#m=MER2&at=0,0,{RESOLUTION}&on=mer2/pointing")
    image = oriented.oriented_image(entry)
    centre = MAP_FROM_LSL @ image.camera.centre
    axis = MAP_FROM_LSL @ image.camera.rays(np.array([image.size]) / 2)[0]
    there = centre + 2.5 * axis / np.hypot(*axis[:2])
    page.mouse.click(*pixel_of(page, there[0], there[1], RESOLUTION))
    page.wait_for_selector(".image-view[data-image]")
    ready(page)
    opened = view_of(page).get_attribute("data-image")
    assert opened in (entry.id, entry.partner)  # their lines are a stereo base apart
    keep_screenshot(page, "image_opened")


def test_the_place_under_the_pointer_is_marked_in_the_image(viewer, oriented, entry, ground):
    _, place = ground
    viewer.mouse.move(*pixel_of(viewer, place[0], place[1], RESOLUTION))
    until(viewer, lambda: cross_of(viewer)[2] == "visible")
    east, north = (float(field(viewer, name).split()[0]) for name in ("east", "north"))
    up = place[2]
    point = MAP_FROM_LSL.T @ np.array([east, north, up])
    expected = oriented.oriented_image(entry).camera.project(point[None])[0]
    # The pointer is read to a pixel of the map; the ground tilts a little within it.
    np.testing.assert_allclose(cross_of(viewer)[:2], expected, atol=3.0)
    seen = viewer.locator('.strip li[data-sight="visible"]')
    assert entry.id in [item.get_attribute("data-image") for item in seen.all()]
    keep_screenshot(viewer, "image_cursor")


def test_the_pixel_under_the_pointer_is_marked_on_the_map(viewer, oriented, entry, ground):
    pixel, place = ground
    before = screenshot(viewer, "image_before")
    viewer.mouse.move(*on_screen(viewer, pixel, oriented.oriented_image(entry).size))
    status = viewer.locator(".image-status")
    until(viewer, lambda: "matched" in status.inner_text() or "terrain" in status.inner_text())
    viewer.wait_for_timeout(300)
    after = screenshot(viewer, "image_to_map")
    text = status.inner_text().replace("−", "-")
    north = float(text.split("N ")[1].split()[0])
    east = float(text.split("E ")[1].split()[0])
    assert np.hypot(east - place[0], north - place[1]) < 0.15  # the canvas is read to a pixel
    x, y = pixel_of(viewer, east, north, RESOLUTION)
    arm = np.s_[round(y) - 10 : round(y) - 4, round(x) - 3 : round(x) + 4]
    assert np.abs(after[arm].astype(int) - before[arm]).max() > 60


def test_ties_are_drawn_with_their_residuals(viewer, images_url, oriented, entry):
    size = oriented.oriented_image(entry).size
    ties = viewer.request.get(f"{images_url}/api/missions/MER2/images/{entry.id}/ties").json()
    assert int(view_of(viewer).get_attribute("data-ties")) == len(ties["ties"]) > 5
    lengths = [np.hypot(t["residual_sample_px"], t["residual_line_px"]) for t in ties["ties"]]
    np.testing.assert_allclose(lengths, np.hypot(*RESIDUAL_PX[:2]), rtol=0.1)  # of stored pixels
    tie = max(ties["ties"], key=lambda one: min(one["sample"], size[0] - one["sample"]))
    viewer.locator("select.residuals").select_option("50")
    viewer.wait_for_timeout(300)
    drawn = screenshot(viewer, "image_ties")
    viewer.locator(".show-ties").uncheck()
    viewer.wait_for_timeout(300)
    plain = screenshot(viewer, "image_no_ties")
    assert view_of(viewer).get_attribute("data-ties") == "0"
    # Half way along the vector, measured minus computed fifty times as long, something is drawn.
    half = (
        tie["sample"] - 25 * tie["residual_sample_px"],
        tie["line"] - 25 * tie["residual_line_px"],
    )
    x, y = on_screen(viewer, half, size)
    patch = np.s_[round(y) - 1 : round(y) + 2, round(x) - 1 : round(x) + 2]
    assert np.abs(drawn[patch].astype(int) - plain[patch]).max() > 50


def test_a_tie_under_the_pointer_names_its_images(viewer, images_url, oriented, entry):
    ties = viewer.request.get(f"{images_url}/api/missions/MER2/images/{entry.id}/ties").json()
    tie = ties["ties"][0]
    size = oriented.oriented_image(entry).size
    viewer.mouse.move(*on_screen(viewer, (tie["sample"], tie["line"]), size))
    status = viewer.locator(".image-status")
    until(viewer, lambda: "tie point" in status.inner_text())
    assert "cross-site: residual 0.5" in status.inner_text()
    assert any(pair in status.inner_text() for pair in tie["pairs"])


def test_the_wheel_zooms_and_contrast_changes_the_image(viewer):
    scale = float(view_of(viewer).get_attribute("data-scale"))
    box = viewer.locator("canvas.image-canvas").bounding_box()
    viewer.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    viewer.mouse.wheel(0, -500)
    until(viewer, lambda: float(view_of(viewer).get_attribute("data-scale")) > 1.8 * scale)
    viewer.locator(".show-ties").uncheck()
    viewer.locator("input.white").fill("120")
    viewer.wait_for_timeout(300)
    bright = screenshot(viewer, "image_bright")
    viewer.get_by_role("button", name="as is").click()
    viewer.wait_for_timeout(300)
    plain = screenshot(viewer, "image_plain")
    inside = np.s_[
        round(box["y"]) + 20 : round(box["y"] + box["height"]) - 20,
        round(box["x"]) + 20 : round(box["x"] + box["width"]) - 20,
    ]
    assert bright[inside].mean() > plain[inside].mean() + 20
    viewer.locator("canvas.image-canvas").press("0")
    until(viewer, lambda: float(view_of(viewer).get_attribute("data-scale")) == scale)


def test_the_graph_shows_the_ties_of_stops_and_pairs(page, images_url, entry):
    look(page, f"{images_url}/#m=MER2&at=0,0,{RESOLUTION}&on=")
    page.locator('[data-tab="network"]').click()
    graph = page.request.get(f"{images_url}/api/missions/MER2/network").json()
    (link,) = graph["links"]
    assert page.locator(".links tbody td").nth(1).inner_text() == str(link["ties"])
    page.locator("button.graph").click()
    drawn = page.locator(f'[data-link="{link["one"]} {link["other"]}"]')
    assert drawn.locator(".edge-count").text_content() == str(link["ties"])
    assert page.locator("[data-stop-node]").count() == 2
    keep_screenshot(page, "network_stops")
    page.locator(f'[data-stop-node="{entry.stop}"]').click()
    page.wait_for_selector(f'[data-pair="{entry.id}"]')
    keep_screenshot(page, "network_pairs")
    page.locator(f'[data-pair="{entry.id}"]').press("Enter")
    page.wait_for_selector(f'.image-view[data-image="{entry.id}"]')


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
def test_image_graph_and_profile_have_no_accessibility_issue(viewer, scheme):
    axe = ROOT / "gis_server" / "viewer" / "node_modules" / "axe-core" / "axe.min.js"
    if not axe.is_file():
        pytest.skip("axe-core is not installed: run `npm ci` in gis_server/viewer")
    viewer.emulate_media(color_scheme=scheme)
    viewer.evaluate(axe.read_text())  # by the driver: the page's own policy lets no text run
    found = issues_of(viewer)
    viewer.locator('[data-tab="stops"]').click()
    viewer.locator(".comparison .profile").click()
    viewer.wait_for_selector(".below .chart-line")
    found += issues_of(viewer)
    viewer.locator('[data-tab="network"]').click()
    viewer.locator("button.graph").click()
    viewer.wait_for_selector("[data-stop-node]")
    assert found + issues_of(viewer) == []


def issues_of(page) -> list[str]:
    page.wait_for_timeout(200)
    found = page.evaluate("async () => (await axe.run({ resultTypes: ['violations'] })).violations")
    return [
        f"{issue['id']}: {node['target']}: {node['failureSummary']}"
        for issue in found
        for node in issue["nodes"]
    ]
