"""What became of submitted tasks: results to go on with, and one line for each failure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, cast

from prefect.exceptions import UnfinishedRun
from prefect.futures import PrefectFuture

from solmap.flows.progress import report
from solmap.products.errors import StoreFullError
from solmap.products.model import ProductRef

K = TypeVar("K")
T = TypeVar("T")


def promised(future: PrefectFuture[T]) -> T:
    """A future as the argument of another task: Prefect waits for it and hands on its result."""
    return cast("T", future)


def by_first(results: Mapping[tuple[K, Any], T]) -> dict[K, list[T]]:
    """Results with keys of two parts, listed by the first part."""
    listed: dict[K, list[T]] = {}
    for (first, _), result in results.items():
        listed.setdefault(first, []).append(result)
    return listed


def layers_by_first(
    results: Mapping[tuple[K, Any], ProductRef | Sequence[ProductRef]],
) -> dict[K, list[ProductRef]]:
    """The same for products, of which a task makes one or several at once."""
    layers: dict[K, list[ProductRef]] = {}
    for (first, _), made in results.items():
        layers.setdefault(first, []).extend([made] if isinstance(made, ProductRef) else made)
    return layers


def settled(
    stage: str, futures: Mapping[K, PrefectFuture[Any]]
) -> tuple[dict[K, Any], dict[K, str]]:
    """Wait for tasks; results by key, and what went wrong by key.

    A task that waited for a failed one is among the failures too, without a line of its own: the
    cause has been said.

    Raises:
        StoreFullError: a task found the disk full; whatever else is tried would find it full too.
    """
    results, failures = {}, {}
    for done, (key, future) in enumerate(futures.items(), 1):
        try:
            result = future.result(raise_on_failure=False)
        except UnfinishedRun:  # never ran: what it waited for failed
            failures[key] = ""
        except Exception as error:  # noqa: BLE001 - its worker was killed, again and again
            failures[key] = f"{type(error).__name__}: {error}"
        else:
            if isinstance(result, StoreFullError):
                raise result
            if isinstance(result, BaseException):
                failures[key] = f"{type(result).__name__}: {result}"
            else:
                results[key] = result
        report(stage, done, len(futures))
    return results, failures
