"""The viewer in a real browser, on the real server, over a store whose every value is known.

The ground is a bowl: elevation z = d^2 / 100 at distance d metres from the landing point, so that
contours are circles and the elevation of every place is known in closed form.
"""

from __future__ import annotations

import math
import os
import shutil
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import uvicorn

from gis_server.app import create_app
from photogrammetry.terrain.grid import MapGrid
from photogrammetry.terrain.records import Dtm
from products.catalogue import ImageEntry, MissionEntry
from products.crs import LandingPoint, local_crs, lon_lat
from products.model import Layer, ProductKind, Recipe, Scope, ScopeLevel
from products.pictures import write_orthophoto
from products.raster import summarise, write_dtm, write_raster
from products.vector import Feature, write_features
from products.workspace import Workspace

playwright = pytest.importorskip("playwright.sync_api")

ROOT = Path(__file__).resolve().parents[2]
DIST = ROOT / "gis_server" / "viewer" / "dist"
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
GALE = LandingPoint("Bradbury Landing", 137.4417, -4.5895, 3_391_000.0, "a test")
CRS = local_crs(LANDING)
GRID = MapGrid.covering((-40.0, -40.0, 40.0, 40.0), 0.08)
REGION = Scope(ScopeLevel.REGION, "mer2")
STOPS = (
    ("mer2-site0010-drive0064", 10, 64, (-18.0, -12.0), (-18.0, -12.0)),
    ("mer2-site0010-drive0102", 10, 102, (2.0, -3.0), (3.0, -4.2)),
    ("mer2-site0011-drive0000", 11, 0, (16.0, 14.0), (18.5, 12.0)),
)
"""Scope, site, drive, (east, north) by adjustment and by telemetry, metres."""
UNPAIRED = "its right image was never sent"
CONTOUR_RADIUS_M = 20.0
WAIT_MS = 30_000


def elevation_at(east, north):
    return (east**2 + north**2) / 100.0


def surface() -> np.ndarray:
    east, north = GRID.centres()
    ground = elevation_at(east[None, :], north[:, None])
    ground[np.hypot(east[None, :], north[:, None]) > 38.0] = np.nan  # nothing was seen beyond
    return ground.astype(np.float32)


def slopes() -> np.ndarray:
    east, north = GRID.centres()
    steep = np.degrees(np.arctan(np.hypot(east[None, :], north[:, None]) / 50.0))
    return np.where(np.isfinite(surface()), steep, np.nan).astype(np.float32)


def dtm() -> Dtm:
    ground = surface()
    seen = np.isfinite(ground)
    sigma = np.where(seen, 0.02, np.nan).astype(np.float32)
    return Dtm(GRID, ground, sigma, np.where(seen, 3, 0).astype(np.float32), seen.astype(np.uint8))


def chequers() -> np.ndarray:
    """Squares of 4 m, dark and bright."""
    east, north = GRID.centres()
    odd = (np.floor(east / 4.0)[None, :] + np.floor(north / 4.0)[:, None]) % 2
    grey = np.where(odd, 170.0, 90.0)
    return np.where(np.isfinite(surface()), grey, np.nan).astype(np.float32)


def relief() -> np.ndarray:
    """Cosine of the sun's incidence, sun in the north-west 45 degrees high."""
    east, north = GRID.centres()
    east_slope, north_slope = east[None, :] / 50.0, north[:, None] / 50.0
    sun = np.array([-0.5, 0.5, math.sqrt(0.5)])
    shade = (-east_slope * sun[0] - north_slope * sun[1] + sun[2]) / np.sqrt(
        1.0 + east_slope**2 + north_slope**2
    )
    lit = np.clip(shade, 0.0, 1.0)
    return np.where(np.isfinite(surface()), lit, np.nan).astype(np.float32)


