"""Where the tasks of a flow run: threads of this process, or workers of a Dask cluster.

Inputs and results of tasks are references, parameters and the store's address, a few kilobytes; the
executing process opens the store itself. So workers need no shared memory, only the store.
"""

from __future__ import annotations

import atexit
import os
import sys
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

from prefect.task_runners import ThreadPoolTaskRunner

from solmap.config.records import ConfigError
from solmap.config.settings import Settings, TaskRunnerName

if TYPE_CHECKING:
    from distributed import LocalCluster
    from prefect import Flow
    from prefect.futures import PrefectFuture
    from prefect.task_runners import TaskRunner

    Runner = TaskRunner[PrefectFuture[Any]]

P = ParamSpec("P")
R = TypeVar("R")


def on_workers(flow: Flow[P, R]) -> Flow[P, R]:
    """The flow, its tasks run as set in the settings.

    Raises:
        ConfigError: Dask is set but not installed.
    """
    return flow.with_options(task_runner=_runner(Settings()))


def places() -> int:
    """Number of tasks to submit at a time: one more than there are workers."""
    settings = Settings()
    return sys.maxsize if settings.dask_address else settings.task_workers + 1


def shares_memory() -> bool:
    """Whether tasks run in one process, where one can use what another has prepared."""
    return Settings().task_runner is TaskRunnerName.THREADS


def _runner(settings: Settings) -> Runner:
    if settings.task_runner is TaskRunnerName.THREADS:
        return cast("Runner", ThreadPoolTaskRunner(max_workers=settings.task_workers))
    try:
        from prefect_dask.task_runners import DaskTaskRunner  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ConfigError(
            "SOLMAP_TASK_RUNNER=dask needs prefect-dask: install solmap[cluster], or leave it out"
        ) from error
    if settings.dask_address:
        return cast("Runner", DaskTaskRunner(address=settings.dask_address))
    cluster = local_cluster(settings.task_workers)
    keys = {"security": cluster.security}
    return cast("Runner", DaskTaskRunner(address=cluster.scheduler_address, client_kwargs=keys))


@lru_cache(maxsize=1)
def local_cluster(workers: int) -> LocalCluster:
    """Run a cluster of worker processes until this process ends, also by a kill.

    It serves all sols, because a worker takes seconds to start. Its ports permit running anything,
    so they require a certificate that only these processes have.
    """
    import dask  # noqa: PLC0415 - an extra
    from distributed import LocalCluster  # noqa: PLC0415 - an extra

    # Workers are restarted by their own supervisor. Dask would give up one that is away for 15 s,
    # and wait forever without workers.
    dask.config.set({"distributed.deploy.lost-worker-timeout": "24 hours"})
    cluster = LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        security=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        local_directory=os.environ.get("PREFECT_HOME"),
    )
    atexit.register(cluster.close)
    return cluster
