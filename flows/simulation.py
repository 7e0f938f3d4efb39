"""Simulated data with known truth: a downlink of rendered images, or a whole mission without.

A downlink is written file by file, each whole or absent; a second call with the same arguments
continues where the first stopped. An orbital image of the same ground is written beside it. A
mission is published to a store: traverse, stops, ties and footprints.
"""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path

from prefect import flow

from solmap.config.landing import landing_site
from solmap.config.pipeline import load_pipeline
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.mission import draw_mission
from solmap.flows.runtime.progress import report
from solmap.flows.runtime.run_record import beside_runs
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.synthetic.downlink import (
    DownlinkFile,
    RenderJob,
    render_jobs,
    text_files,
)
from solmap.photogrammetry.synthetic.mission import MISSION, MissionPlan
from solmap.photogrammetry.synthetic.orbital import orbital_mosaic
from solmap.photogrammetry.synthetic.scene import World, WorldParams, make_world
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.products.catalogue.catalogue import MissionEntry, Outcome
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import local_crs
from solmap.products.errors import ProductError
from solmap.products.formats.raster.orthophoto import write_orthophoto
from solmap.products.formats.raster.raster import write_raster
from solmap.products.model import ProductKind, ProductRef
from solmap.tasks.mission.publish import publish
from solmap.tasks.mission.simulation import (
    NO_PIXELS,
    SimulationParams,
    adjust_simulated,
    keep_labels,
    network_recipe,
    simulate,
    write_truth,
)
from solmap.tasks.network.report import report_quality

TRUTH_CELL_M = 0.08
WORKERS = 2
TRUTH = "truth.json"
PIPELINE = "default"
"""Pipeline with which a simulated mission is adjusted and drawn."""


def write_downlink(out_dir: Path, params: WorldParams, seed: int) -> int:
    """Simulate a rover's downlink into a folder; returns the number of files.

    Raises:
        PhotogrammetryError: the folder holds something else.
    """
    world = make_world(params, seed)
    texts = text_files(world)
    _refuse_another_world(out_dir, texts)
    for file in texts:
        _write(out_dir, file)
    jobs = render_jobs(world)
    with ThreadPoolExecutor(WORKERS) as pool:
        done = pool.map(partial(_render, world, out_dir), jobs)
        for number, _ in enumerate(done, 1):
            report("render images", number, len(jobs))
    _write_true_terrain(world, out_dir / "truth" / "dtm.tif")
    _write_orbital(world, out_dir)
    return len(texts) + len(jobs) + 3


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


def _write_orbital(world: World, out_dir: Path) -> None:
    """The orbital image, and the error of its georeference, in the form of `rendered_husband`."""
    path = out_dir / "orbital" / "orbital.tif"
    if path.exists():
        return
    mosaic = orbital_mosaic(world)
    error = json.dumps({"georeference_error": asdict(mosaic.error)}, indent=1)
    _write(out_dir, DownlinkFile("truth/orbital.json", error.encode()))
    path.parent.mkdir(exist_ok=True)
    draft = path.with_name("draft.tif")
    landing = landing_site(world.stops[0].id.mission).landing
    write_orthophoto(draft, mosaic.grid, mosaic.brightness, local_crs(landing))
    draft.replace(path)


@flow(name="simulate-mission", flow_run_name="{seed}")
@beside_runs
def simulate_into(store: Path, plan: MissionPlan, seed: int) -> str:
    """Simulate a mission and publish it; returns one line on its content.

    Raises:
        PhotogrammetryError: the store holds another mission.
    """
    workspace = open_workspace(store)
    config = load_pipeline(PIPELINE)
    params = SimulationParams(plan, seed, config.adjustment)
    _refuse_other_missions(workspace, network_recipe(params).ref)
    mission = simulate(params)
    keep_labels(mission, plan, workspace, lambda done, count: report("keep labels", done, count))
    network = adjust_simulated(mission, params, workspace)
    write_truth(mission, workspace.store.root / TRUTH)
    _publish(network, workspace)
    ties = len(mission.truth.points)
    images = 2 * len(mission.network.pairs)
    return (
        f"{plan.stops} stops, {images} images, {ties} ties, {mission.along_m[-1]:.0f} m; "
        f"{len(mission.untied)} drives without ties"
    )


def _publish(network: ProductRef, workspace: Workspace) -> None:
    site = landing_site(MISSION, Settings().landing_sites)
    quality = report_quality(network, (), load_pipeline(PIPELINE).quality, workspace.store)
    entry = MissionEntry(MISSION, f"{site.title} (simulated)", site.landing, None)
    done = Outcome.now(network.scope.name, ("simulated: there are no images",))
    publish(entry, [], [network, *quality], [done], workspace).check()
    failed: dict[str, str] = {}
    draw_mission(MISSION, network, workspace, PIPELINE, failed)
    if failed:
        raise ProductError("; ".join(f"{what}: {cause}" for what, cause in failed.items()))


def _refuse_other_missions(workspace: Workspace, network: ProductRef) -> None:
    """A store has one mission of each name: simulated data must not mix with other data."""
    images = workspace.catalogue.images(MISSION)
    others = [one for one in workspace.catalogue.pointers(ProductKind.NETWORK) if one != network]
    if others or any(NO_PIXELS not in image.notes for image in images):
        raise PhotogrammetryError(
            f"{workspace.store.root} holds another mission {MISSION}, with {len(images)} images: "
            "a simulated one must not mix with it; name an empty store"
        )