@dataclass(frozen=True)
class Shop:
    """Publishes into one store."""

    workspace: Workspace

    def raster(self, kind: ProductKind, write) -> None:
        ref = self.workspace.store.make(Recipe(kind, REGION), write)
        grid, bands = summarise(self.workspace.store.path(ref))
        facts = (grid.bounds, grid.cell_m, bands[0].unit or None, bands[0].range)
        self._publish(ref, "raster", *facts)

    def vectors(self, kind: ProductKind, features: list[Feature]) -> None:
        recipe = Recipe(kind, REGION)
        ref = self.workspace.store.make(
            recipe, lambda path: write_features(path, features, LANDING)
        )
        boxes = np.array([feature.bounds for feature in features])
        bounds = (*boxes[:, :2].min(axis=0).tolist(), *boxes[:, 2:].max(axis=0).tolist())
        self._publish(ref, "vector", bounds, None, None, None)

    def _publish(self, ref, type_, bounds, cell_m, unit, values) -> None:
        made_at = self.workspace.store.made_at(ref)
        layer = Layer(
            ref, "MER2", str(ref.kind), type_, bounds, cell_m, unit, values, (155, 156), made_at
        )
        self.workspace.catalogue.publish(layers=[layer])

    def image(self, stop: int, eye: str, look: int) -> ImageEntry:
        scope_name, site, drive, *_ = STOPS[stop]
        store = self.workspace.store
        name = f"2n{1400 + stop}0000{look}effa000p1600{eye[0]}0m1"
        scope = Scope(ScopeLevel.IMAGE, name)
        grey = np.tile(np.linspace(40 + 30 * look, 220, 256, dtype=np.uint8), (256, 1))
        body = cv2.imencode(".png", grey)[1].tobytes()
        original = store.make(Recipe(ProductKind.IMAGE, scope), lambda path: _keep(path, b"label"))
        browse = store.make(Recipe(ProductKind.BROWSE, scope), lambda path: _keep(path, body))
        paired = look != 2
        other = f"2n{1400 + stop}0000{look}effa000p1600{'r' if eye == 'left' else 'l'}0m1"
        return ImageEntry(
            id=name.upper(),
            mission="MER2",
            stop=scope_name,
            site=site,
            drive=drive,
            sol=155 + stop // 2,
            instrument="NAVCAM",
            eye=eye,
            product_type="EDR",
            start_time="2004-06-11T10:00:00Z",
            local_solar_time="12:10:05",
            partner=other.upper() if paired else None,
            unpaired_because=None if paired else UNPAIRED,
            ref=original,
            browse=browse,
        )


def _keep(path: Path, body: bytes) -> None:
    path.write_bytes(body)


def azimuth_of(look: int) -> float:
    return math.radians(30.0 + 120.0 * look)


def viewing(entry: ImageEntry, look: int, at: tuple[float, float]) -> tuple[Feature, Feature]:
    """Footprint and pointing line: a wedge of 40 degrees from 2 to 12 m."""
    east, north = at
    turn = np.radians([-20.0, 0.0, 20.0]) + azimuth_of(look)
    near = np.column_stack([east + 2 * np.sin(turn), north + 2 * np.cos(turn)])
    far = np.column_stack([east + 12 * np.sin(turn), north + 12 * np.cos(turn)])[::-1]
    facts = {
        "image": entry.id,
        "instrument": entry.instrument,
        "eye": entry.eye,
        "sol": entry.sol,
        "stop": entry.stop,
        "partner": entry.partner,
        "unpaired_because": entry.unpaired_because,
    }
    line = np.array([[east, north], far[1]])
    ring = np.vstack([near, far])
    return Feature("Polygon", ring, facts, entry.id), Feature("LineString", line, facts, entry.id)


