"""How fast one stop of ten Navcam pairs becomes a terrain model and an orthophoto.

`extra_info` holds the throughput; next to ours stands what does less work on as many pixels or
points: a bare remap, which is the limit, and a triangulation of all points.
"""

import shutil
import subprocess

import cv2
import geopandas
import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.planes import window_gradients
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.ground import SightParams, ground_points, trusted_parallax
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass, TerrainView
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams, Gridding, build_dtm
from solmap.photogrammetry.terrain.orthophoto.rendering import OrthophotoParams, prepare_orthophoto
from solmap.photogrammetry.terrain.relief.contours import ContourParams, trace_contours
from solmap.photogrammetry.terrain.relief.slope import SlopeParams, normals_of, slope_of

SIDE_PX, FOCAL_PX, BASE_M, MAST_M, DIP = 1024, 1222.0, 0.2, 1.5, np.radians(18)


def navcam_view(
    number: int,
    rng: np.random.Generator,
    step: float = np.radians(36),
    focal_px: float = FOCAL_PX,
    dip: float = DIP,
) -> TerrainView:
    """Level, mottled ground in one of some directions, with the noise of a good matcher."""
    azimuth = number * step
    forward = np.array([np.cos(azimuth) * np.cos(dip), np.sin(azimuth) * np.cos(dip), np.sin(dip)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    frame = Frame(FrameKind.PAIR, (number,))
    middle = (SIDE_PX - 1) / 2
    below = (np.arange(SIDE_PX) - middle) / focal_px
    # level ground: the depth Z of a line follows from its dip alone
    with np.errstate(divide="ignore"):
        parallax = focal_px * BASE_M * (np.sin(dip) + below * np.cos(dip)) / MAST_M
    parallax = np.repeat(np.where(parallax > 0, parallax, np.nan)[:, None], SIDE_PX, axis=1)
    smooth = cv2.GaussianBlur(rng.normal(0, 1, parallax.shape), (0, 0), 2.5)
    parallax += 0.15 * smooth / smooth.std()
    image = cv2.GaussianBlur(rng.normal(1000, 800, parallax.shape), (0, 0), 1.5)
    return TerrainView(
        pair_id=f"PAIR{number}",
        instrument="NAVCAM",
        lsl_from_pair=Pose(LSL, frame, rotation, np.array([0.0, 0.0, -MAST_M])),
        geometry=EpipolarPair(
            Pose.identity(Frame(FrameKind.ROVER, (0, 0)), frame),
            BASE_M,
            focal_px,
            (middle, middle),
            SIDE_PX,
            SIDE_PX,
        ),
        parallax=parallax.astype(np.float32),
        image=image.astype(np.float32),
        mask=np.ones(parallax.shape, dtype=bool),
    )


@pytest.fixture(scope="module")
def stop() -> list[TerrainView]:
    rng = np.random.default_rng(20040104)
    return [navcam_view(number, rng) for number in range(10)]


@pytest.fixture(scope="module")
def dtm(stop):
    return build_dtm(stop, DtmParams())


def test_a_terrain_model_of_ten_pairs(benchmark, stop):
    made = benchmark.pedantic(build_dtm, args=(stop, DtmParams()), rounds=3)
    points = float(made.observations.sum())
    benchmark.extra_info["points"] = points
    benchmark.extra_info["million points a second"] = points / benchmark.stats["mean"] / 1e6
    benchmark.extra_info["seen cells"] = int((made.ground != 0).sum())


@pytest.fixture(scope="module")
def some_points(stop) -> np.ndarray:
    """East, north and up of a twentieth of the points that the terrain model is made from."""
    params = SightParams()
    planes = [ground_points(view, trusted_parallax(view, params), params) for view in stop]
    return np.concatenate([p[:, np.isfinite(p[0])][:, ::20] for p in planes], axis=1)


def note_points(benchmark, points: np.ndarray) -> None:
    benchmark.extra_info["points"] = points.shape[1]
    benchmark.extra_info["million points a second"] = (
        points.shape[1] / benchmark.stats["mean"] / 1e6
    )


def test_triangulating_a_twentieth_of_the_points_for_comparison(benchmark, some_points, dtm):
    points, (east, north) = some_points, (axis[::4] for axis in dtm.grid.centres())
    places = np.meshgrid(east, north)

    def grid_by_triangulation():
        return LinearNDInterpolator(points[:2].T.astype(float), points[2])(*places)

    benchmark.pedantic(grid_by_triangulation, rounds=1)
    note_points(benchmark, points)


@pytest.mark.parametrize("how", ["linear:radius=0", "average:radius=0.08"])
def test_gridding_a_twentieth_of_the_points_by_gdal_for_comparison(
    benchmark, some_points, dtm, tmp_path, how
):
    gridder = shutil.which("gdal_grid")
    if gridder is None:
        pytest.skip("gdal_grid is not installed (Debian: gdal-bin)")
    places = geopandas.points_from_xy(*some_points.astype(float))
    reported = geopandas.GeoDataFrame(geometry=places, crs="ESRI:104905")  # any
    reported.to_file(tmp_path / "points.fgb", driver="FlatGeobuf")
    west, south, east, north = dtm.grid.bounds
    box = ["-txe", str(west), str(east), "-tye", str(north), str(south)]
    size = ["-outsize", str(dtm.grid.cols // 4), str(dtm.grid.rows // 4)]
    files = [str(tmp_path / "points.fgb"), str(tmp_path / "grid.tif")]
    command = [gridder, "-q", "-a", how, *box, *size, "--config", "GDAL_NUM_THREADS", "1", *files]
    benchmark.pedantic(subprocess.run, args=(command,), kwargs={"check": True}, rounds=1)
    note_points(benchmark, some_points)


def test_a_terrain_model_by_triangles(benchmark, stop):
    params = DtmParams(method=Gridding.TIN)
    made = benchmark.pedantic(build_dtm, args=(stop, params), rounds=1)
    benchmark.extra_info["interpolated cells"] = int(
        (made.ground == GroundClass.INTERPOLATED).sum()
    )


def rendered(dtm, views) -> tuple[int, int]:
    """Render an orthophoto block by block, as for a file; (all, shown) pixels."""
    made = prepare_orthophoto(dtm, views, OrthophotoParams())
    shown = sum(int(np.isfinite(block.brightness).sum()) for block in made.blocks())
    return made.grid.rows * made.grid.cols, shown


def note_pixels(benchmark, pixels: tuple[int, int]) -> None:
    """Megapixels, and how many a second; the map's edge is empty, so shown ones count too."""
    whole, shown = (number / 1e6 for number in pixels)
    benchmark.extra_info["megapixels"], benchmark.extra_info["shown megapixels"] = whole, shown
    benchmark.extra_info["shown megapixels a second"] = shown / benchmark.stats["mean"]


def test_an_orthophoto_of_a_stop(benchmark, stop, dtm):
    note_pixels(benchmark, benchmark.pedantic(rendered, args=(dtm, stop), rounds=3))


def test_an_orthophoto_of_a_pancam_panorama(benchmark):
    """12,288 x 12,288 cells of level ground from 27 views that are 16 degrees wide."""
    rng = np.random.default_rng(20040104)
    views = [
        navcam_view(number, rng, step=2 * np.pi / 27, focal_px=3590.0, dip=np.radians(6.0))
        for number in range(27)
    ]
    grid = MapGrid.covering((-60.0, -60.0, 60.0, 60.0), 0.04)
    flat = np.zeros(grid.shape, dtype=np.float32)
    measured = np.full(grid.shape, GroundClass.MEASURED, dtype=np.uint8)
    level = Dtm(grid, flat, flat + np.float32(0.01), flat + 1, measured)
    note_pixels(benchmark, benchmark.pedantic(rendered, args=(level, views), rounds=1))


@pytest.mark.parametrize("side", [6656, 12_288])
def test_a_bare_remap_of_as_many_pixels_for_comparison(benchmark, stop, side):
    """The limit: one image, one lookup a pixel, the places known beforehand."""
    x = np.tile(np.linspace(0, SIDE_PX - 1, side, dtype=np.float32), (512, 1))
    y = np.linspace(0, SIDE_PX - 1, side, dtype=np.float32)

    def remapped() -> None:
        for row in range(0, side, 512):
            lines = np.repeat(y[row : row + 512, None], side, axis=1)
            cv2.remap(stop[0].image, x[: len(lines)], lines, cv2.INTER_LINEAR)

    benchmark.pedantic(remapped, rounds=3)
    benchmark.extra_info["megapixels a second"] = side**2 / 1e6 / benchmark.stats["mean"]


def test_the_slope_of_a_stop(benchmark, dtm):
    params = SlopeParams()

    def slope() -> np.ndarray:
        gradient = window_gradients(
            dtm.elevation, dtm.grid.cell_m, params.baseline_m, params.min_share
        )
        return slope_of(normals_of(gradient))

    benchmark.pedantic(slope, rounds=3)
    benchmark.extra_info["million cells a second"] = (
        dtm.elevation.size / benchmark.stats["mean"] / 1e6
    )


def test_the_contours_of_a_stop(benchmark, dtm):
    params = ContourParams(interval_m=0.01)
    lines = benchmark.pedantic(trace_contours, args=(dtm.elevation, dtm.grid, params), rounds=3)
    benchmark.extra_info["points"] = sum(len(line.points) for line in lines)
