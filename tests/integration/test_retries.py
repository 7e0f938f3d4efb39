"""Stages under Prefect's engine: what can pass is tried again, what cannot is not."""

import errno
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from solmap.photogrammetry.errors import MatchingError
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import StoreFullError
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from tests.support.small_downlink import write_coarse_pipeline, write_small_downlink
from tests.support.store_checks import faults

pytestmark = pytest.mark.usefixtures("engine")
RECIPE = Recipe(ProductKind.SLOPE, Scope(ScopeLevel.STOP, "mer2-site0001-drive0002"))


@pytest.fixture
def store(tmp_path: Path) -> ProductStore:
    return ProductStore.open(tmp_path / "store")


@pytest.fixture
def failing_disk(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A disk that answers `fsync` with the errors in the list, one after the other, then works."""
    errors: list[int] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        if errors:
            raise OSError(errors[0], os.strerror(errors.pop(0)))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    return errors


def test_a_stage_is_retried_until_the_disk_works(
    store: ProductStore, failing_disk: list[int]
) -> None:
    failing_disk.extend([errno.EIO, errno.ESTALE])
    attempts: list[int] = []

    assert run(store, attempts, lambda path: path.write_text("whole")) == RECIPE.ref
    assert len(attempts) == 3
    assert store.path(RECIPE.ref).read_text() == "whole"
    assert not list((store.root / "drafts").iterdir())


def test_a_pair_without_texture_is_matched_once(store: ProductStore) -> None:
    attempts: list[int] = []

    def write(_path: Path) -> None:
        raise MatchingError("no texture")

    with pytest.raises(MatchingError, match="no texture"):
        run(store, attempts, write)
    assert len(attempts) == 1


def test_a_full_disk_is_not_retried(store: ProductStore, failing_disk: list[int]) -> None:
    failing_disk.append(errno.ENOSPC)
    attempts: list[int] = []

    with pytest.raises(StoreFullError, match="free some space and run again"):
        run(store, attempts, lambda path: path.write_text("whole"))
    assert len(attempts) == 1
    assert not store.has(RECIPE.ref)


def test_a_disk_that_stays_away_is_given_up(store: ProductStore, failing_disk: list[int]) -> None:
    from solmap.tasks.stage import RETRIES  # noqa: PLC0415 - after the engine's settings

    failing_disk.extend([errno.EIO] * 50)
    attempts: list[int] = []

    with pytest.raises(OSError, match="Input/output error"):
        run(store, attempts, lambda path: path.write_text("whole"))
    assert len(attempts) == RETRIES + 1


def run(store: ProductStore, attempts: list[int], write: Callable[[Path], object]) -> ProductRef:
    """Make the product in a stage of a flow, without the pauses."""
    from prefect import flow  # noqa: PLC0415 - after the engine's settings

    from solmap.tasks.stage import stage  # noqa: PLC0415

    @stage(task_run_name="slope-{name}", makes_products=False)
    def make(name: str) -> ProductRef:  # noqa: ARG001 - names the run
        attempts.append(1)
        return store.make(RECIPE, write)

    @flow(name="retries")
    def make_it() -> ProductRef:
        return make.with_options(retry_delay_seconds=0).submit("a").result()

    return make_it()


@pytest.mark.slow
def test_a_broken_pair_and_a_broken_sol_are_reported_and_the_rest_continues(
    tmp_path: Path,
) -> None:
    from solmap.flows.cli.tables import outcome_rows  # noqa: PLC0415
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    downlink = write_small_downlink(tmp_path / "downlink", pairs=2)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml"))
    store = tmp_path / "store"
    pair = min(file.name for file in (downlink / "sol0156").rglob("*l0m1.img"))
    pair_id = pair.removesuffix(".img")
    broken = [store / "products/network/mer2-sol0155", store / "products/matches" / pair_id]
    for place in broken:  # a file where a folder should be: no product can be kept there
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text("")

    report = process_downlink(downlink, store, pipeline)
    rows = {row["subject"]: row for row in outcome_rows(Workspace.open(store))}
    assert [row["ended"] for row in (rows["mer2-sol0155"], rows["mer2-sol0156"])] == ["failed"] * 2
    assert "adjust sol 155: FileExistsError" in " ".join(rows["mer2-sol0155"]["notes"])
    assert f"match {pair_id.upper()}: FileExistsError" in " ".join(rows["mer2-sol0156"]["notes"])
    assert all("FileExistsError" in line for line in report.failures)
    kinds = {str(layer.ref.kind) for layer in Workspace.open(store).catalogue.layers()}
    assert {"dtm", "orthophoto", "stops"} <= kinds
    assert "FileExistsError" in page_of_last_run()

    for place in broken:
        place.unlink()
    again = process_downlink(downlink, store, pipeline)
    assert again.succeeded
    rows = {row["subject"]: row for row in outcome_rows(Workspace.open(store))}
    assert not [row for row in rows.values() if row["ended"] == "failed"]


def page_of_last_run() -> str:
    """Text of the page of the last downlink: that of its artifact and of its failed tasks."""
    from prefect.client.orchestration import get_client  # noqa: PLC0415 - after its settings

    requested = {"artifacts": {"key": {"any_": ["downlink"]}}, "sort": "CREATED_DESC", "limit": 1}
    with get_client(sync_client=True) as client:
        (artifact,) = client.request("POST", "/artifacts/filter", json=requested).json()
        requested = {"task_runs": {"state": {"type": {"any_": ["FAILED"]}}}}  # others send nulls
        failed = client.request("POST", "/task_runs/filter", json=requested).json()
    reported = {run["name"].split("-")[0]: str(run["state"]["message"]) for run in failed}
    assert "FileExistsError" in reported["adjust"]
    assert "FileExistsError" in reported["match"]
    return str(artifact["data"])


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk with room for half of what a stop of thumbnails gives."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no disk may be mounted here: it takes the rights of the super-user")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)  # noqa: S607


@pytest.mark.slow
def test_a_full_disk_stops_a_run_and_keeps_its_products(small_disk: Path, tmp_path: Path) -> None:
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    downlink = write_small_downlink(tmp_path / "downlink", stops=1, pairs=2)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml"))
    store = small_disk / "store"
    with pytest.raises(StoreFullError, match=r"the disk is full while .*free some space"):
        process_downlink(downlink, store, pipeline)
    assert not list((store / "drafts").iterdir())
    kept = set((store / "products").rglob("*.*"))
    assert kept
    assert faults(store) == []

    subprocess.run(
        ["mount", "-o", "remount,size=60m", str(small_disk)],  # noqa: S607
        check=True,
    )
    assert process_downlink(downlink, store, pipeline).succeeded
    assert kept <= set((store / "products").rglob("*.*"))
    assert faults(store) == []
