"""Write a synthetic downlink: pictures in parallel, each file whole or absent.

A second call with the same arguments continues where the first stopped.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from solmap.config.landing import landing_site
from solmap.flows.progress import report
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.photogrammetry.synthetic.world import (
    DownlinkFile,
    RenderJob,
    World,
    WorldParams,
    make_world,
    render_jobs,
    text_files,
)
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.products.crs import local_crs
from solmap.products.formats.raster.raster import write_raster

TRUTH_CELL_M = 0.08
WORKERS = 2


def write_downlink(
    out_dir: Path, stops: int, seed: int, terrain: str, *, pancam: bool = False, pairs: int = 10
) -> int:
    """Simulate a rover's downlink into a folder; the number of files.

    Raises:
        PhotogrammetryError: the folder holds something else, or the terrain is unknown.
    """
    params = WorldParams(terrain, TraverseParams(stops=stops), pairs=pairs, pancam=pancam)
    world = make_world(params, seed)
    texts = text_files(world)
    _refuse_another_world(out_dir, texts)
    for file in texts:
        _write(out_dir, file)
    jobs = render_jobs(world)
    with ThreadPoolExecutor(WORKERS) as pool:
        done = pool.map(partial(_render, world, out_dir), jobs)
        for number, _ in enumerate(done, 1):
            report("render pictures", number, len(jobs))
    _write_true_terrain(world, out_dir / "truth" / "dtm.tif")
    return len(texts) + len(jobs) + 1


def _refuse_another_world(out_dir: Path, texts: list[DownlinkFile]) -> None:
    for file in texts:
        there = out_dir / file.path
        if there.exists() and there.read_bytes() != file.data:
            raise PhotogrammetryError(
                f"{out_dir} holds another world ({file.path} differs); name an empty folder"
            )


def _render(world: World, out_dir: Path, job: RenderJob) -> None:
    if not (out_dir / job.path(world)).exists():
        _write(out_dir, job.run(world))


def _write(out_dir: Path, file: DownlinkFile) -> None:
    path = out_dir / file.path
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(path.suffix + ".part")
    draft.write_bytes(file.data)
    draft.replace(path)


def _write_true_terrain(world: World, path: Path) -> None:
    if path.exists():
        return
    grid = MapGrid.covering(world.bounds, TRUTH_CELL_M)
    draft = path.with_name("draft.tif")
    landing = landing_site(world.stops[0].id.mission).landing
    elevation = world.true_elevation(grid)
    write_raster(draft, grid, {"elevation": elevation}, local_crs(landing), unit="m")
    draft.replace(path)