def stop_features() -> Iterator[Feature]:
    for index, (name, site, drive, adjusted, telemetry) in enumerate(STOPS):
        moved = math.dist(adjusted, telemetry)
        known = {"stop": name, "site": site, "drive": drive, "sols": [155], "moved_m": moved}
        sure = {
            "held": index == 0,
            "sigma_north_m": 0.03 * index,
            "sigma_east_m": 0.05 * index,
            "ellipse_semi_major_m": 0.06 * index,
            "ellipse_semi_minor_m": 0.02 * index,
            "ellipse_azimuth_deg": 60.0,
        }
        yield Feature("Point", np.array([telemetry]), {**known, "solution": "telemetry"})
        yield Feature("Point", np.array([adjusted]), {**known, **sure, "solution": "adjusted"})


def contours() -> Iterator[Feature]:
    turn = np.linspace(0.0, 2 * math.pi, 181)
    for step in range(1, 13):
        radius = math.sqrt(100.0 * step)
        ring = np.column_stack([radius * np.sin(turn), radius * np.cos(turn)])
        yield Feature("LineString", ring, {"elevation_m": float(step), "is_index": step % 4 == 0})


def fill(workspace: Workspace) -> None:
    shop = Shop(workspace)
    entries, outlines, lines = [], [], []
    for stop, (_, _, _, adjusted, _) in enumerate(STOPS):
        for look in range(3):
            for eye in ("left", "right")[: 1 if look == 2 else 2]:
                entry = shop.image(stop, eye, look)
                outline, line = viewing(entry, look, adjusted)
                entries.append(entry)
                outlines.append(outline)
                lines.append(line)
    mission = MissionEntry("MER2", "Spirit, Gusev crater", LANDING, "LSL starts at the lander.")
    other = MissionEntry("MSL", "Curiosity, Gale crater", GALE, None)
    workspace.catalogue.publish(missions=[mission, other], images=entries)
    shop.raster(ProductKind.DTM, lambda path: write_dtm(path, dtm(), CRS))
    shop.raster(
        ProductKind.ORTHOPHOTO,
        lambda path: write_orthophoto(path, GRID, chequers(), CRS, stretch=(0.0, 254.0)),
    )
    for kind, band, unit in (
        (ProductKind.SLOPE, slopes(), "degree"),
        (ProductKind.HILLSHADE, relief(), ""),
    ):
        shop.raster(
            kind,
            lambda path, kind=kind, band=band, unit=unit: write_raster(
                path, GRID, {str(kind): band}, CRS, unit=unit
            ),
        )
    shop.vectors(ProductKind.CONTOURS, list(contours()))
    shop.vectors(ProductKind.STOPS, list(stop_features()))
    shop.vectors(ProductKind.FOOTPRINTS, outlines)
    shop.vectors(ProductKind.POINTING, lines)
    ways = {"adjusted": [s[3] for s in STOPS], "telemetry": [s[4] for s in STOPS]}
    shop.vectors(
        ProductKind.TRAVERSE,
        [Feature("LineString", np.array(way), {"solution": name}) for name, way in ways.items()],
    )


class Server:
    """The real server on a free port, in a thread."""

    def __init__(self, store: Path) -> None:
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.socket.getsockname()[1]}"
        self.uvicorn = uvicorn.Server(
            uvicorn.Config(create_app(store, DIST), log_level="warning", access_log=False)
        )
        self.thread = threading.Thread(
            target=self.uvicorn.run, kwargs={"sockets": [self.socket]}, daemon=True
        )

    def __enter__(self) -> Server:
        self.thread.start()
        deadline = time.monotonic() + 20.0
        while not self.uvicorn.started and time.monotonic() < deadline:
            time.sleep(0.02)
        return self

    def __exit__(self, *_: object) -> None:
        self.uvicorn.should_exit = True
        self.thread.join(10.0)
        self.socket.close()


@pytest.fixture(scope="module")
def browser():
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        pytest.skip(f"no browser on this machine: none of {', '.join(NAMES)} is installed")
    if not (DIST / "index.html").is_file():
        pytest.skip("the viewer is not built: run `make viewer`")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def url(tmp_path_factory) -> Iterator[str]:
    root = tmp_path_factory.mktemp("viewer") / "store"
    fill(Workspace.open(root))
    with Server(root) as server:
        yield server.url


