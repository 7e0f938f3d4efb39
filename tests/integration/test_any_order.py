"""Folders in any order end in the same published set, and no delivery withdraws a map."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from solmap.photogrammetry.archive.tables.vector_files import (
    VectorFile,
    parse_vector_file,
    vector_text,
)
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind
from solmap.tasks.images.ingest import ingest_downlink
from tests.support.disorder import differences
from tests.support.small_downlink import FEW_LAYERS, write_coarse_pipeline, write_small_downlink
from tests.support.store_checks import Contents, faults

ORDERS = 25
processed = pytest.mark.usefixtures("engine")


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two sols of site 10, two of site 11, and what ties site 10 to the lander and 11 to 10.

    Both vector files have the same name, as the master files of a mission.
    """
    root = tmp_path_factory.mktemp("folders")
    downlink = write_small_downlink(root / "whole", stops=4, pairs=1)
    (svf,) = downlink.rglob("*.svf")
    file = parse_vector_file(svf.read_text(), svf.name)
    made = []
    for number, sols in enumerate(("155", "156", "15[78]")):
        folder = root / f"images{number}"
        folder.mkdir()
        for image in downlink.rglob(f"sol0{sols}/*/*.img"):
            shutil.copy(image, folder)
        made.append(folder)
    for solution in file.solutions:
        folder = root / f"site{solution.counter[0]}"
        folder.mkdir()
        part = VectorFile(file.source, file.mission, file.kind, file.priority, (solution,))
        (folder / svf.name).write_text(vector_text(part))
        made.append(folder)
    return made


def orders(count: int, folders: Sequence[Path]) -> Iterator[list[Path]]:
    rng = np.random.default_rng(19)
    for _ in range(count):
        yield [folders[k] for k in rng.permutation(len(folders))]


def deliver(
    order: Sequence[Path], root: Path, pipeline: str
) -> Iterator[tuple[dict[str, str], list[str]]]:
    """The map of every terrain model after each delivery, and what the run failed with."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    for folder in order:
        report = process_downlink(folder, root, pipeline)
        layers = Workspace.open(root).catalogue.layers(kinds=[ProductKind.DTM])
        yield {layer.ref.scope.name: layer.mission for layer in layers}, report.failures


def test_images_are_on_the_same_maps_after_any_order(tmp_path, folders):
    """Without processing: which images are pairs, on which map, placed how."""
    from solmap.flows.sol_inputs import assign_maps, read_maps  # noqa: PLC0415 - imports Prefect

    found = set()
    for number, order in enumerate(orders(8, folders)):
        workspace = Workspace.open(tmp_path / str(number))
        for folder in order:
            ingest_downlink.fn(folder, workspace)
            assign_maps("MER2", workspace)
        maps = read_maps("MER2", workspace)
        poses = [
            (name, one.stop, one.sols, *one.lsl_from_rover.translation_m.tolist())
            for name, here in maps.items()
            for one in here.telemetry.stops
        ]
        rows = [(e.id, e.mission, e.partner) for e in workspace.catalogue.images()]
        found.add(repr((poses, rows)))
    assert len(found) == 1
    assert "ORIGIN" not in found.pop()


@pytest.mark.slow
@processed
@pytest.mark.parametrize("is_tied", [True, False])
def test_fifty_orders_of_deliveries_publish_two_sets(tmp_path, folders, is_tied):
    """Half of them without what joins site 11 to site 10: then that stays on a map of its own."""
    chosen = folders if is_tied else folders[:-1]
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml", FEW_LAYERS))
    first = tmp_path / "first"
    *_, (maps, failures) = deliver(chosen, first, pipeline)
    assert failures == []
    assert set(maps.values()) == ({"MER2"} if is_tied else {"MER2", "MER2-ORIGIN11"})
    expected = Contents.of(first)
    for number, order in enumerate(orders(ORDERS, chosen)):
        root = tmp_path / str(number)
        root.mkdir()  # products that were made before are looked up
        shutil.copytree(first / "products", root / "products", copy_function=os.link)
        known: set[str] = set()
        for maps, failures in deliver(order, root, pipeline):
            assert failures == []
            assert known <= maps.keys()
            known |= maps.keys()
        assert differences(expected, Contents.of(root)) == [], [folder.name for folder in order]
        assert faults(root) == []
        shutil.rmtree(root)


REAL = {
    "spirit 1869": "mer_spirit_sol1869_troy/*effb*.img",
    "spirit 1869, other levels": "mer_spirit_sol1869_troy/*938r*.img",
    "spirit 1900": "mer_spirit_sol1900/*.img",
    "vector files": "traverse/mer_spirit/mer2_master.svf",
    "opportunity": "mer_opportunity_sol4084_4090/*9[49]*N*.IMG",
    "opportunity's front": "mer_opportunity_single_frames/1F*.IMG",
}


@pytest.mark.slow
@processed
def test_real_frames_in_any_order_publish_one_set(tmp_path, shared_data):
    folders = []
    for name, pattern in REAL.items():
        folder = tmp_path / "folders" / name
        folder.mkdir(parents=True)
        for file in shared_data.glob(pattern):
            shutil.copy(file, folder)
        folders.append(folder)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml", FEW_LAYERS))
    found: list[Contents] = []
    for number, order in enumerate(orders(4, folders)):
        root = tmp_path / str(number)
        for _, failures in deliver(order, root, pipeline):
            assert failures == []
        found.append(Contents.of(root))
        assert differences(found[0], found[-1]) == [], [folder.name for folder in order]
    assert set(found[0].rows["missions"]) == {"MER2", "MER1-ORIGIN194", "MER1-ORIGIN195"}
