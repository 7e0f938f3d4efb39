"""A region on disk is the same whatever the tiles it was made in."""

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.parts import seen_parts
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.dtm.region_dtm import RegionParams, StopTerrain, fuse_block
from solmap.photogrammetry.terrain.dtm.resampling import coarser_dtm
from solmap.photogrammetry.terrain.relief.slope import SlopeParams, slope_of
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.errors import ProductError
from solmap.products.formats.raster import region
from solmap.products.formats.raster.raster import open_dtm, read_dtm, read_raster, write_dtm
from solmap.products.formats.raster.region import (
    RegionFiles,
    RegionSource,
    read_seams,
    write_region,
)
from tests.support.terrain.whole_relief import whole_relief

CRS = local_crs(LandingPoint("a plain", 175.0, -14.5, 3_393_000.0, "assumed"))
PARAMS = RegionParams()


def disc(east: float, north: float, radius_m: float, rng: np.random.Generator) -> Dtm:
    """What a stop sees around it of rolling ground, with noise."""
    bounds = (east - radius_m, north - radius_m, east + radius_m, north + radius_m)
    grid = MapGrid.covering(bounds, 0.04)
    x, y = np.meshgrid(*grid.centres())
    seen = np.hypot(x - east, y - north) < radius_m
    height = np.sin(x / 3) + np.cos(y / 4) + rng.normal(0, 0.02, grid.shape)
    nan = np.where(seen, 1.0, np.nan)
    return Dtm(
        grid,
        (height * nan).astype(np.float32),
        (0.03 * nan).astype(np.float32),
        seen.astype(np.float32),
        np.where(seen, GroundClass.MEASURED, GroundClass.UNSEEN).astype(np.uint8),
        (0.02 * nan).astype(np.float32),
    )


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("stops"), np.random.default_rng(5)
    made = []
    for number, place in enumerate([(0.0, 0.0), (9.0, 4.0), (60.0, -30.0)]):
        path = folder / f"{number}.tif"
        write_dtm(path, disc(*place, 8.0, rng), CRS)
        made.append(RegionSource(f"stop-{number}", place, path))
    return made


def written(folder, sources, params=PARAMS):
    files = RegionFiles(folder / "dtm.tif", folder / "seams.tif")
    return files, write_region(files, sources, params, CRS)


@pytest.fixture(scope="module")
def made(tmp_path_factory, sources):
    return written(tmp_path_factory.mktemp("region"), sources)


def test_tiles_leave_no_seams(made, sources, tmp_path, monkeypatch):
    monkeypatch.setattr(region, "TILE", 256)
    small, _ = written(tmp_path, sources)
    for one, other in ((made[0].dtm, small.dtm), (made[0].seams, small.seams)):
        for name, band in read_raster(one)[1].items():
            same = read_raster(other)[1][name]
            # tiles that no stop reaches are not written, not even as having no observation
            np.testing.assert_allclose(
                np.nan_to_num(band), np.nan_to_num(same), atol=2e-4, err_msg=name
            )


def test_a_region_read_back_equals_the_fusion_of_its_stops(made, sources):
    whole = read_dtm(made[0].dtm)
    first = coarser_dtm(read_dtm(sources[2].path), 2)
    alone = fuse_block([StopTerrain(2, sources[2].place, first)], PARAMS).dtm
    row = round((whole.grid.north - first.grid.north) / 0.08)
    col = round((first.grid.west - whole.grid.west) / 0.08)
    there = (slice(row, row + first.grid.rows), slice(col, col + first.grid.cols))
    np.testing.assert_allclose(whole.elevation[there], alone.elevation, atol=1e-5)
    np.testing.assert_allclose(whole.sigma_m[there], alone.sigma_m, atol=1e-5)
    np.testing.assert_array_equal(whole.ground[there], alone.ground)


def test_stops_without_common_ground_have_no_seam(made):
    stops, seams = read_seams(made[0].seams)
    assert stops == ("stop-0", "stop-1", "stop-2")
    assert seams == made[1]
    assert [seam.stops for seam in seams] == [(0, 1)]
    assert seams[0].median_m == pytest.approx(0.67 * 0.01 * np.sqrt(2), rel=0.2)  # mean of 4 cells


def with_far_ground(folder, sources, cell_m, height_at) -> RegionFiles:
    """The region of some stops and of far ground in large cells, south-east of one of them."""
    grid = MapGrid.covering((1.0, -61.0, 61.0, -1.0), cell_m)
    x, y = np.meshgrid(*grid.centres())
    far = Dtm(
        grid,
        height_at(x, y).astype(np.float32),
        np.full(grid.shape, 0.5, np.float32),
        np.ones(grid.shape, np.float32),
        np.full(grid.shape, GroundClass.MEASURED, np.uint8),
    )
    write_dtm(folder / "far.tif", far, CRS)
    return written(folder, [*sources, RegionSource("far", (0.0, 0.0), folder / "far.tif")])[0]


def test_far_ground_with_large_cells_fills_the_rest(made, sources, tmp_path):
    files = with_far_ground(tmp_path, sources, 0.32, lambda x, y: np.sin(x / 3) + np.cos(y / 4))
    with_far, near = read_dtm(files.dtm), read_dtm(made[0].dtm)
    east, north = np.meshgrid(*with_far.grid.centres())
    inside = (np.minimum(east, -north) > 1) & (np.maximum(east, -north) < 50)
    assert np.isfinite(with_far.elevation[inside]).all()
    truth = np.sin(east / 3) + np.cos(north / 4)
    assert np.abs(with_far.elevation - truth)[inside].max() < 0.1
    close = np.hypot(east - 3.0, north + 3.0) < 2.0
    row = round((with_far.grid.north - near.grid.north) / 0.08)
    col = round((near.grid.west - with_far.grid.west) / 0.08)
    rows, cols = np.nonzero(close)
    np.testing.assert_allclose(  # within a stop's ground the coarse model is not used
        with_far.elevation[rows, cols], near.elevation[rows - row, cols - col], atol=2e-3
    )


def test_far_ground_is_mapped_in_cells_half_as_wide_as_its_own(sources, tmp_path):
    files = with_far_ground(tmp_path, sources, 0.64, lambda x, y: 0.1 * x - 0.2 * y)
    with open_dtm(files.dtm) as stored:
        assert {part.step for part in seen_parts(stored)} == {1, 4}
        *_, (rows, cols) = (part.own for part in seen_parts(stored) if part.step == 4)
        far = stored.part(slice(rows.start, rows.stop, 4), slice(cols.start, cols.stop, 4))
        whole = stored.part(rows, cols)
        planes, grid = whole_relief(stored, SlopeParams())
    assert far.observations.sum() == pytest.approx(whole.observations.sum())
    east, north = np.meshgrid(*far.grid.centres())
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(far.elevation[inner], (0.1 * east - 0.2 * north)[inner], atol=1e-3)
    east, north = np.meshgrid(*grid.centres())
    away = (np.minimum(east, -north) > 25.0) & (np.maximum(east, -north) < 45.0)
    away &= np.hypot(east - 60.0, north + 30.0) > 12.0
    slopes = slope_of(planes.normal)[away]
    np.testing.assert_allclose(slopes, np.degrees(np.arctan(np.hypot(0.1, 0.2))), atol=0.01)


def test_cells_that_do_not_nest_are_refused(sources, tmp_path):
    with pytest.raises(ProductError, match=r"stop-0 has cells of 0\.04 m, the region's of 0\.06 m"):
        written(tmp_path, sources, RegionParams(cell_m=0.06))
