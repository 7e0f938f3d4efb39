"""What became of submitted tasks: results to go on with, and one line for each failure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from prefect.futures import PrefectFuture
from prefect.states import State

from flows.progress import report

K = TypeVar("K")


def settled(
    stage: str, futures: Mapping[K, PrefectFuture[Any]]
) -> tuple[dict[K, Any], dict[K, str]]:
    """Wait for tasks; results by key, and what went wrong by key.

    A task that waited for a failed one is among the failures too, without a line of its own: the
    cause has been said.
    """
    results, failures = {}, {}
    for done, (key, future) in enumerate(futures.items(), 1):
        result = future.result(raise_on_failure=False)
        if isinstance(result, BaseException):
            failures[key] = f"{type(result).__name__}: {result}"
        elif isinstance(result, State):  # never ran: what it waited for failed
            failures[key] = ""
        else:
            results[key] = result
        report(stage, done, len(futures))
    return results, failures
