"""Stages: the tasks of a flow, and when one is tried again.

A stage keeps what it makes in the store, so that Prefect need not; calling it twice is harmless.
What can pass (`products.passing`) is tried again after a pause that doubles; what cannot is not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import httpx
from prefect import Task, task
from prefect.cache_policies import NO_CACHE
from prefect.client.schemas.objects import State, TaskRun
from prefect.tasks import exponential_backoff

from products.passing import can_pass

P = ParamSpec("P")
R = TypeVar("R")

RETRIES = 4
FIRST_PAUSE_S = 1.0
"""Before the second attempt; doubled for each further one, 15 s in all."""
_JITTER = 0.3
"""Pauses vary by this share, so that two stages do not meet at the same lock again."""


def stage(task_run_name: str) -> Callable[[Callable[P, R]], Task[P, R]]:
    """A function as a task whose runs bear a name; it may hold parameters, as in `dtm-{stop}`."""
    return task(
        task_run_name=task_run_name,
        cache_policy=NO_CACHE,  # the store remembers what has been made
        retries=RETRIES,
        retry_delay_seconds=exponential_backoff(FIRST_PAUSE_S),
        retry_jitter_factor=_JITTER,
        retry_condition_fn=may_pass,
    )


def may_pass(_task: Task[Any, Any], _run: TaskRun, state: State[Any]) -> bool:
    """Whether a stage that failed is worth another attempt."""
    error = state.data
    return isinstance(error, httpx.TransportError) or (
        isinstance(error, BaseException) and can_pass(error)
    )
