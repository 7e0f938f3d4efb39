"""The tie-point editor: from a pick in one image to an adjustment that has changed."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import httpx
import numpy as np
import pytest

from solmap.products.catalogue.edits import EditKind, EditLog
from solmap.products.catalogue.tokens import Role, Tokens
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductKind
from tests.support.browsing import Server, keep_screenshot, look, ready, resize, screenshot, until

Point = tuple[float, float]


@pytest.fixture
def own(true_images, tmp_path) -> Iterator[tuple[Workspace, str]]:
    """A copy of the store of true images, which may be written to, and its server."""
    root = tmp_path / "store"
    shutil.copytree(true_images.workspace.store.root, root)
    with Server(root) as server:
        yield Workspace.open(root), server.url


def sign_in(page, workspace) -> None:
    _, text = Tokens.of(workspace.store.root).add("Ann", Role.ANALYST)
    page.get_by_role("button", name="Sign in").click()
    page.locator('dialog input[type="password"]').fill(text)
    page.locator('dialog button[type="submit"]').click()
    until(page, lambda: "Ann (analyst)" in page.locator(".account").inner_text())


def open_editor(page, url: str) -> None:
    look(page, url)
    page.locator(".editor-tool").click()
    page.wait_for_selector('[data-pane="second"][data-image]')
    ready(page)


def pane(page, name: str):
    return page.locator(f'[data-pane="{name}"]')


def click_pixel(page, name: str, pixel: Point, size: Point) -> None:
    """Click a pixel of an image that is shown whole."""
    box = pane(page, name).locator("canvas").bounding_box()
    scale = min(box["width"] / size[0], box["height"] / size[1])
    left = box["x"] + (box["width"] - size[0] * scale) / 2
    top = box["y"] + (box["height"] - size[1] * scale) / 2
    page.mouse.click(left + (pixel[0] + 0.5) * scale, top + (pixel[1] + 0.5) * scale)


def shared_pixel(url: str, mission: str, image: str, stop: str, size: Point) -> Point:
    """A pixel of an image whose ground is in sight of a left image of the other stop."""
    steps = (np.linspace(0.15, 0.85, 8)[None], np.linspace(0.45, 0.85, 6)[:, None])
    for x, y in zip(*(grid.ravel() for grid in np.broadcast_arrays(*steps)), strict=True):
        pixel = (round(x * size[0]), round(y * size[1]))
        query = {"image": image, "sample": pixel[0], "line": pixel[1], "stop": stop}
        answer = httpx.get(
            f"{url}/api/missions/{mission}/image-to-image", params=query, timeout=60.0
        )
        if answer.status_code != 200:
            continue
        seen = [one for one in answer.json()["images"] if one["eye"] == "left"]
        if seen and seen[0]["sight"] == "visible":
            return pixel
    pytest.fail("the stops share no ground")


def size_of(page, name: str) -> Point:
    """Samples and lines of the image in a pane."""
    image = pane(page, name).get_attribute("data-image")
    return tuple(
        page.evaluate(
            """async (url) => {
                const image = new Image(); image.src = url; await image.decode();
                return [image.naturalWidth, image.naturalHeight]; }""",
            f"/images/{image}/browse.png",
        )
    )


def plan_a_tie(page, url: str, mission: str) -> None:
    """Pick a shared feature on the left, its predicted place on the right, and take the tie."""
    size = size_of(page, "first")
    stop = pane(page, "second").locator("select").first.input_value()
    image = pane(page, "first").get_attribute("data-image")
    pixel = shared_pixel(url, mission, image, stop, size)
    click_pixel(page, "first", pixel, size)
    page.wait_for_selector('[data-pane="second"][data-predicted]')
    ready(page)
    resize(page, 1280, 760)  # 40 lower: the middle stays one
    box = pane(page, "second").locator("canvas").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    until(page, lambda: "sample" in page.locator('[data-pick="second"]').inner_text())


def test_a_pick_is_predicted_measured_previewed_saved_and_undone(page, own):
    workspace, url = own
    (mission,) = (entry.mission for entry in workspace.catalogue.missions())
    open_editor(page, url)
    plan_a_tie(page, url, mission)
    keep_screenshot(page, "editor-picked")
    predicted = [float(v) for v in pane(page, "second").get_attribute("data-predicted").split(",")]
    picked = [float(v) for v in pane(page, "second").get_attribute("data-pick").split(",")]
    assert np.hypot(*np.subtract(predicted, picked)) < 2.0  # the prediction is in the middle

    page.locator('[data-act="refine"]').click()
    until(page, lambda: "easured" in page.locator(".editor-status").inner_text())
    page.locator('[data-act="plan"]').click()
    page.locator('[data-act="trial"]').click()
    until(page, lambda: "would move by" in page.locator(".editor-status").inner_text())
    assert page.locator("[data-planned]").get_attribute("data-status") == "used"
    keep_screenshot(page, "editor-tried")
    for width in (390, 768, 1280, 1920):
        resize(page, width, 800)
        table, beside = (
            page.locator(f".editor-lists > :nth-child({k})").bounding_box() for k in (1, 2)
        )
        rows = [box.bounding_box() for box in page.locator(".editor-lists tr").all()]
        assert all(row["x"] + row["width"] <= table["x"] + table["width"] + 1 for row in rows)
        is_apart = table["x"] + table["width"] <= beside["x"]
        assert is_apart or table["y"] + table["height"] <= beside["y"], width
    resize(page, 1280, 760)

    assert page.locator('[data-act="save"]').is_disabled()
    page.keyboard.press("Escape")
    sign_in(page, workspace)
    page.locator(".editor-tool").click()
    page.wait_for_selector('[data-pane="second"][data-image]')
    ready(page)
    plan_a_tie(page, url, mission)
    page.locator('[data-act="plan"]').click()
    page.locator('[data-act="save"]').click()
    until(page, lambda: page.locator("[data-saved]").count() == 1)
    (edit,) = EditLog.of(workspace.store.root).effective(EditKind.TIE, mission)
    assert edit.document["action"] == "add"
    assert edit.document["first_image"] != edit.document["second_image"]
    page.get_by_role("button", name="take this tie back").click()
    until(page, lambda: page.locator("[data-saved]").count() == 0)
    assert EditLog.of(workspace.store.root).effective(EditKind.TIE, mission) == []


def test_picks_in_the_anaglyph_equal_picks_in_the_left_image(page, own):
    _, url = own
    open_editor(page, url)
    pane(page, "first").locator('input[type="checkbox"]').check()
    ready(page)
    until(page, lambda: is_coloured(screenshot(page, "editor-anaglyph"), page))
    size = size_of(page, "first")
    click_pixel(page, "first", (size[0] / 2, size[1] / 2), size)
    until(page, lambda: "sample" in page.locator('[data-pick="first"]').inner_text())
    sample = float(page.locator('[data-pick="first"]').inner_text().split()[1].rstrip(","))
    assert sample == pytest.approx(size[0] / 2, abs=1.0)


def is_coloured(png: np.ndarray, page) -> bool:
    box = pane(page, "first").locator("canvas").bounding_box()
    x, y = (round(box[a] + box[b] / 2) for a, b in (("x", "width"), ("y", "height")))
    patch = png[y - 60 : y + 60, x - 60 : x + 60].astype(int)
    return np.abs(patch[..., 0] - patch[..., 2]).mean() > 3.0


@pytest.mark.slow
def test_overlaid_orthophotos_give_picks_in_both(page, mapped):
    with Server(mapped.store) as server:
        open_editor(page, server.url)
        page.locator('[data-tool="overlay"]').click()
        page.wait_for_selector(".overlay-pane[data-placement]")
        ready(page)
        canvas = page.locator(".overlay-pane canvas")
        box = canvas.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 30, y - 12, steps=4)
        page.mouse.up()
        east, north, turn = map(
            float, page.locator(".overlay-pane").get_attribute("data-placement").split(",")
        )
        assert east > 0
        assert north == pytest.approx(0.4 * east, rel=0.02)
        assert turn == 0.0
        keep_screenshot(page, "editor-overlay")
        page.get_by_role("button", name="as mapped").click()
        page.mouse.click(x, y)
        until(page, lambda: "sample" in page.locator('[data-pick="second"]').inner_text())
        keep_screenshot(page, "editor-overlay-picked")


@pytest.mark.slow
def test_a_saved_tie_changes_the_next_adjustment_and_the_page_updates(page, mapped, tmp_path):
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - needs the engine's settings

    root = tmp_path / "store"
    shutil.copytree(mapped.store, root)
    workspace = Workspace.open(root)
    (mission,) = (entry.mission for entry in workspace.catalogue.missions())
    before = latest_network(workspace)
    with Server(root) as server:
        open_editor(page, server.url)
        page.keyboard.press("Escape")
        sign_in(page, workspace)
        page.locator(".editor-tool").click()
        page.wait_for_selector('[data-pane="second"][data-image]')
        ready(page)
        plan_a_tie(page, server.url, mission)
        page.locator('[data-act="plan"]').click()
        page.locator('[data-act="save"]').click()
        until(page, lambda: page.locator("[data-saved]").count() == 1)
        page.evaluate("window.stillTheSame = true")
        process_downlink(mapped.downlink, root)
        until(page, lambda: page.locator(".toast div").count() > 0)
        assert page.evaluate("window.stillTheSame")
    after = latest_network(workspace)
    assert len(after.manual_tie_notes) == len(before.manual_tie_notes) + 1
    moved = [
        np.linalg.norm(one.lsl_from_rover.translation_m - other.lsl_from_rover.translation_m)
        for one, other in zip(before.adjusted.stops, after.adjusted.stops, strict=True)
    ]
    assert max(moved) > 0.0


def latest_network(workspace: Workspace):
    (ref,) = workspace.catalogue.pointers(ProductKind.NETWORK)[-1:]
    return read_network(ref, workspace.store)
