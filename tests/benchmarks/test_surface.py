"""How fast maps are derived from the ground: 60 x 60 m of a hilly world in cells of 0.04 m.

Every cell has an elevation, which is the most that a stop can have. The viewshed runs next to
GDAL's on the same cells, where `gdal_viewshed` is installed; horizons next to looking at every cell
of a line from every cell, on a smaller raster.
"""

import math
import resource
import shutil
import subprocess

import numpy as np
import pytest
import rasterio

from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.dtm.resampling import coarsen
from solmap.photogrammetry.terrain.insolation.horizon import horizons
from solmap.photogrammetry.terrain.insolation.maps import (
    HavenParams,
    InsolationParams,
    insolation,
    winter_havens,
)
from solmap.photogrammetry.terrain.relief.contours import ContourParams, trace_contours
from solmap.photogrammetry.terrain.relief.slope import SlopeParams, relief_parts
from solmap.photogrammetry.terrain.traversability.hazard import HazardParams, hazards
from solmap.photogrammetry.terrain.visibility.viewshed import (
    Sight,
    ViewshedParams,
    viewshed,
)

GRID = MapGrid(-30.72, 30.72, 0.04, 1536, 1536)
GUSEV = math.radians(-14.735)


def eye_on_mast(
    elevation: np.ndarray, grid: MapGrid, place: tuple[float, float], mast_m: float
) -> np.ndarray:
    """An eye (east, north, up) at a height above the ground at (east, north)."""
    cell = grid.cell_at(*place)
    assert cell is not None
    return np.array([*place, float(elevation[cell]) + mast_m])


@pytest.fixture(scope="module")
def dtm() -> Dtm:
    world = make_world(WorldParams(terrain="hills"), 4)
    return Dtm(
        grid=GRID,
        elevation=world.true_elevation(GRID),
        sigma_m=np.full(GRID.shape, 0.02, np.float32),
        observations=np.ones(GRID.shape, np.float32),
        ground=np.full(GRID.shape, GroundClass.MEASURED, np.uint8),
    )


@pytest.fixture(scope="module")
def coarse(dtm):
    return coarsen(dtm.elevation, dtm.grid, 0.16)


def test_slope_with_its_deviation_tilt_and_roughness(benchmark, dtm):
    benchmark.pedantic(relief_parts, args=(dtm, SlopeParams()), rounds=3)
    benchmark.extra_info["million cells a second"] = (
        dtm.elevation.size / benchmark.stats["mean"] / 1e6
    )


@pytest.mark.parametrize("seasons", [1, 4])
def test_insolation_with_shadows(benchmark, dtm, seasons):
    params = InsolationParams(ls_deg=tuple(90.0 * k for k in range(seasons)))
    made = benchmark.pedantic(insolation, args=(dtm, GUSEV, params), rounds=3)
    havens = winter_havens(made, GUSEV, HavenParams())
    benchmark.extra_info["havens"] = len(havens)
    benchmark.extra_info["cells"] = int(np.isfinite(made.sky).sum())


def every_cell_from_every_cell(elevation, cell_m):
    """Horizon to the north, looking at all cells of the column."""
    found = np.zeros_like(elevation)
    for away in range(1, elevation.shape[0]):
        rise = (elevation[:-away] - elevation[away:]) / np.float32(away * cell_m)
        np.maximum(found[away:], rise, out=found[away:])
    return found


def test_one_horizon_by_convex_hulls(benchmark, coarse):
    elevation, grid = coarse
    window = np.ascontiguousarray(elevation[np.isfinite(elevation).any(axis=1)][:, :512])
    benchmark.pedantic(horizons, args=(np.nan_to_num(window), grid.cell_m, 36), rounds=3)
    benchmark.extra_info["million horizons a second"] = (
        36 * window.size / benchmark.stats["mean"] / 1e6
    )


