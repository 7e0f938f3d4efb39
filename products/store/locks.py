"""Locks between the processes of a store: changes of a mission, runs, and pruning.

They are locks of the kernel (flock), which it releases when the holding process ends in any way.
Runs share one lock; pruning, migration, repair and restoring take it alone. Where several machines
share a catalogue, `products.catalogue.turns` adds locks of its database.
"""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from solmap.products.errors import StoreReadOnlyError
from solmap.products.store.faults import is_read_only, require_writable


@contextmanager
def exclusive_lock(
    root: Path, name: str, on_wait: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Hold the lock `name` in the store at `root`; wait while another process holds it.

    Args:
        root: Folder of the store.
        name: The subject of changes, like a mission.
        on_wait: Called once before waiting.

    Raises:
        StoreReadOnlyError: the store is read-only.
    """
    with _opened(root / "locks" / f"{name.lower()}.lock") as file:
        _wait_for(file, fcntl.LOCK_EX, on_wait)
        yield


@contextmanager
def shared_run_lock(root: Path, on_wait: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Share the lock of runs with other runs: nothing is pruned meanwhile. Waits for a pruning."""
    with _opened(run_lock_path(root)) as file:
        _wait_for(file, fcntl.LOCK_SH, on_wait)
        yield


def run_lock_path(root: Path) -> Path:
    """The lock file that runs share and that pruning holds exclusively."""
    return root / "locks" / "runs.lock"


@contextmanager
def try_lock(path: Path) -> Iterator[bool]:
    """Lock the file at `path` exclusively if it is free; returns whether it was. Never waits."""
    with _opened(path) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield False
        else:
            yield True


def _opened(path: Path) -> IO[str]:
    """The lock file, created if missing."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("a")
    except OSError as error:
        require_writable(path.parent.parent)
        if is_read_only(path):
            raise StoreReadOnlyError(
                f"{path} cannot be locked ({error.strerror}): it belongs to another user"
            ) from error
        raise


def _wait_for(file: IO[str], kind: int, on_wait: Callable[[], None]) -> None:
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except OSError:
        on_wait()
        fcntl.flock(file, kind)
