"""The record of a flow's own run, for the map.

with recorded("downlink", downlink.name, workspace) as record:
    ...                       # what `runtime.progress` reports is written down
    record.add_lines(report.warnings)
    record.fail_if(report.failures)
"""

from __future__ import annotations

import logging
import sqlite3
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial, wraps
from inspect import signature
from typing import ParamSpec, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.runtime.progress import Step, listen
from solmap.flows.runtime.stopping import STOPPED
from solmap.products.catalogue.maintenance.history import trim_history
from solmap.products.catalogue.runs import Run, RunRecords, RunState
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, StoreFullError
from solmap.products.store.process import log_context, log_to_store

P = ParamSpec("P")
T = TypeVar("T")
log = logging.getLogger(__name__)
_AT_MOST_EVERY_S = 0.5
"""Least time between two records of a stage, which may have many quick parts."""


class RunRecord:
    """The record of a run; an error in writing it never stops the run."""

    def __init__(self, run: Run, book: RunRecords) -> None:
        self._run, self._book = run, book
        self._written_at = 0.0
        self._has_failed = self._is_stopped = False
        self._write()

    @property
    def name(self) -> str:
        """Name of the run."""
        return self._run.id

    def step(self, step: Step) -> None:
        """Record the progress of a stage."""
        is_new = step.stage != self._run.stage or step.done == step.total
        self._run = self._run.with_progress(step.stage, step.done, step.total)
        if is_new or time.monotonic() - self._written_at > _AT_MOST_EVERY_S:
            self._write()

    def add_lines(self, lines: Sequence[str]) -> None:
        """Add lines for people."""
        if lines:
            self._run = self._run.with_lines(lines)
            self._write()

    def fail_if(self, failures: Sequence[str]) -> None:
        """Add failures; if there are any, the run ends as failed."""
        self._has_failed = self._has_failed or bool(failures)
        self.add_lines([f"failed: {line}" for line in failures])

    def stop(self) -> None:
        """People stop the run before its end."""
        self._is_stopped = True
        self.add_lines([STOPPED])

    def end(self) -> None:
        """The run is over."""
        state = RunState.FAILED if self._has_failed else RunState.SUCCEEDED
        state = RunState.CANCELLED if self._is_stopped else state
        self._run = self._run.with_end(state)
        self._write()

    def _write(self) -> None:
        self._written_at = time.monotonic()
        try:
            self._book.write(self._run)
        except (SQLAlchemyError, StoreFullError) as error:
            log.warning("the progress of %s could not be recorded: %s", self._run.id, error)


def beside_runs(work: Callable[P, T]) -> Callable[P, T]:
    """Decorator of functions that make products outside a run: they hold the lock of runs.

    The store is that of the argument `workspace`, or in the folder `root` or `store`.
    """
    names = signature(work)

    @wraps(work)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        given = names.bind(*args, **kwargs).arguments
        workspace = given.get("workspace") or open_workspace(given.get("root") or given["store"])
        with workspace.run_turn():
            return work(*args, **kwargs)

    return call


def _trim_history(workspace: Workspace) -> None:
    try:
        trim_history(workspace, Settings().history_days)
    except (SQLAlchemyError, sqlite3.Error, ProductError) as error:
        log.warning("the history of %s could not be trimmed: %s", workspace.store.root, error)


@contextmanager
def record_run(kind: str, subject: str, workspace: Workspace) -> Iterator[RunRecord]:
    """Keep a record of the run inside the block; an exception ends it as failed.

    A signal ends it as cancelled. Nothing is pruned meanwhile.
    """
    from solmap.flows.runtime.run_page import deployed_run  # noqa: PLC0415 - imports Prefect

    log_to_store(workspace.store.root, "flows")
    run = Run.start(kind, subject, *deployed_run())
    record = RunRecord(run, RunRecords(workspace.catalogue.engine))
    try:
        with (
            workspace.run_turn(partial(log.info, "%s waits for maintenance of the store", kind)),
            listen(record.step),
            log_context(run=record.name, flow=kind, of=subject),
        ):
            _trim_history(workspace)
            log.info("%s of %s begins", kind, subject)
            yield record
            log.info("%s of %s ends", kind, subject)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) or hasattr(error, "signal"):  # Prefect's own
            log.warning("%s of %s was stopped", kind, subject)
            record.stop()
            raise
        log.exception("%s of %s stopped", kind, subject)
        record.fail_if([f"{type(error).__name__}: {error}"])
        raise
    finally:
        record.end()
