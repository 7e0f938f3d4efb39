"""What fails without stopping the rest: kept for `solmap status`, or told task by task."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar, cast

from prefect.exceptions import UnfinishedRun
from prefect.futures import PrefectFuture
from sqlalchemy.exc import SQLAlchemyError

from solmap.config.records import ConfigError
from solmap.flows.runtime.progress import report
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.products.catalogue.catalogue import Outcome
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, StoreFullError
from solmap.products.model import ProductRef
from solmap.products.store.faults import is_disk_full

log = logging.getLogger(__name__)
K = TypeVar("K")
T = TypeVar("T")


@contextmanager
def isolate(
    subject: str, workspace: Workspace, failures: list[str], line: str = "{}"
) -> Iterator[None]:
    """Go on after the block whatever fails in it, and keep the cause; but a full disk stops all.

    Args:
        subject: What is worked on, by its name in the catalogue's outcomes.
        workspace: Where outcomes are kept.
        failures: Gains a line.
        line: What is added, with `{}` for the cause.

    Raises:
        StoreFullError: the disk is full; whatever else is tried would find it full too.
    """
    try:
        yield
    except StoreFullError:
        raise
    except Exception as error:
        if is_disk_full(workspace.store.root, error):
            raise StoreFullError(
                f"the disk is full while working on {subject}; free some space and run again: "
                "what was made before is kept"
            ) from error
        log.warning("%s", line.format(cause_of(error)), exc_info=error)
        failures.append(line.format(cause_of(error)))
        keep_outcome(Outcome.now(subject, (cause_of(error),), is_failure=True), workspace)


def keep_outcome(outcome: Outcome, workspace: Workspace) -> None:
    """Keep how something ended; that it cannot be kept stops nothing."""
    try:
        workspace.catalogue.publish(outcomes=[outcome])
    except SQLAlchemyError as error:
        log.warning("how %s ended could not be noted: %s", outcome.subject, error)


def clear_failure(subject: str, workspace: Workspace) -> None:
    """Say of what failed at an earlier time that it does no longer."""
    failed = {one.subject for one in workspace.catalogue.outcomes() if one.is_failure}
    if subject in failed:
        keep_outcome(Outcome.now(subject, ()), workspace)


def cause_of(error: Exception) -> str:
    """Our own errors speak for themselves; others are named. The traceback is on the run page."""
    if isinstance(error, PhotogrammetryError | ProductError | ConfigError):
        return str(error)
    return f"{type(error).__name__}: {error}"


def as_argument(future: PrefectFuture[T]) -> T:
    """A future as the argument of another task: Prefect waits for it and hands on its result."""
    return cast("T", future)


def group_by_first(results: Mapping[tuple[K, Any], T]) -> dict[K, list[T]]:
    """Results with keys of two parts, listed by the first part."""
    listed: dict[K, list[T]] = {}
    for (first, _), result in results.items():
        listed.setdefault(first, []).append(result)
    return listed


def group_layers(
    results: Mapping[tuple[K, Any], ProductRef | Sequence[ProductRef]],
) -> dict[K, list[ProductRef]]:
    """The same for products, of which a task makes one or several at once."""
    layers: dict[K, list[ProductRef]] = {}
    for (first, _), made in results.items():
        layers.setdefault(first, []).extend([made] if isinstance(made, ProductRef) else made)
    return layers


def wait_for(
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
