"""Stages: the tasks of a flow, and their retries.

A stage stores its result in the product store, not in Prefect; it may be called repeatedly. If all
of its products exist, submitting it only looks them up: most stages of a window are of earlier
sols, and a task costs the engine as much as ten look-ups.
Transient errors (`products.store.faults`) are retried after a doubling pause; others are not.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import wraps
from inspect import signature, unwrap
from typing import Any, ParamSpec, TypeVar

import httpx
from prefect import Task
from prefect.cache_policies import NO_CACHE
from prefect.client.schemas.objects import State, TaskRun
from prefect.context import TagsContext
from prefect.futures import PrefectFuture
from prefect.tasks import exponential_backoff

from solmap.products.errors import cause_of
from solmap.products.store.faults import is_transient
from solmap.products.store.garbage import collect_garbage_rarely
from solmap.products.store.process import ResourceMeter
from solmap.products.store.product_store import NotMadeError, looking_up

log = logging.getLogger(__name__)
P = ParamSpec("P")
R = TypeVar("R")

RETRIES = 4
FIRST_PAUSE_S = 1.0
"""Pause before the second attempt; doubled for each further one, 15 s in total."""
_JITTER = 0.3
"""Random variation of pauses, so that two stages do not collide at the same lock again."""


class LookedUp(PrefectFuture[R]):
    """Result of a stage whose products exist."""

    def __init__(self, made: R) -> None:
        self._made = made

    def wait(self, timeout: float | None = None) -> None:
        """Return at once."""

    def result(self, timeout: float | None = None, raise_on_failure: bool = True) -> R:  # noqa: ARG002, FBT001, FBT002 - as Prefect has it
        """The references of its products."""
        return self._made

    def add_done_callback(self, fn: Callable[[PrefectFuture[R]], None]) -> None:
        """Call `fn` at once."""
        fn(self)


class Untagged(Task[P, R]):
    """A task whose runs do not have the tags of their flow.

    Before a run with tags the engine requests a place from the server, which takes up to two
    seconds when the server's database is being written.
    """

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:  # type: ignore[override]
        """Run the task in the flow's own thread."""
        with TagsContext(current_tags=set()):
            return super().__call__(*args, **kwargs)

    def submit(self, *args: P.args, **kwargs: P.kwargs) -> PrefectFuture[R]:  # type: ignore[override]
        """Submit the task to the workers of its flow."""
        with TagsContext(current_tags=set()):
            return super().submit(*args, **kwargs)


class Stage(Untagged[P, R]):
    """A task whose result is looked up where its products exist."""

    def submit(self, *args: P.args, **kwargs: P.kwargs) -> PrefectFuture[R]:  # type: ignore[override]
        """Look up the result, or submit the task."""
        try:
            with looking_up():
                return LookedUp(unwrap(self.fn)(*args, **kwargs))
        except NotMadeError:
            pass
        except Exception as error:  # noqa: BLE001 - the task meets and reports it
            log.info("%s cannot be looked up: %s", self.name, cause_of(error))
        return super().submit(*args, **kwargs)


def stage(
    task_run_name: str, *, makes_products: bool = True
) -> Callable[[Callable[P, R]], Task[P, R]]:
    """A function as a task.

    Args:
        task_run_name: Name of its runs, which may hold parameters: `dtm-{stop}`.
        makes_products: Whether it makes products and does nothing else, so that its result may be
            looked up.
    """

    def as_task(work: Callable[P, R]) -> Task[P, R]:
        return (Stage if makes_products else Untagged)(
            _log_effort(work, task_run_name),
            task_run_name=task_run_name,
            cache_policy=NO_CACHE,  # the store caches results
            retries=RETRIES,
            retry_delay_seconds=exponential_backoff(FIRST_PAUSE_S),
            retry_jitter_factor=_JITTER,
            retry_condition_fn=is_worth_retrying,
        )

    return as_task


def _log_effort(work: Callable[P, R], name: str) -> Callable[P, R]:
    """Wrap a function to log its time and memory."""
    shape = signature(work)

    @wraps(work)
    def run_and_log(*args: P.args, **kwargs: P.kwargs) -> R:
        collect_garbage_rarely()
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
    """Whether a failed stage should be retried."""
    error = state.data
    return isinstance(error, httpx.TransportError) or (
        isinstance(error, BaseException) and is_transient(error)
    )
