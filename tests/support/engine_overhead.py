"""Stages that hardly do anything, to see what an engine costs.

`python -m tests.support.engine_overhead 2` prints milliseconds a task on two threads and on that
many worker processes of Dask, submitted as a sol's tasks are.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

from solmap.flows.runtime.engine import start_engine

TASKS = 40


def stages() -> dict[str, Any]:
    """Stages to try an engine with; made here because Prefect reads its settings at import."""
    from solmap.products.errors import ProductError, StoreFullError  # noqa: PLC0415
    from solmap.products.model import ProductKind, ProductRef, Scope, ScopeLevel  # noqa: PLC0415
    from solmap.products.store.product_store import ProductStore  # noqa: PLC0415
    from solmap.tasks.stage import stage  # noqa: PLC0415

    @stage(task_run_name="nothing", makes_products=False)
    def nothing(number: int, store: ProductStore) -> tuple[int, int, str]:
        return number, os.getpid(), store.root.name

    @stage(task_run_name="broken", makes_products=False)
    def broken(number: int, store: ProductStore) -> int:
        store.path(ProductRef(ProductKind.DTM, Scope(ScopeLevel.STOP, f"stop{number}"), "0" * 16))
        raise ProductError("found")

    @stage(task_run_name="full", makes_products=False)
    def full() -> int:
        raise StoreFullError("the disk is full")

    @stage(task_run_name="kill", makes_products=False)
    def kill() -> int:
        os.kill(os.getpid(), signal.SIGKILL)
        return 0

    return {"nothing": nothing, "broken": broken, "full": full, "kill": kill}


def run_on(engine: str, body: Callable[[], Any], workers: int = 2) -> Any:
    """What `body` gives in a flow whose tasks run on an engine."""
    from prefect import flow  # noqa: PLC0415

    from solmap.flows.runtime.runners import on_workers  # noqa: PLC0415

    os.environ["SOLMAP_TASK_RUNNER"], os.environ["SOLMAP_TASK_WORKERS"] = engine, str(workers)
    try:
        return on_workers(flow(body, name=f"on {engine}"))()
    finally:
        del os.environ["SOLMAP_TASK_RUNNER"], os.environ["SOLMAP_TASK_WORKERS"]


def main() -> None:
    """Time stages that do nothing, after some that warm the engine up."""
    parser = argparse.ArgumentParser(prog="engine_overhead", description=__doc__)
    parser.add_argument("workers", type=int)
    parser.add_argument("--tasks", type=int, default=TASKS)
    parser.add_argument("--engine", choices=["threads", "dask"], action="append")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        start_engine(Path(folder))
        from solmap.flows.runtime.failures import wait_for  # noqa: PLC0415
        from solmap.products.store.product_store import ProductStore  # noqa: PLC0415

        store, nothing = ProductStore.open(Path(folder)), stages()["nothing"]

        def timed() -> tuple[float, float, float]:
            wait_for("warm", {k: nothing.submit(k, store) for k in range(8)})
            started, own, theirs = time.perf_counter(), time.process_time(), _of_workers()
            wait_for("timed", {k: nothing.submit(k, store) for k in range(arguments.tasks)})
            ended = time.perf_counter(), time.process_time(), _of_workers()
            return ended[0] - started, ended[1] - own, ended[2] - theirs

        for engine in arguments.engine or ("threads", "dask"):
            workers = arguments.workers if engine == "dask" else 2
            spent = (1000 * s / arguments.tasks for s in run_on(engine, timed, workers))
            wall, own, theirs = spent
            message = f"{wall:.1f} ms a task; processor: {own:.1f} ms here, {theirs:.1f} of workers"
            sys.stdout.write(f"{engine} {workers}: {message}\n")
            sys.stdout.flush()


def _of_workers() -> float:
    """Seconds of processor that Dask's workers have spent."""
    below = psutil.Process().children(recursive=True)
    times = [one.cpu_times() for one in below if "spawn_main" in " ".join(one.cmdline())]
    return sum(one.user + one.system for one in times)


if __name__ == "__main__":
    main()
