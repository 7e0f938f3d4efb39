"""Killed at any moment, a store holds whole products only, and a rerun makes the rest."""

import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solmap.products.catalogue.workspace import Workspace
from tests.support.disorder import differences
from tests.support.kill_moments import Moment, Step, Watch
from tests.support.product_keeper import keep_products
from tests.support.store_checks import Contents, faults

ROOT = Path(__file__).resolve().parents[2]
KEEPER = [sys.executable, "-m", "tests.support.product_keeper"]


def test_products_are_whole_after_their_writer_is_killed_repeatedly(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    root = tmp_path / "store"
    Workspace.open(root)
    for _ in range(6):
        before = {file.name for file in (root / "products").rglob("*.tif")}
        keeper = subprocess.Popen([*KEEPER, str(root)], cwd=ROOT)
        with Watch(root) as watch:
            moment = Moment(Step.RENAME, int(rng.integers(1, 40)), float(rng.uniform(0.0, 0.002)))
            assert watch.reaches(moment, lambda one=keeper: one.poll() is None, 60.0)
        keeper.kill()
        assert keeper.wait() == -signal.SIGKILL
        assert faults(root) == []
        after = {file.name for file in (root / "products").rglob("*.tif")}
        assert before <= after
        assert len(after - before) >= moment.after // 2  # its provenance is renamed first
    keep_products(root)
    keep_products(tmp_path / "undisturbed")
    expected = Contents.of(tmp_path / "undisturbed")
    assert expected.differences(Contents.of(root)) == []
    assert not list((root / "drafts").iterdir())


@pytest.fixture(scope="module")
def crash_test(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A downlink and one engine for all flows: forked processes cannot use a later one."""
    from tests.support.crashes import prepared  # noqa: PLC0415 - starts an engine

    with prepared(tmp_path_factory.mktemp("crashes"), seed=1, pairs=2) as test:
        yield test


@pytest.mark.slow
def test_products_are_whole_after_flows_and_servers_are_killed_repeatedly(crash_test: Any) -> None:
    expected, tally = crash_test.undisturbed(), crash_test.tally
    number = 0
    while tally.kills < 12:  # a run may get to its end before its moment comes
        crash_test.disturb_one_store(number, 12, expected)
        number += 1
    assert tally.found == []
    assert tally.answers["whole product"] > 0


@pytest.mark.slow
def test_two_concurrent_downlinks_end_as_two_in_sequence(crash_test: Any, tmp_path: Path) -> None:
    from tests.support.crashes import LONGEST_RUN_S  # noqa: PLC0415 - starts an engine

    expected, whole = crash_test.undisturbed(), crash_test.downlink
    halves = [tmp_path / "first", tmp_path / "second"]
    for half, sol in zip(halves, ("sol0155", "sol0156"), strict=True):
        shutil.copytree(whole / "masters", half / "masters")
        shutil.copytree(whole / sol, half / sol)
    runs = [crash_test.flow(tmp_path / "store", half) for half in halves]
    for run in runs:
        run.join(LONGEST_RUN_S)
    assert [run.exitcode for run in runs] == [0, 0]
    assert faults(tmp_path / "store") == []
    # the later sol may have been published alone before: only what is the latest must agree
    assert differences(expected, Contents.of(tmp_path / "store")) == []
