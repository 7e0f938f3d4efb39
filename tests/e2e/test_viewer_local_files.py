"""Dropped files: read in the browser, where they lie, refused with a reason, and published."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from zipfile import ZipFile

import geopandas
import numpy as np
import pytest
import rasterio
from rasterio.transform import from_bounds
from rasterio.warp import Resampling, calculate_default_transform, reproject
from shapely.geometry import LineString, Point, Polygon

from solmap.products.catalogue.tokens import Role, Tokens
from tests.support.bowl_store import CRS
from tests.support.browsing import (
    at,
    colour_at,
    colour_now,
    keep_screenshot,
    look,
    open_page,
    pixel_of,
    screenshot,
    until,
)

RESOLUTION = 0.1
MARS = "+proj=longlat +R=3393000 +no_defs"
EQUIRECTANGULAR = "+proj=eqc +lat_ts=0 +lon_0=180 +R=3396190 +units=m +no_defs"
CORNERS = ((5, 5), (15, 5), (15, 12), (5, 12))
KEEP_OUT = Polygon(CORNERS)
DROP = """([name, text]) => {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([bytes], name));
  for (const kind of ["dragover", "drop"])
    document.querySelector(".map").dispatchEvent(
      new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true }));
}"""


def drop(page, path: Path) -> None:
    page.evaluate(DROP, [path.name, base64.b64encode(path.read_bytes()).decode()])


def rows(page) -> list[str]:
    return [row.get_attribute("data-file") for row in page.locator(".local-file").all()]


def centre(page) -> None:
    """Centre the origin, once the address states that the added file is shown whole."""
    until(page, lambda: f"at=0,0,{RESOLUTION}" not in page.url)
    page.evaluate(
        "at => { location.hash = location.hash.replace(/at=[^&]*/, at); }",
        f"at=0,0,{RESOLUTION}",
    )


@pytest.fixture
def features() -> geopandas.GeoDataFrame:
    shapes = [KEEP_OUT, LineString([(-10, -10), (-10, 10)]), Point(0, 0)]
    frame = {"name": ["keep out", "way", "rock"], "geometry": shapes}
    return geopandas.GeoDataFrame(frame, crs=CRS.to_wkt())


def write_geojson(frame, folder: Path) -> Path:
    path = folder / "plan.geojson"
    document = frame.to_crs(MARS).to_geo_dict(drop_id=True)
    document["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:IAU:2015:49900"}}
    path.write_text(json.dumps(document))
    return path


def write_geopackage(frame, folder: Path) -> Path:
    frame.to_crs(MARS).to_file(folder / "plan.gpkg", layer="plan")
    return folder / "plan.gpkg"


def write_shapefile(frame, folder: Path) -> Path:
    path = folder / "plan.zip"
    frame[:1].to_file(folder / "plan.shp")  # one kind of geometry a file; in metres of the map
    with ZipFile(path, "w") as archive:
        for part in folder.glob("plan.*"):
            if part != path:
                archive.write(part, part.name)
    return path


@pytest.mark.parametrize("write", [write_geojson, write_geopackage, write_shapefile])
def test_features_of_a_local_file_are_at_their_coordinates(page, url, features, tmp_path, write):
    look(page, url + at(RESOLUTION, "mer2/orthophoto"))
    empty = screenshot(page, "no-file")
    drop(page, write(features, tmp_path))
    page.locator(".local-file").wait_for()
    centre(page)
    edges = [pixel_of(page, (east + 10) / 2, north, RESOLUTION) for east, north in CORNERS]

    def is_drawn() -> bool:
        image = screenshot(page, f"file-{write.__name__}")
        return all(colour_at(image, at)[2] > colour_at(empty, at)[2] + 40 for at in edges)

    until(page, is_drawn)
    outside = pixel_of(page, 18.0, 8.0, RESOLUTION)
    image = screenshot(page, f"file-{write.__name__}")
    assert np.abs(colour_at(image, outside) - colour_at(empty, outside)).max() <= 2
    page.get_by_role("button", name="remove plan").click()

    def is_gone() -> bool:
        image = screenshot(page, "removed")
        return all((colour_at(image, at) == colour_at(empty, at)).all() for at in edges)

    until(page, is_gone)
    assert rows(page) == []


def test_attributes_of_a_local_feature_are_shown_on_click(page, url, features, tmp_path):
    look(page, url + at(RESOLUTION, "mer2/orthophoto"))
    drop(page, write_geojson(features.assign(depth_cm=[20, 0, None]), tmp_path))
    page.locator(".local-file").wait_for()
    centre(page)
    until(page, lambda: f"at=0,0,{RESOLUTION}" in page.url)
    page.mouse.click(*pixel_of(page, 10.0, 8.0, RESOLUTION))
    reported = page.locator(".file-attributes")
    reported.wait_for()
    assert reported.locator("h2").inner_text() == "plan.geojson"
    rows = [row.inner_text().split("\t") for row in reported.locator("tr").all()]
    assert rows == [["name", "keep out"], ["depth_cm", "20"]]
    page.locator(".point").wait_for()
    keep_screenshot(page, "file-attributes")
    page.mouse.click(*pixel_of(page, 10.0, -8.0, RESOLUTION))
    until(page, lambda: reported.count() == 0)


def write_quarters(folder: Path, crs: str | None) -> Path:
    """White north of the origin, black south of it, and nothing west of it."""
    path = folder / "quarters.tif"
    values = np.full((200, 200), 10.0, np.float32)
    values[:100] = 90.0
    values[:, :100] = np.nan
    transform = from_bounds(-20, -20, 20, 20, 200, 200)
    if crs is not None:
        to, width, height = calculate_default_transform(CRS, crs, 200, 200, -20, -20, 20, 20)
        moved = np.full((height, width), np.nan, np.float32)
        reproject(
            values,
            moved,
            src_transform=transform,
            src_crs=CRS,
            dst_transform=to,
            dst_crs=crs,
            resampling=Resampling.nearest,
            dst_nodata=np.nan,
        )
        values, transform = moved, to
    facts = {"count": 1, "dtype": "float32", "nodata": np.nan, "transform": transform}
    height, width = values.shape
    with rasterio.open(
        path, "w", "GTiff", width=width, height=height, crs=crs or CRS, **facts
    ) as out:
        out.write(values, 1)
    return path


@pytest.mark.parametrize("crs", [None, EQUIRECTANGULAR, MARS])
def test_a_local_raster_is_at_its_coordinates(page, url, tmp_path, crs):
    look(page, url + at(RESOLUTION))
    empty = screenshot(page, "no-raster")
    drop(page, write_quarters(tmp_path, crs))
    page.locator(".local-file").wait_for()
    centre(page)

    def shade(east: float, north: float) -> int:
        """Of the red channel."""
        return int(colour_now(page, pixel_of(page, east, north, RESOLUTION))[0])

    until(page, lambda: shade(15.0, 1.0) == 255)
    assert [shade(15.0, north) for north in (19.0, -1.0, -19.0)] == [255, 0, 0]
    for place in ((-1.0, 10.0), (15.0, 21.0)):
        assert shade(*place) == colour_at(empty, pixel_of(page, *place, RESOLUTION))[0]


def test_a_file_without_usable_coordinates_is_refused_with_a_reason(page, url, tmp_path):
    look(page, url + at(RESOLUTION))
    earth = geopandas.GeoDataFrame({"geometry": [Point(13.4, 52.5)]}, crs="EPSG:4326")
    earth.to_file(tmp_path / "berlin.gpkg")
    (tmp_path / "notes.txt").write_text("a rock")
    (tmp_path / "broken.geojson").write_text("{")
    for name, reason in (
        ("berlin.gpkg", "berlin.gpkg: it is in WGS 84, on a body of 6378 km radius"),
        ("notes.txt", "GeoJSON, GeoPackage, zipped shapefile and GeoTIFF are"),
        ("broken.geojson", "broken.geojson: it is not JSON"),
    ):
        drop(page, tmp_path / name)
        until(page, lambda reason=reason: reason in page.locator(".banner").inner_text())
        page.locator(".banner button").click()
    assert rows(page) == []


def test_features_of_a_local_file_are_published_as_drafts(
    page, workspace, live, features, tmp_path
):
    look(page, live)
    _, text = Tokens.of(workspace.store.root).add("Ann", Role.ANALYST)
    page.get_by_role("button", name="Sign in").click()
    page.locator('dialog input[type="password"]').fill(text)
    page.locator('dialog button[type="submit"]').click()
    until(page, lambda: "Ann (analyst)" in page.locator(".account").inner_text())
    page.set_input_files('[aria-label="files for the map"]', write_geojson(features, tmp_path))
    page.get_by_role("button", name="Publish as drafts").click()
    page.locator(".note-row").nth(2).wait_for()
    drafts = page.locator('.note-row[data-state="draft"] > button').all_inner_texts()
    assert sorted(drafts) == ["keep out", "rock", "way"]
    keep_screenshot(page, "files-published")


def test_the_list_of_files_fits_a_phone(browser, url, features, tmp_path):
    with open_page(browser, 390, 844) as page:
        look(page, url + at(RESOLUTION))
        page.get_by_role("button", name="layers panel").click()
        page.set_input_files('[aria-label="files for the map"]', write_geojson(features, tmp_path))
        box = page.locator(".local-file").bounding_box()
        assert box["x"] + box["width"] <= 390
        keep_screenshot(page, "files-narrow")
