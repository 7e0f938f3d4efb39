"""Image layers in other shades and colours, and class layers without some classes."""

from __future__ import annotations

import numpy as np
import pytest

from solmap.photogrammetry.terrain.traversability.hazard import Hazard
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.raster.raster import HAZARD_CLASSES, write_classes
from solmap.products.model import ProductKind
from tests.support.bowl_store import CRS, GRID, Shop, fill
from tests.support.browsing import (
    Server,
    at,
    colour_now,
    keep_screenshot,
    look,
    pixel_of,
    ready,
    until,
)

RESOLUTION = 0.1
DARK, BRIGHT = (2.0, 2.0), (6.0, 2.0)
"""Squares of the chequered ground whose shades are 90 and 170."""
WEST, EAST = (-10.0, 5.0), (10.0, 5.0)
"""Ground that a rover can go on, and ground that is too steep."""


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    root = tmp_path_factory.mktemp("pictures") / "store"
    root.mkdir(parents=True)
    workspace = Workspace.open(root)
    fill(workspace)
    east, north = GRID.centres()
    steep = np.broadcast_to(east[None, :] > 0, (len(north), len(east)))
    codes = np.where(steep, Hazard.STEEP, Hazard.TRAVERSABLE).astype(np.uint8)
    Shop(workspace).raster(
        ProductKind.HAZARD,
        lambda path: write_classes(path, GRID, codes, CRS, name="hazard", classes=HAZARD_CLASSES),
    )
    with Server(root) as server:
        yield server.url


def opened(page, url: str, kind: str):
    look(page, url + at(RESOLUTION, f"mer2/{kind}"))
    row = page.locator(f'li.layer[data-layer="mer2/{kind}"]')
    row.locator(".more").click()
    return row


def shade(page, place) -> float:
    ready(page)
    return float(colour_now(page, pixel_of(page, *place, RESOLUTION)).mean())


def test_an_image_layer_is_stretched_and_recoloured_and_the_link_restores_it(page, images):
    row = opened(page, images, "orthophoto")
    ends = sorted(shade(page, place) for place in (DARK, BRIGHT))
    assert ends == pytest.approx([90, 170], abs=4)
    row.locator(".stretch-percent").click()
    until(page, lambda: spread(page) > 230)
    keep_screenshot(page, "pictures-stretched")
    row.get_by_label("white at").fill("250")
    row.get_by_label("white at").press("Enter")
    row.get_by_label("gamma").fill("2")
    expected = 255 * ((170 - 90) / (250 - 90)) ** 0.5
    until(page, lambda: max(both(page)) == pytest.approx(expected, abs=5))
    row.get_by_label("colours").select_option("viridis")
    until(page, lambda: is_coloured(page))
    keep_screenshot(page, "pictures-coloured")
    address = page.url
    assert "::90:250::2" in address or "viridis:" in address
    look(page, address)
    until(page, lambda: is_coloured(page))


def both(page) -> tuple[float, float]:
    return shade(page, DARK), shade(page, BRIGHT)


def spread(page) -> float:
    one, other = both(page)
    return abs(one - other)


def is_coloured(page) -> bool:
    ready(page)
    return bool(np.ptp(colour_now(page, pixel_of(page, *DARK, RESOLUTION))) > 60)


def test_a_hidden_class_is_not_drawn_and_the_legend_marks_it(page, images):
    row = opened(page, images, "hazard")
    row.locator(".opacity input").first.fill("1")
    before = [seen(page, place) for place in (WEST, EAST)]
    colours = {one.name: rgb(one.colour) for one in HAZARD_CLASSES}
    assert before[0] == pytest.approx(colours["traversable"], abs=6)
    assert before[1] == pytest.approx(colours["too steep"], abs=6)
    row.get_by_label("too steep").uncheck()
    ground = (0xCF, 0xCB, 0xC4)
    until(page, lambda: seen(page, EAST) == pytest.approx(ground, abs=6))
    assert seen(page, WEST) == pytest.approx(before[0], abs=2)
    keep_screenshot(page, "classes-hidden")
    address = page.url
    look(page, address)
    until(page, lambda: seen(page, EAST) == pytest.approx(ground, abs=6))


def seen(page, place) -> list[int]:
    ready(page)
    return list(colour_now(page, pixel_of(page, *place, RESOLUTION)))


def rgb(colour: str) -> list[int]:
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