@pytest.fixture
def page(browser):
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    opened = context.new_page()
    opened.faults = []
    opened.on("pageerror", lambda error: opened.faults.append(str(error)))
    opened.elsewhere = []
    opened.on(
        "request",
        lambda request: (
            None
            if request.url.startswith(("http://127.0.0.1", "data:", "blob:"))
            else opened.elsewhere.append(request.url)
        ),
    )
    yield opened
    assert opened.faults == []
    assert opened.elsewhere == []
    context.close()


def look(page, address: str) -> None:
    page.goto(address)
    ready(page)


def ready(page) -> None:
    page.wait_for_selector('html[data-ready="true"]', state="attached", timeout=WAIT_MS)


def until(page, holds) -> None:
    """Wait until `holds()`; the page's security policy forbids to wait inside the page."""
    deadline = time.monotonic() + WAIT_MS / 1000
    while not holds():
        assert time.monotonic() < deadline, "the page did not get there"
        page.wait_for_timeout(50)


def turn_of_arrow(page) -> str:
    return page.locator(".arrow").evaluate("element => element.style.transform")


def at(resolution: float, on: str = "", east: float = 0.0, north: float = 0.0) -> str:
    return f"/#m=MER2&at={east},{north},{resolution}&on={on}"


def resolution_of(page) -> float:
    return float(page.url.split("at=")[1].split("&")[0].split(",")[2])


def pixel_of(page, east: float, north: float, resolution: float) -> tuple[float, float]:
    """Where on the page a place is, the map being centred on the landing point."""
    box = page.locator("div.map").bounding_box()
    x = box["x"] + box["width"] / 2 + east / resolution
    return x, box["y"] + box["height"] / 2 - north / resolution


