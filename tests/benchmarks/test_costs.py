"""Processor time of parts of a run, as ratios to bare library calls in the same process or run."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from fastapi.testclient import TestClient
from rasterio.shutil import copy as copy_raster
from starlette.applications import Starlette
from starlette.responses import Response
from starlette.routing import Route

from solmap.gis_server.app import create_app
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.relief.slope import HillshadeParams, hillshade
from solmap.products.catalogue.catalogue import Catalogue, MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import local_crs
from solmap.products.formats.documents.archives import write_archive
from solmap.products.formats.raster.raster import read_dtm, write_dtm
from solmap.products.model import Layer, ProductKind, ProductRef, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from tests.support.bowl_store import fill
from tests.support.large_mission import LANDING

COMMANDS = {
    "help": (["--help"], "import typer, rich.table"),
    "positions": (["positions"], "import typer, rich.table, sqlalchemy, pydantic_settings"),
    "refused folder": (["run", "folder"], "import prefect.main"),
}
"""By name: arguments, and what a process that only imports the libraries imports."""


def processor_s(work: Callable[[], object], who: int = resource.RUSAGE_SELF) -> float:
    before = resource.getrusage(who)
    work()
    after = resource.getrusage(who)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_storing_a_parallax_map_against_numpy(benchmark, tmp_path, rng):
    slope = np.add.outer(np.arange(1024), np.arange(1024)) / 16
    parallax = np.rint(128 * (slope + rng.normal(0, 0.1, slope.shape))).astype(np.uint16)
    ours, peer = tmp_path / "ours.npz", tmp_path / "peer.npz"
    benchmark.pedantic(write_archive, args=(ours, {}), kwargs={"parallax": parallax}, rounds=5)
    began = time.perf_counter()
    np.savez_compressed(peer, parallax=parallax)
    benchmark.extra_info["numpy takes times as long"] = round(
        (time.perf_counter() - began) / benchmark.stats["min"], 1
    )
    benchmark.extra_info["size over numpy's"] = round(ours.stat().st_size / peer.stat().st_size, 2)


def test_hillshade_of_a_nearly_empty_region_against_a_gradient_of_all_cells(benchmark, rng):
    elevation = np.full((4096, 4096), np.nan, np.float32)
    elevation[1000:1800, 2000:3000] = rng.normal(0, 0.01, (800, 1000))
    benchmark.pedantic(hillshade, args=(elevation, 0.04, HillshadeParams()), rounds=3)
    began = time.perf_counter()
    for along in ((1, 0), (0, 1)):
        cv2.Sobel(elevation, cv2.CV_32F, *along)
    benchmark.extra_info["OpenCV's gradient takes times as long"] = round(
        (time.perf_counter() - began) / benchmark.stats["min"], 2
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_starting_a_command_against_importing_its_libraries(benchmark, tmp_path: Path, name: str):
    arguments, libraries = COMMANDS[name]
    fill(Workspace.open(tmp_path / "store"))
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "notes.img").write_text("no image\n")
    environment = {**os.environ, "SOLMAP_STORE": str(tmp_path / "store")}

    def run(*command: str) -> Callable[[], object]:
        return lambda: subprocess.run(
            (sys.executable, *command),
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            check=False,
        )

    children = resource.RUSAGE_CHILDREN
    command = run("-m", "solmap.flows.cli", *arguments)
    own = min(processor_s(command, children) for _ in range(2))
    peer = min(processor_s(run("-c", libraries), children) for _ in range(2))
    benchmark.pedantic(command, rounds=1)
    benchmark.extra_info["processor s"] = round(own, 2)
    benchmark.extra_info["times the libraries alone"] = round(own / peer, 2)


@pytest.fixture(scope="module")
def stored(tmp_path_factory) -> Path:
    """A folder with the terrain model of a stop, as large as a Navcam's."""
    folder = tmp_path_factory.mktemp("stored")
    grid = MapGrid(0.0, 80.0, 0.04, 2048, 1792)
    rng = np.random.default_rng(1)
    elevation = rng.normal(0, 0.01, grid.shape).cumsum(axis=0).astype(np.float32)
    elevation[:600] = np.nan
    sigma = np.where(np.isfinite(elevation), np.float32(0.02), np.float32(np.nan))
    count = rng.integers(1, 9, grid.shape).astype(np.float32)
    ground = np.full(grid.shape, GroundClass.MEASURED, np.uint8)
    dtm = Dtm(grid, elevation, sigma, count, ground, sigma / 2)
    write_dtm(folder / "dtm.tif", dtm, local_crs(LANDING))
    return folder


