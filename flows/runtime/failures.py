"""Failures that do not stop other work: recorded for `solmap status`, or listed by task."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from typing import Any, TypeVar

from prefect.exceptions import UnfinishedRun
from prefect.futures import PrefectFuture

from solmap.flows.runtime.progress import report
from solmap.products.catalogue.catalogue import Outcome
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import StoreFullError, cause_of
from solmap.products.store.faults import is_disk_full

log = logging.getLogger(__name__)
K = TypeVar("K")
T = TypeVar("T")


@contextmanager
def isolate(
    subject: str, workspace: Workspace, failures: list[str], line: str = "{}"
) -> Iterator[dict[str, str]]:
    """Continue after the block on any error in it, and record the cause; a full disk is raised.

    The block may add failed parts, by their name, to the dictionary that it gets.

    Args:
        subject: Name of the block's subject among the catalogue's outcomes.
        workspace: Where outcomes are kept.
        failures: Gains a line for the block, or for each part.
        line: The added line, with `{}` for the cause.

    Raises:
        StoreFullError: the disk is full, so all further work would fail too.
    """
    parts: dict[str, str] = {}
    causes: list[str] = []
    try:
        yield parts
    except StoreFullError:
        raise
    except Exception as error:
        if is_disk_full(workspace.store.root, error):
            raise StoreFullError(
                f"the disk is full while working on {subject}; free some space and run again: "
                "what was made before is kept"
            ) from error
        causes.append(cause_of(error))
        log.warning("%s", line.format(causes[0]), exc_info=error)
    causes += [f"{part}: {cause}" for part, cause in parts.items()]
    if causes:
        failures += [line.format(cause) for cause in causes]
        keep_outcome(Outcome.now(subject, tuple(causes), is_failure=True), workspace)


@contextmanager
def keep_going(failed: MutableMapping[K, str], part: K) -> Iterator[None]:
    """Continue after the block on any error in it, with the cause under `part`.

    Raises:
        StoreFullError: the disk is full, so all further work would fail too.
    """
    try:
        yield
    except StoreFullError:
        raise
    except Exception as error:
        failed[part] = cause_of(error, is_named=True)
        log.warning("%s: %s", part, failed[part], exc_info=error)


def keep_outcome(outcome: Outcome, workspace: Workspace) -> None:
    """Store an outcome; an error in storing it stops nothing."""
    try:
        workspace.catalogue.publish(outcomes=[outcome])
    except Exception as error:  # noqa: BLE001 - the database is away, or its disk is full
        log.warning("the outcome of %s could not be stored: %s", outcome.subject, cause_of(error))


def clear_failure(subject: str, workspace: Workspace) -> None:
    """Clear an earlier failure."""
    try:
        failed = {one.subject for one in workspace.catalogue.outcomes() if one.is_failure}
    except Exception as error:  # noqa: BLE001 - the database is away
        log.warning("the earlier outcome of %s could not be read: %s", subject, cause_of(error))
        return
    if subject in failed:
        keep_outcome(Outcome.now(subject, ()), workspace)


def group_by_first(results: Mapping[tuple[K, Any], T]) -> dict[K, list[T]]:
    """Results with keys of two parts, listed by the first part."""
    listed: dict[K, list[T]] = {}
    for (first, _), result in results.items():
        listed.setdefault(first, []).append(result)
    return listed


def wait_for(
    stage: str, futures: Mapping[K, PrefectFuture[Any]]
) -> tuple[dict[K, Any], dict[K, str]]:
    """Wait for tasks; returns results by key, and failures by key.

    A task that waited for a failed one is among the failures without its own line, since the cause
    is listed.

    Raises:
        StoreFullError: a task found the disk full, so all further work would fail too.
    """
    results, failures = {}, {}
    for done, (key, future) in enumerate(futures.items(), 1):
        result, cause = result_of(future)
        if cause is None:
            results[key] = result
        else:
            failures[key] = cause
        report(stage, done, len(futures))
    return results, failures


def result_of(future: PrefectFuture[T]) -> tuple[T | None, str | None]:
    """Wait for a task: its result, or the cause of failure if not listed already.

    Raises:
        StoreFullError: it found the disk full.
    """
    try:
        result = future.result(raise_on_failure=False)
    except UnfinishedRun:  # never ran: what it waited for failed
        return None, ""
    except Exception as error:  # noqa: BLE001 - its worker was killed, again and again
        return None, cause_of(error, is_named=True)
    if isinstance(result, StoreFullError):
        raise result
    if isinstance(result, BaseException):
        return None, cause_of(result, is_named=True)
    return result, None
