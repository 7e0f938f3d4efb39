"""How long a region as large as the paper's takes to fuse, and how much memory.

690 x 640 m at 0.08 m are 69 million cells. Its stops are simulated as what they leave: terrain
models of discs, 30 m in radius, with noise and errors of their poses. They are fused in a process
of its own, whose peak of memory is the figure.
"""

import multiprocessing
import resource
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.dtm.region_dtm import RegionParams
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.raster import write_dtm
from solmap.products.formats.raster.region import RegionFiles, RegionSource, write_region

LANDING = LandingPoint("a plain", 175.0, -14.5, 3_393_000.0, "assumed")
SIDES_M = (690.0, 640.0)
RADIUS_M = 30.0


def stop_terrain(place: tuple[float, float], rng: np.random.Generator) -> Dtm:
    """What a stop sees of rolling ground, raised and tilted by the error of its pose."""
    east, north = place
    box = (east - RADIUS_M, north - RADIUS_M, east + RADIUS_M, north + RADIUS_M)
    grid = MapGrid.covering(box, 0.04)
    x, y = (axis.astype(np.float32) for axis in grid.centres())
    x, y = x[None, :], y[:, None]
    away = np.hypot(x - np.float32(east), y - np.float32(north))
    seen = (away < RADIUS_M) & (away > 1.0)
    raised, tilt_e, tilt_n = rng.normal(0, (0.05, 0.001, 0.001)).astype(np.float32)
    height = 5 * np.sin(x / 40) + 3 * np.cos(y / 25) + raised
    height = height + tilt_e * (x - np.float32(east)) + tilt_n * (y - np.float32(north))
    sigma = 0.002 + 2e-5 * away**2
    height += sigma * rng.standard_normal(grid.shape, dtype=np.float32)
    pose = np.hypot(np.float32(0.05), 0.0014 * away)
    gone = np.float32(np.nan)
    return Dtm(
        grid,
        np.where(seen, height, gone),
        np.where(seen, np.hypot(sigma, pose), gone),
        seen.astype(np.float32),
        np.where(seen, GroundClass.MEASURED, GroundClass.UNSEEN).astype(np.uint8),
        np.where(seen, pose, gone),
    )


@pytest.fixture(scope="module")
def stops(tmp_path_factory) -> list[RegionSource]:
    """A grid of stops 52 m apart, so that most places are seen by one or two of them."""
    folder, rng = tmp_path_factory.mktemp("stops"), np.random.default_rng(20060705)
    east, north = (np.arange(RADIUS_M, side - 10, 52.0) for side in SIDES_M)
    made = []
    for place in ((float(e), float(n)) for e in east for n in north):
        path = folder / f"{len(made)}.tif"
        write_dtm(path, stop_terrain(place, rng), local_crs(LANDING))
        made.append(RegionSource(path.stem, place, path))
    return made


def fused(folder: Path, sources: list[RegionSource]) -> dict[str, float]:
    """Fuse them; seconds of processor, the peak of memory and what came out."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.process_time()
    files = RegionFiles(folder / "dtm.tif", folder / "seams.tif")
    seams = write_region(files, sources, RegionParams(), local_crs(LANDING))
    return {
        "processor seconds": time.process_time() - started,
        "peak MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "MB before": before / 1024,
        "pairs of stops that share ground": len(seams),
        "median disagreement, m": float(np.median([seam.median_m for seam in seams])),
        "file MB": files.dtm.stat().st_size / 1e6,
    }


def test_fusing_a_region_of_690_by_640_metres(benchmark, stops, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2])  # for the other process
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        reported = benchmark.pedantic(
            lambda: pool.submit(fused, tmp_path, stops).result(), rounds=1, iterations=1
        )
    benchmark.extra_info.update(reported, stops=len(stops))
    assert reported["peak MB"] < 2000  # a region in memory would take 2.5 GB for its bands alone
