"""Parts of products have the cells and features of the whole, in the same places."""

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.errors import OutsideCoverageError, ProductError
from solmap.products.formats.cropping import MOST_CELLS, crop_features, crop_raster
from solmap.products.formats.raster.cog import RasterClass
from solmap.products.formats.raster.raster import (
    class_names,
    grid_of,
    write_classes,
    write_raster,
)
from solmap.products.formats.vector.geojson import Feature, FeatureCollection

LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
GRID = MapGrid.covering((-40.0, -30.0, 40.0, 30.0), 0.16)


@pytest.fixture(scope="module")
def dtm(tmp_path_factory):
    path = tmp_path_factory.mktemp("dtm") / "dtm.tif"
    values = np.arange(GRID.rows * GRID.cols, dtype=np.float32).reshape(GRID.shape)
    values[:50, :50] = np.nan
    bands = {"elevation": values, "standard_deviation": values / 2}
    tags = {"PRODUCT": "dtm/mer2/0123456789abcdef"}
    write_raster(path, GRID, bands, local_crs(LANDING), unit="m", tags=tags)
    return path


@settings(max_examples=25)
@given(
    west=st.floats(-60, 39),
    south=st.floats(-50, 29),
    width=st.floats(0.2, 60),
    height=st.floats(0.2, 60),
)
def test_a_part_has_the_cells_of_the_whole_in_place(
    dtm, tmp_path_factory, west, south, width, height
):
    box = (west, south, west + width, south + height)
    part = tmp_path_factory.mktemp("part") / "part.tif"
    if box[2] <= GRID.bounds[0] or box[3] <= GRID.bounds[1]:
        with pytest.raises(OutsideCoverageError):
            crop_raster(dtm, part, box)
        return
    crop_raster(dtm, part, box)
    with rasterio.open(dtm) as whole, rasterio.open(part) as cut:
        window = rasterio.windows.from_bounds(*cut.bounds, transform=whole.transform)
        np.testing.assert_array_equal(cut.read(), whole.read(window=window.round()))
        inside = (
            max(box[0], GRID.bounds[0]),
            max(box[1], GRID.bounds[1]),
            min(box[2], GRID.bounds[2]),
            min(box[3], GRID.bounds[3]),
        )
        grown = np.array(cut.bounds) - inside
        assert (grown[:2] <= 1e-6).all()
        assert (grown[2:] >= -1e-6).all()
        assert np.abs(grown).max() < 2 * GRID.cell_m  # no more than the cells it touches


def test_a_part_has_the_tags_of_the_whole_and_its_window(dtm, tmp_path):
    part = tmp_path / "part.tif"
    crop_raster(dtm, part, (0.0, 0.0, 20.0, 20.0))
    with rasterio.open(part) as cut:
        assert cut.descriptions == ("elevation", "standard_deviation")
        assert cut.units == ("m", "m")
        assert cut.tags()["CUT_FROM"] == "dtm/mer2/0123456789abcdef"
        assert cut.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert CRS.from_wkt(cut.crs.to_wkt(version="WKT2_2019")).equals(local_crs(LANDING))
        assert grid_of(cut).cell_m == GRID.cell_m


def test_classes_keep_their_names_and_colours(tmp_path):
    whole, part = tmp_path / "whole.tif", tmp_path / "part.tif"
    codes = np.ones(GRID.shape, dtype=np.uint8)
    codes[: GRID.rows // 2] = 2
    kinds = (RasterClass(1, "level", "#00ff00"), RasterClass(2, "steep", "#ff0000"))
    write_classes(whole, GRID, codes, local_crs(LANDING), name="hazard", classes=kinds)
    crop_raster(whole, part, (-5.0, -5.0, 5.0, 5.0))
    with rasterio.open(part) as cut:
        assert class_names(cut) == {1: "level", 2: "steep"}
        assert cut.colormap(1)[2] == (255, 0, 0, 255)
        assert set(np.unique(cut.read(1))) == {1, 2}


def test_a_window_with_too_many_cells_is_refused_by_number(dtm, tmp_path, monkeypatch):
    monkeypatch.setattr("solmap.products.formats.cropping.MOST_CELLS", 1000)
    with pytest.raises(ProductError, match=r"256 x 256 cells in 2 bands, more than the 1000"):
        crop_raster(dtm, tmp_path / "part.tif", (0.0, 0.0, 256 * 0.16, 256 * 0.16))
    assert not list(tmp_path.iterdir())
    assert MOST_CELLS == 50_000_000


def test_lines_and_areas_are_cut_at_the_box():
    zigzag = np.array([[-5.0, 1, 9], [5, 1, 9], [5, 20, 9], [-5, 20, 9], [-5, 2, 9], [4, 2, 9]])
    square = np.array([[-5.0, -5], [5, -5], [5, 5], [-5, 5]])
    hole = square / 5
    whole = FeatureCollection(
        LANDING,
        (
            Feature("LineString", zigzag, {"name": "line"}, "1"),
            Feature("Polygon", square, {"name": "area"}, "2", (hole,)),
            Feature("Point", np.array([[3.0, 3.0]]), {}, "in"),
            Feature("Point", np.array([[30.0, 3.0]]), {}, "out"),
        ),
    )
    part = crop_features(whole, (0.0, 0.0, 10.0, 10.0))
    assert [one.id for one in part.features] == ["1", "1", "2", "in"]
    first, second = part.features[:2]
    assert first.points.tolist() == [[0, 1, 9], [5, 1, 9], [5, 10, 9]]
    assert second.points.tolist() == [[0, 2, 9], [4, 2, 9]]
    assert first.properties == {"name": "line"}
    corner = part.features[2]
    assert corner.bounds == (0.0, 0.0, 5.0, 5.0)
    assert len(corner.points) == 6  # the hole takes a corner out of the quarter
