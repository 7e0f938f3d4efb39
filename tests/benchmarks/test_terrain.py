"""How fast one stop of ten Navcam pairs becomes a terrain model and an orthophoto.

`extra_info` holds the throughput; next to ours stands what does less work on as many pixels or
points: a bare remap, which is the limit, and a triangulation of all points.
"""

import cv2
import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from photogrammetry.cameras.epipolar import EpipolarPair
from photogrammetry.frames import LSL, Frame, FrameKind, Pose
from photogrammetry.terrain.contours import ContourParams, trace_contours
from photogrammetry.terrain.dtm import DtmParams, build_dtm
from photogrammetry.terrain.ground import SightParams, ground_of, trusted_parallax
from photogrammetry.terrain.orthophoto import OrthophotoParams, render_orthophoto
from photogrammetry.terrain.records import TerrainView
from photogrammetry.terrain.surface import SlopeParams, slope

SIDE_PX, FOCAL_PX, BASE_M, MAST_M, DIP = 1024, 1222.0, 0.2, 1.5, np.radians(18)


def navcam_view(number: int, rng: np.random.Generator) -> TerrainView:
    """Level, mottled ground in one of ten directions, with the noise of a good matcher."""
    azimuth = number * np.radians(36)
    forward = np.array([np.cos(azimuth) * np.cos(DIP), np.sin(azimuth) * np.cos(DIP), np.sin(DIP)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    frame = Frame(FrameKind.PAIR, (number,))
    middle = (SIDE_PX - 1) / 2
    below = (np.arange(SIDE_PX) - middle) / FOCAL_PX
    # level ground: the depth Z of a line follows from its dip alone
    with np.errstate(divide="ignore"):
        parallax = FOCAL_PX * BASE_M * (np.sin(DIP) + below * np.cos(DIP)) / MAST_M
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
            FOCAL_PX,
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


def test_triangulating_a_twentieth_of_the_points_for_comparison(benchmark, stop, dtm):
    params = SightParams()
    planes = [ground_of(view, trusted_parallax(view, params), params) for view in stop]
    points = np.concatenate([p[:, np.isfinite(p[0])][:, ::20] for p in planes], axis=1)
    east, north = np.meshgrid(*(centres[::4] for centres in dtm.grid.centres()))

    def grid_by_triangulation():
        return LinearNDInterpolator(points[:2].T.astype(float), points[2])(east, north)

    benchmark.pedantic(grid_by_triangulation, rounds=1)
    benchmark.extra_info["points"] = points.shape[1]
    benchmark.extra_info["million points a second"] = (
        points.shape[1] / benchmark.stats["mean"] / 1e6
    )


def test_an_orthophoto_of_a_stop(benchmark, stop, dtm):
    made = benchmark.pedantic(render_orthophoto, args=(dtm, stop, OrthophotoParams()), rounds=3)
    benchmark.extra_info["megapixels"] = made.brightness.size / 1e6
    benchmark.extra_info["shown megapixels"] = float(np.isfinite(made.brightness).sum()) / 1e6
    benchmark.extra_info["megapixels a second"] = (
        made.brightness.size / benchmark.stats["mean"] / 1e6
    )


def test_a_bare_remap_of_as_many_pixels_for_comparison(benchmark, stop):
    y, x = np.indices((6000, 6000), dtype=np.float32)
    x, y = x * (SIDE_PX / 6000), y * (SIDE_PX / 6000)
    benchmark.pedantic(cv2.remap, args=(stop[0].image, x, y, cv2.INTER_LINEAR), rounds=3)
    benchmark.extra_info["megapixels a second"] = 36 / benchmark.stats["mean"]


def test_the_slope_of_a_stop(benchmark, dtm):
    benchmark.pedantic(slope, args=(dtm, SlopeParams()), rounds=3)
    benchmark.extra_info["million cells a second"] = (
        dtm.elevation.size / benchmark.stats["mean"] / 1e6
    )


def test_the_contours_of_a_stop(benchmark, dtm):
    params = ContourParams(interval_m=0.01)
    lines = benchmark.pedantic(trace_contours, args=(dtm.elevation, dtm.grid, params), rounds=3)
    benchmark.extra_info["points"] = sum(len(line.points) for line in lines)
