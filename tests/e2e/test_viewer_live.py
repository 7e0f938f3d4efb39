"""What is published while the map is open appears by itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.raster.raster import summarise, write_raster
from solmap.products.model import Layer, ProductKind, Recipe
from tests.support.bowl_store import CRS, GRID, REGION, fill
from tests.support.browsing import (
    at,
    colour_now,
    look,
    pixel_of,
    ready,
    until,
)


@dataclass(frozen=True, slots=True)
class Value:
    """What distinguishes one product from the next."""

    value: float


def publish(workspace: Workspace, kind: ProductKind, value: float) -> None:
    """A raster that is `value` everywhere."""
    band = np.full(GRID.shape, value, np.float32)
    store = workspace.store
    recipe = Recipe(kind, REGION, params=Value(value))
    ref = store.make(
        recipe, lambda path: write_raster(path, GRID, {str(kind): band}, CRS, unit="degree")
    )
    grid, _ = summarise(store.path(ref))
    layer = Layer(
        ref,
        "MER2",
        str(kind),
        "raster",
        grid.bounds,
        grid.cell_m,
        "degree",
        (0.0, 30.0),
        (155,),
        store.made_at(ref),
    )
    workspace.catalogue.publish(layers=[layer])


def test_a_new_layer_is_listed_without_a_reload(page, workspace, live):
    look(page, live)
    assert page.locator('li.layer[data-kind="roughness"]').count() == 0
    page.evaluate("window.stillTheSame = true")
    publish(workspace, ProductKind.ROUGHNESS, 3.0)
    until(page, lambda: page.locator('li.layer[data-kind="roughness"]').count() == 1)
    assert "1 layer of mer2 published" in page.locator(".toast").inner_text()
    assert page.evaluate("window.stillTheSame")


def test_a_lost_connection_is_reported_until_it_returns(page, live):
    page.route("**/api/events*", lambda route: route.abort())
    look(page, live)
    lost = page.locator(".connection")
    until(page, lost.is_visible)
    page.unroute("**/api/events*")
    until(page, lost.is_hidden)


def test_a_new_version_of_a_layer_is_redrawn_with_its_settings(page, workspace, live):
    resolution = 0.1
    look(page, live + at(resolution, "mer2/slope"))
    place = pixel_of(page, 12.0, 12.0, resolution)
    before = colour_now(page, place)
    publish(workspace, ProductKind.SLOPE, 29.0)
    until(page, lambda: page.locator(".toast div").count() > 0)
    ready(page)
    until(
        page,
        lambda: np.abs(colour_now(page, place) - before).max() > 40,
    )
    assert page.locator('li.layer[data-kind="slope"] input[type="checkbox"]').is_checked()
    assert "on=mer2%2Fslope" in page.url or "on=mer2/slope" in page.url


def test_layers_published_before_the_page_listens_are_listed(page, workspace, live):
    held = []
    page.route("**/api/events*", lambda route: held.append(route))  # noqa: PLW0108 - needs no self
    look(page, live)
    until(page, lambda: held)
    publish(workspace, ProductKind.ROUGHNESS, 3.0)
    held.pop().continue_()
    until(page, lambda: page.locator('li.layer[data-kind="roughness"]').count() == 1)


def test_missed_events_are_delivered_after_a_reconnection(page, workspace, live):
    look(page, live)
    page.context.set_offline(offline=True)
    publish(workspace, ProductKind.ROUGHNESS, 3.0)
    page.wait_for_timeout(500)
    assert page.locator('li.layer[data-kind="roughness"]').count() == 0
    page.context.set_offline(offline=False)
    until(page, lambda: page.locator('li.layer[data-kind="roughness"]').count() == 1)


def test_a_failed_request_for_the_list_is_repeated(page, workspace, live):
    look(page, live)
    page.route("**/layers", lambda route: route.abort("internetdisconnected"))
    publish(workspace, ProductKind.ROUGHNESS, 3.0)
    until(page, lambda: "does not answer" in page.locator(".banner").inner_text())
    page.unroute("**/layers")
    until(page, lambda: page.locator('li.layer[data-kind="roughness"]').count() == 1)
    until(page, lambda: not page.locator(".banner").is_visible())


def test_the_first_layers_of_an_empty_store_open_the_map(page, tmp_path, serve):
    empty = Workspace.open(tmp_path / "store")
    with serve(empty.store.root) as server:
        page.goto("about:blank")
        page.goto(server.url)
        until(page, lambda: "Nothing is published yet" in page.locator(".banner").inner_text())
        fill(empty)
        ready(page)
        assert not page.locator(".banner").is_visible()
        assert page.locator("li.layer").count() > 5
