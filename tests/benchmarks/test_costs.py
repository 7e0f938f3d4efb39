"""Processor time of parts of a run, as ratios to bare library calls in the same process or run."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.terrain.relief.slope import HillshadeParams, hillshade
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.archives import write_archive
from tests.support.bowl_store import fill

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
