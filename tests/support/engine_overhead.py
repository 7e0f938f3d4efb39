"""Stages that hardly do anything, to see what an engine costs.

`python -m tests.support.engine_overhead 2` prints milliseconds a task on threads and on that many
worker processes of Dask, submitted as a sol's tasks are.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flows.engine_server import start_engine

TASKS = 40


def stages() -> dict[str, Any]:
    """Stages to try an engine with; made here because Prefect reads its settings at import."""
    from products.errors import ProductError, StoreFullError  # noqa: PLC0415
    from products.model import ProductKind, ProductRef, Scope, ScopeLevel  # noqa: PLC0415
    from products.store import ProductStore  # noqa: PLC0415
    from tasks.stage import stage  # noqa: PLC0415

    @stage(task_run_name="nothing")
    def nothing(number: int, store: ProductStore) -> tuple[int, int, str]:
        return number, os.getpid(), store.root.name

    @stage(task_run_name="broken")
    def broken(number: int, store: ProductStore) -> int:
        store.path(ProductRef(ProductKind.DTM, Scope(ScopeLevel.STOP, f"stop{number}"), "0" * 16))
        raise ProductError("found")

    @stage(task_run_name="full")
    def full() -> int:
        raise StoreFullError("the disk is full")

    @stage(task_run_name="kill")
    def kill() -> int:
        os.kill(os.getpid(), signal.SIGKILL)
        return 0

    return {"nothing": nothing, "broken": broken, "full": full, "kill": kill}


def run_on(engine: str, body: Callable[[], Any], workers: int = 2) -> Any:
    """What `body` gives in a flow whose tasks run on an engine."""
    from prefect import flow  # noqa: PLC0415

    from flows.runners import on_workers  # noqa: PLC0415

    os.environ["SOLMAP_TASK_RUNNER"], os.environ["SOLMAP_TASK_WORKERS"] = engine, str(workers)
    try:
        return on_workers(flow(body, name=f"on {engine}"))()
    finally:
        del os.environ["SOLMAP_TASK_RUNNER"], os.environ["SOLMAP_TASK_WORKERS"]


def main() -> None:
    """Time stages that do nothing, after some that warm the engine up."""
    with tempfile.TemporaryDirectory() as folder:
        start_engine(Path(folder))
        from flows.outcomes import settled  # noqa: PLC0415
        from products.store import ProductStore  # noqa: PLC0415

        store, nothing = ProductStore.open(Path(folder)), stages()["nothing"]

        def timed() -> tuple[float, float]:
            settled("warm", {k: nothing.submit(k, store) for k in range(8)})
            started, cpu = time.perf_counter(), time.process_time()
            settled("timed", {k: nothing.submit(k, store) for k in range(TASKS)})
            return time.perf_counter() - started, time.process_time() - cpu

        for engine, workers in (("threads", 2), ("dask", int(sys.argv[1]))):
            wall, cpu = (1000 * seconds / TASKS for seconds in run_on(engine, timed, workers))
            said = f"{wall:.1f} ms a task, {cpu:.1f} ms of this process's processor"
            sys.stdout.write(f"{engine} {workers}: {said}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
