"""A whole run and the engine's part of it, as ratios to a peer beside it.

`pytest tests/benchmarks/test_runs.py --benchmark-only`; processor time, memory and the time to the
first map are in the columns of further figures.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import pytest

from solmap.photogrammetry.stretching import stretch
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import pairs_of, read_epipolar
from tests.support.engine_overhead import run_on, stages
from tests.support.mission_growth import walked
from tests.support.simulated_sols import SimulatedSols

NEW = (156,)
"""The sol that is processed."""
STOPS = 40
TASKS = 100


@pytest.mark.parametrize("earlier", [(), (155,)], ids=["alone", "after an earlier one"])
def test_a_stop_against_opencvs_matching_of_its_pairs(benchmark, husband, tmp_path: Path, earlier):
    store = tmp_path / "store"
    for sol in earlier:
        process(navcam(husband, sol, tmp_path), store)
    downlink = navcam(husband, NEW[0], tmp_path)
    began = time.time()
    used = benchmark.pedantic(process, args=(downlink, store), rounds=1)
    processor_s, workspace = used.ru_utime + used.ru_stime, Workspace.open(store)
    made = [
        datetime.fromisoformat(workspace.store.made_at(layer.ref)).timestamp()
        for layer in workspace.catalogue.layers("MER2", {ProductKind.DTM, ProductKind.ORTHOPHOTO})
        if layer.sols == NEW
    ]
    pairs = [
        read_epipolar(pair, None, workspace.store)
        for pair in pairs_of(workspace.catalogue.images("MER2", sol=NEW[0]))
    ]
    matcher = cv2.StereoSGBM.create(0, 208, 5, P1=200, P2=800)
    before = time.process_time()
    for images in pairs:
        left, right = (
            stretch(images.left, images.left_mask),
            stretch(images.right, images.right_mask),
        )
        matcher.compute(left, right)
    opencv_s = time.process_time() - before
    benchmark.extra_info["processor s"] = round(processor_s, 1)
    benchmark.extra_info["peak MB"] = round(used.ru_maxrss * 1024 / 1e6)
    benchmark.extra_info["s to terrain model and orthophoto"] = round(max(made) - began)
    benchmark.extra_info["times OpenCV's matching"] = round(processor_s / opencv_s, 1)


def navcam(husband: Path, sol: int, folder: Path) -> Path:
    """The Navcam images of a sol in a folder of their own, with the tables of poses."""
    downlink = folder / f"sol{sol}"
    downlink.mkdir()
    for file in (*(husband / f"sol0{sol}").rglob("2n*"), *(husband / "masters").iterdir()):
        shutil.copy(file, downlink)
    return downlink


def process(downlink: Path, store: Path) -> resource.struct_rusage:
    """Process a downlink in a process of its own; what that used."""
    command = (sys.executable, "-m", "solmap.flows.cli", "run", str(downlink))
    kept = {name: text for name, text in os.environ.items() if not name.startswith("PREFECT_")}
    child = subprocess.Popen((*command, "--store", str(store)), env=kept, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    assert child.returncode == 0
    return used


def test_layers_of_a_mission_with_a_new_sol_against_drawing_all_again(
    benchmark,
    engine: None,  # noqa: ARG001
    tmp_path: Path,
):
    from solmap.flows.mission import draw_mission  # noqa: PLC0415 - reads the settings of the engine

    def draw(standing: Any, root: Path) -> float:
        workspace, failed = Workspace.open(root), dict[str, str]()

        def body() -> float:
            before = time.process_time()
            draw_mission("MER2", standing.network, workspace, "default", failed)
            return time.process_time() - before

        processor_s = run_on("threads", body)
        assert not failed
        return processor_s

    sols = SimulatedSols.of(STOPS, pairs_per_stop=4, inter_ties=400, intra_ties=400)
    root = tmp_path / "updated"
    *_, (standing, _) = walked(sols, STOPS - 1, root)
    draw(standing, root)
    *_, (standing, _) = walked(sols, STOPS, root)
    shutil.copytree(root, tmp_path / "withdrawn")
    bare = Workspace.open(tmp_path / "withdrawn").catalogue
    bare.withdraw(bare.layers("MER2"))
    updated_s = benchmark.pedantic(draw, args=(standing, root), rounds=1)
    benchmark.extra_info["processor s"] = round(updated_s, 2)
    benchmark.extra_info["over all again"] = round(
        updated_s / draw(standing, tmp_path / "withdrawn"), 2
    )


def test_a_stage_against_an_empty_task_of_prefect(benchmark, engine: None, tmp_path: Path):  # noqa: ARG001
    from prefect import task  # noqa: PLC0415 - reads the settings of the engine

    from solmap.flows.runtime.failures import wait_for  # noqa: PLC0415

    store, nothing = ProductStore.open(tmp_path), stages()["nothing"]
    empty = task(lambda number, _: number, name="empty")

    def processor_s(one) -> float:
        def body() -> float:
            wait_for("warm", {k: one.submit(k, store) for k in range(8)})
            before = time.process_time()
            wait_for("timed", {k: one.submit(k, store) for k in range(TASKS)})
            return time.process_time() - before

        return run_on("threads", body)

    own_s = benchmark.pedantic(lambda: processor_s(nothing), rounds=1)
    peer_s = processor_s(empty)
    benchmark.extra_info["processor ms a task"] = round(1000 * own_s / TASKS, 2)
    benchmark.extra_info["times an empty task"] = round(own_s / peer_s, 2)