def test_one_horizon_by_visiting_every_cell_for_comparison(benchmark, coarse):
    elevation, grid = coarse
    window = np.nan_to_num(elevation[np.isfinite(elevation).any(axis=1)][:, :512])
    found = benchmark.pedantic(every_cell_from_every_cell, args=(window, grid.cell_m), rounds=3)
    ours = horizons(window, grid.cell_m, 4)[0]
    np.testing.assert_allclose(ours, found, atol=1e-4)
    benchmark.extra_info["million horizons a second"] = window.size / benchmark.stats["mean"] / 1e6


def test_hazards(benchmark, dtm):
    made, _ = benchmark.pedantic(hazards, args=(dtm, HazardParams()), rounds=3)
    benchmark.extra_info["classes"] = np.bincount(made.ravel(), minlength=5).tolist()


def test_the_viewshed_of_a_mast(benchmark, coarse):
    elevation, grid = coarse
    params = ViewshedParams()
    eye = eye_on_mast(elevation, grid, (0.0, 0.0), params.eye_height_m)
    made = benchmark.pedantic(viewshed, args=(elevation, grid, eye, params), rounds=3)
    benchmark.extra_info["visible"] = float((made == Sight.VISIBLE).sum() / (made > 0).sum())


@pytest.mark.skipif(shutil.which("gdal_viewshed") is None, reason="gdal_viewshed is not installed")
@pytest.mark.parametrize("target_m", [0.0, 0.1, 0.5])
def test_the_viewshed_of_gdal_for_comparison(benchmark, coarse, tmp_path, target_m):
    elevation, grid = coarse
    rows = np.isfinite(elevation).any(axis=1)
    first = int(np.flatnonzero(rows)[0])
    window = elevation[rows][:, np.isfinite(elevation).any(axis=0)]
    left = int(np.flatnonzero(np.isfinite(elevation).any(axis=0))[0])
    grid = grid.part(first, left, *window.shape)
    ground, seen = tmp_path / "ground.tif", tmp_path / "seen.tif"
    profile = {"driver": "GTiff", "dtype": "float32", "count": 1}
    with rasterio.open(
        ground, "w", width=grid.cols, height=grid.rows, **profile,
        transform=rasterio.Affine(grid.cell_m, 0, grid.west, 0, -grid.cell_m, grid.north),
    ) as dataset:  # fmt: skip
        dataset.write(window, 1)
    middle = (
        grid.west + (grid.cols // 2 + 0.5) * grid.cell_m,
        grid.north - (grid.rows // 2 + 0.5) * grid.cell_m,
    )
    command = [
        "gdal_viewshed", "-q", "-cc", "0", "-oz", "1.5", "-tz", str(target_m), "-om", "NORMAL",
        "-ox", str(middle[0]), "-oy", str(middle[1]), "-md", "100", str(ground), str(seen),
    ]  # fmt: skip
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    benchmark.pedantic(subprocess.run, args=(command,), kwargs={"check": True}, rounds=3)
    spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    with rasterio.open(seen) as dataset:
        theirs = dataset.read(1) == 255
    params = ViewshedParams(target_height_m=target_m)
    ours = viewshed(window, grid, eye_on_mast(window, grid, middle, 1.5), params) == Sight.VISIBLE
    agreement = float((ours == theirs).mean())
    benchmark.extra_info["agreement"] = agreement
    benchmark.extra_info["processor seconds"] = spent / 3
    assert agreement > 0.9


def test_contours_and_their_simplification(benchmark, dtm):
    lines = benchmark.pedantic(
        trace_contours, args=(dtm.elevation, dtm.grid, ContourParams(interval_m=0.1)), rounds=3
    )
    traced = trace_contours(dtm.elevation, dtm.grid, ContourParams(interval_m=0.1, simplify_m=0.0))
    benchmark.extra_info["points"] = sum(len(line.points) for line in lines)
    benchmark.extra_info["points before"] = sum(len(line.points) for line in traced)