def screenshot(page, name: str) -> np.ndarray:
    """Red, green, blue of the page; kept where SOLMAP_SCREENSHOTS says."""
    body = page.screenshot()
    if folder := os.environ.get("SOLMAP_SCREENSHOTS"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        (Path(folder) / f"{name}.png").write_bytes(body)
    return cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def colour_at(picture: np.ndarray, place: tuple[float, float]) -> np.ndarray:
    x, y = (round(value) for value in place)
    return picture[y, x].astype(int)


def field(page, key: str) -> str:
    return page.locator(f'[data-field="{key}"] b').inner_text().replace("\u2212", "-")


def test_relief_image_contours_stops_and_traverse_are_shown_at_first(page, url):
    look(page, url)
    screenshot(page, "first")
    shown = {
        box.get_attribute("data-kind") for box in page.locator("li.layer:has(input:checked)").all()
    }
    assert shown == {"hillshade", "orthophoto", "contours", "stops", "traverse"}
    assert page.locator("h1").inner_text() == "solmap"
    assert "Columbia Memorial Station" in page.locator(".mission").inner_text()


def test_squares_of_the_orthophoto_lie_where_they_are_on_the_ground(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/orthophoto"))
    picture = screenshot(page, "orthophoto")
    for east, north, grey in ((2.0, 2.0, 90), (6.0, 2.0, 170), (-2.0, 2.0, 170), (-6.0, -6.0, 90)):
        shown = colour_at(picture, pixel_of(page, east, north, resolution))
        assert np.abs(shown - (grey + 1)).max() <= 3  # half a grey step in store, tile and screen
    # The edge between squares at 4 m east: half a cell of 8 cm is less than a pixel here.
    y = pixel_of(page, 0.0, 2.0, resolution)[1]
    row = picture[round(y), :, 0].astype(int)
    start = round(pixel_of(page, 2.0, 0.0, resolution)[0])
    edge = start + int(np.argmax(row[start : start + 40] > 130))
    assert abs(edge - pixel_of(page, 4.0, 0.0, resolution)[0]) <= 1.5


def test_a_contour_falls_on_the_elevation_it_names(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/contours"))
    picture = screenshot(page, "contours").astype(int)
    # Between the labels, to the north-east of the bowl's middle.
    radius = CONTOUR_RADIUS_M
    turns = np.radians(np.arange(0, 360, 3.0))
    on_line = 0
    for turn in turns:
        x, y = pixel_of(page, radius * math.sin(turn), radius * math.cos(turn), resolution)
        patch = picture[round(y) - 1 : round(y) + 2, round(x) - 1 : round(x) + 2]
        brown = (patch[..., 0] - patch[..., 2]) > 40
        on_line += bool(brown.any())
    assert on_line >= 0.8 * len(turns)  # its label interrupts it


def test_the_scale_bar_is_as_long_as_the_ground_it_stands_for(page, url):
    for resolution in (0.02, 0.1, 0.37):
        look(page, url + at(resolution))
        page.reload()
        ready(page)
        bar = page.locator(".scale i")
        metres = float(bar.get_attribute("data-metres"))
        width = bar.bounding_box()["width"]
        assert width * resolution == pytest.approx(metres, rel=0.01)  # a pixel of a hundred
        assert 60 < width <= 161


def test_the_wheel_zooms_about_the_pointer_before_any_click(page, url):
    look(page, url + at(0.1))
    page.mouse.move(*pixel_of(page, 8.0, 4.0, 0.1))
    page.mouse.wheel(0, 240)
    until(page, lambda: resolution_of(page) > 0.11)
    ready(page)
    assert float(field(page, "east").split()[0]) == pytest.approx(8.0, abs=0.2)
    assert float(field(page, "north").split()[0]) == pytest.approx(4.0, abs=0.2)


def test_the_pointer_reads_metres_degrees_and_the_measured_elevation(page, url):
    resolution = 0.05
    look(page, url + at(resolution, "mer2/slope"))
    east, north = 9.0, -6.0
    page.mouse.move(*pixel_of(page, east, north, resolution))
    until(page, lambda: "m" in field(page, "elevation"))
    assert float(field(page, "east").split()[0]) == pytest.approx(east, abs=resolution)
    assert float(field(page, "north").split()[0]) == pytest.approx(north, abs=resolution)
    lon, lat = (float(value[0]) for value in lon_lat(LANDING, east, north))
    degrees_a_pixel = math.degrees(resolution / LANDING.radius_m)
    assert float(field(page, "lon").split("°")[0]) == pytest.approx(lon, abs=2 * degrees_a_pixel)
    assert float(field(page, "lat").split("°")[0]) == pytest.approx(lat, abs=2 * degrees_a_pixel)
    elevation = float(field(page, "elevation").split()[0])
    cell_and_pixel = (GRID.cell_m + resolution) * math.hypot(east, north) / 50.0
    assert elevation == pytest.approx(elevation_at(east, north), abs=cell_and_pixel)
    steep = math.degrees(math.atan(math.hypot(east, north) / 50.0))
    assert float(field(page, "value").split("°")[0]) == pytest.approx(steep, abs=0.2)


def test_a_click_tells_every_layer_and_the_images_that_see_the_place(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/orthophoto"))
    name, _, _, (east, north), _ = STOPS[1]
    there = (east + 7 * math.sin(azimuth_of(0)), north + 7 * math.cos(azimuth_of(0)))
    page.mouse.click(*pixel_of(page, *there, resolution))
    page.wait_for_selector(".point table")
    ready(page)
    screenshot(page, "identify")
    kinds = {row.get_attribute("data-layer") for row in page.locator(".point tr[data-layer]").all()}
    assert kinds == {f"mer2/{kind}" for kind in ("dtm", "orthophoto", "slope", "hillshade")}
    seen = page.locator(".image-ids button").all_inner_texts()
    assert sorted(seen) == ["2N14010000" + f"0EFFA000P1600{eye}0M1" for eye in "LR"]
    assert name


def test_a_click_on_a_pointing_line_opens_its_image(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/pointing"))
    _, _, _, (east, north), _ = STOPS[2]
    there = (east + 8 * math.sin(azimuth_of(2)), north + 8 * math.cos(azimuth_of(2)))
    page.mouse.move(*pixel_of(page, *there, resolution))
    page.wait_for_selector(".tip:not([hidden])")
    assert UNPAIRED in page.locator(".tip").inner_text()
    page.mouse.click(*pixel_of(page, *there, resolution))
    page.wait_for_selector("section.image")
    ready(page)
    screenshot(page, "image")
    section = page.locator("section.image")
    assert section.get_attribute("data-image") == "2N140200002EFFA000P1600L0M1"
    assert UNPAIRED in section.inner_text()
    browse = section.locator(".browse img")
    until(page, lambda: browse.evaluate("image => image.naturalWidth") == 256)
    original = page.request.get(url + section.locator("a.download").get_attribute("href"))
    assert original.body() == b"label"


def test_the_partner_of_an_image_is_one_click_away(page, url):
    look(page, url)
    page.locator('[data-tab="images"]').click()
    assert page.locator(".count").inner_text() == "15 images, 3 without partner"
    page.locator(".images button").first.click()
    first = page.locator("section.image").get_attribute("data-image")
    page.locator("section.image .facts .link").click()
    second = page.locator("section.image").get_attribute("data-image")
    assert {first[-4], second[-4]} == {"L", "R"}
    assert first[:-4] == second[:-4]


def test_the_sol_slider_keeps_the_images_of_one_sol(page, url):
    look(page, url + at(0.1, "mer2/footprints"))
    page.locator('[data-tab="images"]').click()
    page.locator("input.sol").press("ArrowRight")
    assert page.locator(".count").inner_text() == "10 images, 2 without partner"
    assert "sol=155" in page.url
    page.locator("input.sol").press("ArrowRight")
    assert page.locator(".count").inner_text() == "5 images, 1 without partner"
    screenshot(page, "sol")


def test_a_measured_distance_is_the_distance_on_the_ground(page, url):
    resolution = 0.1
    look(page, url + at(resolution, "mer2/orthophoto"))
    page.locator(".measure").click()
    page.mouse.click(*pixel_of(page, 0.0, 0.0, resolution))
    page.wait_for_timeout(400)  # two quick clicks would end the line
    page.mouse.move(*pixel_of(page, 15.0, 10.0, resolution))
    page.mouse.dblclick(*pixel_of(page, 15.0, 20.0, resolution))
    screenshot(page, "measure")
    text = page.locator(".ruler").inner_text()
    assert float(text.split(" m")[0]) == pytest.approx(25.0, abs=2 * resolution)
    azimuth = float(text.split("azimuth ")[1].split("°")[0])
    assert azimuth == pytest.approx(math.degrees(math.atan2(15, 20)), abs=0.5)
    page.keyboard.press("Escape")
    assert page.locator(".ruler").is_hidden()


def test_a_link_brings_back_view_and_layers(page, url):
    look(page, url + at(0.25, "mer2/slope*0.35,mer2/stops", 5.0, -7.5))
    boxes = page.locator("li.layer:has(input:checked)").all()
    assert {box.get_attribute("data-layer") for box in boxes} == {"mer2/slope", "mer2/stops"}
    page.locator('li[data-layer="mer2/dtm"] input').check()
    ready(page)
    assert "at=5,-7.5,0.25" in page.url
    assert set(page.url.split("on=")[1].split("&")[0].split(",")) == {
        "mer2/slope*0.35",
        "mer2/stops",
        "mer2/dtm*0.6",
    }


def test_a_layer_shows_its_legend_and_hands_out_its_file_and_history(page, url):
    look(page, url)
    row = page.locator('li[data-layer="mer2/slope"]')
    row.locator("input").first.check()
    row.locator(".more").click()
    ready(page)
    screenshot(page, "slope")
    assert row.locator(".ticks span").all_inner_texts() == ["0", "10", "20", "30", "40"]
    file = page.request.get(url + row.locator("a.download").get_attribute("href"))
    assert file.body()[:2] in (b"II", b"MM")
    row.locator("button.provenance").click()
    page.wait_for_selector("dialog[open]")
    assert '"kind": "slope"' in page.locator("dialog pre").inner_text()


def test_the_table_of_stops_says_how_far_telemetry_was_off(page, url):
    look(page, url)
    page.locator('[data-tab="stops"]').click()
    screenshot(page, "stops")
    rows = page.locator("[data-stop]").all()
    assert [row.locator("td").first.inner_text() for row in rows] == ["10/64", "10/102", "11/0"]
    moved = [float(row.locator("td").last.inner_text()) for row in rows]
    expected = [math.dist(adjusted, telemetry) for *_, adjusted, telemetry in STOPS]
    assert moved == pytest.approx(expected, abs=5e-4)


def test_another_mission_is_one_choice_away(page, url):
    look(page, url)
    page.get_by_label("mission", exact=True).select_option("MSL")
    until(page, lambda: "Bradbury Landing" in page.locator(".mission").inner_text())
    ready(page)
    assert page.url.split("#")[1].startswith("m=MSL&at=")
    assert "No layer is published yet" in page.locator("aside.left").inner_text()
    x, y = pixel_of(page, 0.0, 0.0, 1.0)
    page.mouse.move(x, y)
    until(page, lambda: field(page, "elevation") == "not measured")
    assert float(field(page, "lon").split("°")[0]) == pytest.approx(GALE.longitude, abs=1e-5)


def test_north_stays_north_when_the_map_is_turned(page, url):
    look(page, f"{url}/#m=MER2&at=0,0,0.1,90&on=mer2/orthophoto")
    assert turn_of_arrow(page) == "rotate(90deg)"
    page.locator(".north button").click()
    until(page, lambda: turn_of_arrow(page) == "rotate(0deg)")


def test_the_dark_page_is_dark(page, url):
    page.emulate_media(color_scheme="dark")
    look(page, url)
    picture = screenshot(page, "dark")
    assert picture[788, 1200].mean() < 60
    page.get_by_role("button", name="light or dark").click()
    assert screenshot(page, "light")[788, 1200].mean() > 200


def test_a_server_that_went_away_is_said_so(browser, tmp_path):
    fill_nothing = Workspace.open(tmp_path / "store")
    mission = MissionEntry("MER2", "Spirit", LANDING, None)
    fill_nothing.catalogue.publish(missions=[mission])
    with Server(tmp_path / "store") as server:
        page = browser.new_page()
        look(page, server.url)
        assert "No layer is published yet" in page.locator("aside.left").inner_text()
    page.mouse.click(600, 400)
    page.wait_for_selector(".banner:not([hidden])", timeout=WAIT_MS)
    assert "does not answer" in page.locator(".banner").inner_text()
    page.close()


@pytest.mark.parametrize("resolution", [0.05])
def test_adjusted_and_telemetry_have_the_colours_of_the_paper(page, url, resolution):
    look(page, url + at(resolution, "mer2/traverse"))
    picture = screenshot(page, "traverse").astype(int)
    (_, _, _, from_east_north, _), (_, _, _, to_east_north, _) = STOPS[0], STOPS[1]
    middle = tuple((a + b) / 2 for a, b in zip(from_east_north, to_east_north, strict=True))
    red, green, blue = colour_at(picture, pixel_of(page, *middle, resolution))
    assert red > 200
    assert max(green, blue) < 90
