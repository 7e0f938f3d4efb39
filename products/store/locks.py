"""Locks between the processes of a store: who changes a mission, who makes products, who prunes.

They are locks of the kernel (flock), which it releases when the holding process ends, however it
ends. Runs share one lock and pruning takes it alone.
"""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def exclusive_lock(
    root: Path, name: str, on_wait: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Hold the lock called `name` in the store at `root`; wait while another process holds it.

    Args:
        root: Folder of the store.
        name: What is changed, like a mission.
        on_wait: Called once before waiting.
    """
    folder = root / "locks"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / f"{name.lower()}.lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            on_wait()
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextmanager
def shared_run_lock(root: Path) -> Iterator[None]:
    """Hold the lock of runs, with other runs: nothing is pruned meanwhile. Waits for a pruning."""
    file = run_lock_path(root)
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as opened:
        fcntl.flock(opened, fcntl.LOCK_SH)
        yield


def run_lock_path(root: Path) -> Path:
    """The lock file that runs share and that pruning takes alone."""
    return root / "locks" / "runs.lock"


@contextmanager
def try_lock(path: Path) -> Iterator[bool]:
    """Take the lock file at `path` alone if it is free; whether it was. Never waits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield False
        else:
            yield True
