"""Stereo pairs in a real browser: bars that are 8 pixels apart in the two images."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from solmap.products.catalogue.workspace import Workspace
from tests.support.browsing import Server, look, screenshot
from tests.support.scene_store import fill_scene

PARALLAX_PX = 8


@pytest.fixture(scope="module")
def pair_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    root: Path = tmp_path_factory.mktemp("stereo") / "store"
    fill_scene(Workspace.open(root))
    with Server(root) as server:
        yield server.url


@pytest.fixture
def stereo(page, pair_url):
    look(page, pair_url)
    page.get_by_role("button", name="stereo pair (2)").click()
    page.wait_for_selector('.stereo[data-settled="true"]', timeout=30_000)
    return page


def part(page, name: str) -> np.ndarray:
    """Red, green, blue of the middle of the canvas."""
    page.wait_for_timeout(100)
    box = page.locator(".stereo-view canvas").bounding_box()
    x, y = round(box["x"]), round(box["y"] + 0.4 * box["height"])
    size = {"width": round(box["width"]), "height": round(0.2 * box["height"])}
    return screenshot(page, f"stereo-{name}", {"x": x, "y": y, **size}).astype(int)


def put(page, nudge: int) -> None:
    page.locator('.stereo input[name="nudge"]').fill(str(nudge))


def coloured(image: np.ndarray) -> float:
    """Share of pixels that only one eye sees so."""
    return float((np.abs(image[..., 0] - image[..., 1]) > 40).mean())


def test_points_with_the_screen_parallax_coincide_in_the_anaglyph(stereo):
    assert int(stereo.locator('.stereo input[name="nudge"]').input_value()) == PARALLAX_PX
    inside = np.s_[:, 40:-40]  # beside it one eye sees the image's edge
    fused = part(stereo, "fused")[inside]
    put(stereo, 0)
    apart = part(stereo, "apart")[inside]
    assert coloured(fused) < 0.03
    # Every 17.5 pixels a bar ends, and 8 of these differ.
    assert coloured(apart) == pytest.approx(8 / 17.5, abs=0.08)


def test_arrow_keys_shift_one_image_against_the_other(stereo):
    canvas = stereo.locator(".stereo-view canvas")
    canvas.press("ArrowLeft")
    canvas.press("Shift+ArrowRight")
    value = int(stereo.locator('.stereo input[name="nudge"]').input_value())
    assert value == PARALLAX_PX - 1 + 10
    assert stereo.locator(".stereo-controls output.number").inner_text() == f"{value} px"


def test_side_by_side_each_image_has_its_half(stereo):
    stereo.locator('.stereo select[name="way"]').select_option("parallel")
    image = part(stereo, "parallel").mean(axis=2)
    half = image.shape[1] // 2
    inside = np.s_[:, 24 : half - 24]
    left, right = image[:, :half][inside], image[:, half : 2 * half][inside]
    assert np.corrcoef(left.ravel(), right.ravel())[0, 1] > 0.9  # bars meet at this parallax
    put(stereo, 0)
    image = part(stereo, "parallel-0").mean(axis=2)
    left, right = image[:, :half][inside], image[:, half : 2 * half][inside]
    assert np.corrcoef(left.ravel(), right.ravel())[0, 1] < 0.5


def test_alternating_images_move_only_points_off_the_screen_plane(stereo):
    stereo.locator('.stereo select[name="way"]').select_option("wiggle")
    put(stereo, 0)
    first = part(stereo, "wiggle-0")
    for k in range(1, 40):  # at uneven times, so that none falls in with the turns
        stereo.wait_for_timeout(37 * k % 211)
        if np.abs(part(stereo, f"wiggle-{k}") - first).mean() > 20:
            break
    else:
        pytest.fail("the images never alternated")
    put(stereo, PARALLAX_PX)
    inside = np.s_[:, 40:-40]
    seen = [part(stereo, f"still-{k}")[inside] for k in range(6)]
    assert max(np.abs(a - seen[0]).mean() for a in seen) < 3


def test_the_wheel_zooms_the_stereo_view(stereo):
    def bars(image: np.ndarray) -> int:
        bright = image.mean(axis=(0, 2)) > 128
        return int(np.abs(np.diff(bright.astype(int))).sum())

    before = bars(part(stereo, "far"))
    box = stereo.locator(".stereo-view canvas").bounding_box()
    stereo.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    stereo.mouse.wheel(0, -280)
    assert bars(part(stereo, "near")) == pytest.approx(before / 2, abs=2)


def test_the_stereo_view_shows_the_pair_of_the_open_image(page, pair_url):
    look(page, pair_url)
    page.locator('[data-tab="images"]').click()
    page.locator(".images button").nth(1).click()
    page.get_by_role("button", name="stereo pair (2)").click()
    page.wait_for_selector('.stereo[data-settled="true"]', timeout=30_000)
    label = page.locator(".stereo-view canvas").get_attribute("aria-label")
    assert label == "stereo pair 2N140200000EDN1100P1600L0M1 and 2N140200000EDN1100P1600R0M1"
    assert "was not matched" in page.locator(".stereo-controls > output").inner_text()
