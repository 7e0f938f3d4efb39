"""Stages: the tasks of a flow, and when one is tried again.

A stage keeps what it makes in the store, so that Prefect need not; calling it twice is harmless.
Transient errors (`products.store.faults`) are retried after a pause that doubles; others are not.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import Any, ParamSpec, TypeVar

import httpx
from prefect import Task, task
from prefect.cache_policies import NO_CACHE
from prefect.client.schemas.objects import State, TaskRun
from prefect.tasks import exponential_backoff

from solmap.products.store.faults import is_transient
from solmap.products.store.process import ResourceMeter, collect_garbage_seldom

log = logging.getLogger(__name__)
P = ParamSpec("P")
R = TypeVar("R")

RETRIES = 4
FIRST_PAUSE_S = 1.0
"""Before the second attempt; doubled for each further one, 15 s in all."""
_JITTER = 0.3
"""Pauses vary by this share, so that two stages do not meet at the same lock again."""


def stage(task_run_name: str) -> Callable[[Callable[P, R]], Task[P, R]]:
    """A function as a task whose runs bear a name; it may hold parameters, as in `dtm-{stop}`."""

    def as_task(work: Callable[P, R]) -> Task[P, R]:
        return run_as(_log_effort(work, task_run_name))

    run_as = task(
        task_run_name=task_run_name,
        cache_policy=NO_CACHE,  # the store remembers what has been made
        retries=RETRIES,
        retry_delay_seconds=exponential_backoff(FIRST_PAUSE_S),
        retry_jitter_factor=_JITTER,
        retry_condition_fn=is_worth_retrying,
    )
    return as_task


def _log_effort(work: Callable[P, R], name: str) -> Callable[P, R]:
    """The same work, and a line in the log of what it took."""
    shape = signature(work)

    @wraps(work)
    def run_and_log(*args: P.args, **kwargs: P.kwargs) -> R:
        collect_garbage_seldom()
        effort, failed = ResourceMeter(), "failed"
        try:
            made = work(*args, **kwargs)
            failed = ""
        finally:
            bound = shape.bind(*args, **kwargs)
            bound.apply_defaults()
            subject = name.format(**bound.arguments)
            level = logging.WARNING if failed else logging.INFO
            facts = {"stage": work.__name__, "subject": subject, **effort.usage()}
            log.log(level, "%s %s", subject, failed or "done", extra=facts, exc_info=bool(failed))
        return made

    return run_and_log


def is_worth_retrying(_task: Task[Any, Any], _run: TaskRun, state: State[Any]) -> bool:
    """Whether a stage that failed is worth another attempt."""
    error = state.data
    return isinstance(error, httpx.TransportError) or (
        isinstance(error, BaseException) and is_transient(error)
    )
