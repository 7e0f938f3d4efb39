"""A region on disk is the same whatever the tiles it was made in."""

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.dtm.region_dtm import RegionParams, StopTerrain, fuse_block
from solmap.photogrammetry.terrain.dtm.resampling import coarser_dtm
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.errors import ProductError
from solmap.products.formats.raster import region
from solmap.products.formats.raster.raster import read_dtm, read_raster, write_dtm
from solmap.products.formats.raster.region import (
    RegionFiles,
    RegionSource,
    read_seams,
    write_region,
)

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


def test_far_ground_with_large_cells_fills_the_rest(made, sources, tmp_path):
    grid = MapGrid.covering((-60.0, -60.0, 60.0, 60.0), 0.32)
    x, y = np.meshgrid(*grid.centres())
    far = Dtm(
        grid,
        (np.sin(x / 3) + np.cos(y / 4)).astype(np.float32),
        np.full(grid.shape, 0.5, np.float32),
        np.ones(grid.shape, np.float32),
        np.full(grid.shape, GroundClass.MEASURED, np.uint8),
    )
    write_dtm(tmp_path / "far.tif", far, CRS)
    files, _ = written(tmp_path, [*sources, RegionSource("far", (0.0, 0.0), tmp_path / "far.tif")])
    with_far, near = read_dtm(files.dtm), read_dtm(made[0].dtm)
    east, north = np.meshgrid(*with_far.grid.centres())
    inside = (np.abs(east) < 50) & (np.abs(north) < 50)
    assert np.isfinite(with_far.elevation[inside]).all()
    truth = np.sin(east / 3) + np.cos(north / 4)
    assert np.abs(with_far.elevation - truth)[inside].max() < 0.1
    close = np.hypot(east, north) < 3.0
    row = round((with_far.grid.north - near.grid.north) / 0.08)
    col = round((near.grid.west - with_far.grid.west) / 0.08)
    rows, cols = np.nonzero(close)
    np.testing.assert_allclose(  # within a stop's ground the coarse model is not used
        with_far.elevation[rows, cols], near.elevation[rows - row, cols - col], atol=2e-3
    )


def test_cells_that_do_not_nest_are_refused(sources, tmp_path):
    with pytest.raises(ProductError, match=r"stop-0 has cells of 0\.04 m, the region's of 0\.06 m"):
        written(tmp_path, sources, RegionParams(cell_m=0.06))
