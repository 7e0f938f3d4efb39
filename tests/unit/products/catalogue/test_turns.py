"""Turns hold between processes and machines, and end with the process that has them."""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from solmap.products.catalogue.maintenance.pruning import (
    PruningParams,
    UnreferencedProduct,
    prune,
)
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import StoreBusyError

_HOLD = """
import sys
from pathlib import Path
from solmap.products.catalogue.workspace import Workspace
workspace = Workspace.open(Path(sys.argv[1]), sys.argv[3] or None)
turn, *arguments = sys.argv[2].split()
with getattr(workspace, turn)(*arguments):
    print("held", flush=True)
    sys.stdin.readline()
"""


@contextmanager
def holding(root: Path, turn: str, url: str | None) -> Iterator[subprocess.Popen[str]]:
    """Another process that has a turn until it is killed."""
    command = [sys.executable, "-c", _HOLD, str(root), turn, url or ""]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture(params=["one folder", "two folders"])
def places(request, tmp_path, catalogue_url) -> tuple[Path, Path, str | None]:
    """The folders of two processes, and their catalogue; machines share PostgreSQL only."""
    if request.param == "one folder":
        return tmp_path / "store", tmp_path / "store", catalogue_url
    if catalogue_url is None:
        pytest.skip("a catalogue in SQLite is in one folder")
    return tmp_path / "store", tmp_path / "other", catalogue_url


def test_pruning_is_refused_during_a_run_of_another_process_until_that_is_killed(places):
    mine, other, url = places
    workspace = Workspace.open(mine, url)
    with holding(other, "run_turn", url) as run:
        with pytest.raises(StoreBusyError, match=r"is using .*: prune when it has ended"):
            prune(workspace, PruningParams())
        with workspace.run_turn():
            pass  # beside it
        run.kill()
        assert _pruned_within(30.0, workspace) == []


def _pruned_within(seconds: float, workspace: Workspace) -> list[UnreferencedProduct]:
    """What pruning deletes as soon as it is let in: a server sees a client's end a moment later."""
    end = time.monotonic() + seconds
    while True:
        try:
            return prune(workspace, PruningParams())
        except StoreBusyError:
            if time.monotonic() > end:
                raise
            time.sleep(0.02)


@pytest.mark.parametrize("turn", ["maintenance_turn prune", "exclusive_mission MER2"])
def test_a_waiting_process_gets_the_lock_when_the_holder_is_killed(places, turn):
    mine, other, url = places
    workspace, waited, done = Workspace.open(mine, url), threading.Event(), threading.Event()

    def work() -> None:
        mission = "mission" in turn
        mine = (
            workspace.exclusive_mission("MER2", waited.set)
            if mission
            else workspace.run_turn(waited.set)
        )
        with mine:
            done.set()

    with holding(other, turn, url) as process:
        with workspace.exclusive_mission("MER1"):
            pass  # another mission
        thread = threading.Thread(target=work)
        thread.start()
        assert waited.wait(30.0)
        assert not done.wait(0.2)
        process.kill()
        assert done.wait(30.0)
        thread.join()


def test_a_lock_is_free_after_its_block(places):
    mine, other, url = places
    workspace, beside = Workspace.open(mine, url), Workspace.open(other, url)
    for _ in range(2):
        with (
            workspace.maintenance_turn("prune"),
            pytest.raises(StoreBusyError),
            beside.maintenance_turn("prune"),
        ):
            pass
        with workspace.run_turn(), beside.run_turn():
            pass
