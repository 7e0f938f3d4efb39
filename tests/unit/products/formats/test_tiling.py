import morecantile
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solmap.photogrammetry.terrain.dtm.grid import BLOCK, MapGrid
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.errors import OutsideCoverageError, ProductError
from solmap.products.formats.raster.tiling import (
    CELL_SIZES,
    EXTENT,
    MAX_ZOOM,
    TileAddress,
    tile_matrix_set,
    whole_zoom_of,
    zoom_of,
)
from tests.support.tile_at import tile_at

GUSEV = LandingPoint("floor of Gusev", 175.4729, -14.5692, 3_393_000.0, "a test")
places = st.floats(-20_000.0, 20_000.0)
zooms = st.integers(0, MAX_ZOOM)


def test_zoom_0_is_one_tile_and_zoom_20_has_cells_of_a_centimetre():
    assert TileAddress(0, 0, 0).bounds == EXTENT
    assert CELL_SIZES[20] == 0.01
    with pytest.raises(OutsideCoverageError, match="columns and rows 0 to 0"):
        TileAddress(0, 1, 0)


@given(east=places, north=places, zoom=zooms)
def test_a_place_is_in_its_tile(east, north, zoom):
    west, south, to_east, to_north = tile_at(east, north, zoom).bounds
    slack = 1e-9 * abs(west - to_east)
    assert west - slack <= east <= to_east + slack
    assert south - slack <= north <= to_north + slack


@given(east=places, north=places, zoom=zooms)
def test_the_ogc_tile_matrix_set_agrees_with_our_tiles(east, north, zoom):
    address = tile_at(east, north, zoom)
    tile = morecantile.Tile(x=address.column, y=address.row, z=zoom)
    theirs = tile_matrix_set(GUSEV).xy_bounds(tile)
    np.testing.assert_allclose(theirs, address.bounds, atol=1e-6)


def test_the_ogc_tile_matrix_set_is_in_the_local_crs():
    tiles = tile_matrix_set(GUSEV)
    assert tiles.crs._pyproj_crs.equals(local_crs(GUSEV))
    assert [matrix.cellSize for matrix in tiles.tileMatrices] == pytest.approx(list(CELL_SIZES))


@given(west=places, south=places, zoom=st.integers(12, MAX_ZOOM))
def test_map_grids_begin_and_end_on_tiles_of_their_zoom(west, south, zoom):
    cell_m = CELL_SIZES[zoom]
    grid = MapGrid.covering((west, south, west + 30.0, south + 20.0), cell_m)
    assert zoom_of(grid.cell_m) == zoom
    first = tile_at(grid.west + cell_m / 2, grid.north - cell_m / 2, zoom)
    np.testing.assert_allclose(first.west_north, (grid.west, grid.north), atol=1e-8)
    assert grid.rows % BLOCK == 0
    assert grid.cols % BLOCK == 0


def test_a_cell_off_the_lattice_has_no_zoom():
    with pytest.raises(ProductError, match=r"0\.05 m is not 0\.01 m times a power of two"):
        zoom_of(0.05)


def test_the_first_zoom_of_a_layer_shows_it_in_one_tile():
    zoom = whole_zoom_of((-40.0, -40.0, 40.0, 40.0))
    assert BLOCK * CELL_SIZES[zoom] >= 80.0
    assert BLOCK * CELL_SIZES[zoom + 1] < 80.0