def test_reading_a_terrain_model_against_gdal(benchmark, stored):
    path = stored / "dtm.tif"
    benchmark.pedantic(read_dtm, args=(path,), rounds=5, warmup_rounds=1)

    def bare() -> None:
        with rasterio.open(path) as file:
            file.read()

    bare_s = min(processor_s(bare) for _ in range(5))
    own_s = min(processor_s(lambda: read_dtm(path)) for _ in range(5))
    benchmark.extra_info["times GDAL alone"] = round(own_s / bare_s, 2)


def test_writing_a_terrain_model_against_the_driver_alone(benchmark, stored):
    dtm, own, peer = read_dtm(stored / "dtm.tif"), stored / "own.tif", stored / "peer.tif"
    with rasterio.open(stored / "dtm.tif") as file:
        profile, bands = {**file.profile, "driver": "GTiff", "compress": None}, file.read()
    with rasterio.open(peer.with_suffix(".draft"), "w", **profile) as file:
        file.write(bands)
    options = {"COMPRESS": "DEFLATE", "LEVEL": 1, "PREDICTOR": "FLOATING_POINT", "BLOCKSIZE": 256}

    def driver_alone() -> None:
        copy_raster(peer.with_suffix(".draft"), peer, driver="COG", **options)

    write = partial(write_dtm, own, dtm, local_crs(LANDING))
    benchmark.pedantic(write, rounds=3)
    own_s, peer_s = (min(processor_s(work) for _ in range(3)) for work in (write, driver_alone))
    benchmark.extra_info["times the driver alone"] = round(own_s / peer_s, 2)


def test_the_first_answer_of_a_server_against_an_empty_application(benchmark, tmp_path):
    fill(Workspace.open(tmp_path / "store"))

    def first_s(application: Any, path: str) -> float:
        with TestClient(application) as client:
            return processor_s(lambda: client.get(path).raise_for_status())

    def empty() -> Starlette:
        return Starlette(routes=[Route("/", lambda _: Response("x" * 50_000))])

    def own() -> float:
        return first_s(create_app(tmp_path / "store"), "/api/start")

    own_s = [benchmark.pedantic(own, rounds=1), *(own() for _ in range(2))]
    benchmark.extra_info["processor ms"] = round(1000 * min(own_s), 1)
    peer_s = min(first_s(empty(), "/") for _ in range(3))
    benchmark.extra_info["times an empty application"] = round(min(own_s) / peer_s, 1)


def test_a_page_of_15000_layers_against_encoding_it(benchmark, tmp_path):
    root = tmp_path / "store"
    ProductStore.open(root)
    layers = [
        Layer(
            ProductRef(kind, Scope(ScopeLevel.STOP, f"mer2-site0001-drive{k:04d}"), f"{k:016x}"),
            "MER2", str(kind), "vector", (5.0 * k, -10.0, 5.0 * k + 4.0, 10.0),
            None, None, None, (k,), "2026-01-01T00:00:00Z",
        )
        for k in range(500)
        for kind in sorted(ProductKind)[:30]
    ]  # fmt: skip
    mission = MissionEntry("MER2", "500 stops", LANDING, None)
    Catalogue.open(root).publish(missions=[mission], layers=layers)
    with TestClient(create_app(root)) as client:
        addresses = iter(f"/api/missions/MER2/layers?offset={500 * k}" for k in range(1, 25))
        pages = [client.get(next(addresses)).json()]
        page_s = benchmark.pedantic(
            lambda: processor_s(lambda: pages.append(client.get(next(addresses)).json())), rounds=9
        )
    benchmark.extra_info["times json"] = round(
        page_s / processor_s(lambda: json.dumps(pages[-1])), 1
    )
