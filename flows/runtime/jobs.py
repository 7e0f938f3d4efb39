"""Jobs: tasks of a flow that are submitted when their inputs exist, in their order.

A task that is submitted with the future of another occupies a worker while it waits, and tasks run
in the order of submission. So only one more than the number of workers is submitted at a time, and
not that one either while an earlier job waits for its inputs: the orthophoto would come after it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from queue import SimpleQueue
from typing import Any, TypeVar

from prefect.futures import PrefectFuture

from solmap.flows.runtime.failures import keep_going, result_of
from solmap.flows.runtime.progress import report
from solmap.flows.runtime.runners import places

K = TypeVar("K")


@dataclass(frozen=True, slots=True)
class Job:
    """A task that is to be submitted."""

    stage: str
    """Name of the stage in progress reports."""
    submit: Callable[[Mapping[Any, Any]], PrefectFuture[Any] | None]
    """Function that submits the task, given all results so far; None if nothing is to be made."""
    needs: Sequence[Any] = ()
    """Keys of earlier jobs whose results it requires."""
    after: Sequence[Any] = ()
    """Keys of earlier jobs whose end it waits for, with or without a result."""

    def only_after(self, others: Sequence[Any]) -> Job:
        """The same job, which also waits for the end of others."""
        return replace(self, after=(*self.after, *others))


def run_jobs(
    jobs: Mapping[K, Job],
    settled: Callable[[K, Mapping[K, Any]], None] | None = None,
    most: int | None = None,
) -> tuple[dict[K, Any], dict[K, str]]:
    """Run jobs, each as soon as possible; returns results by key, and failures by key.

    A job that needed a failed one is among the failures without its own line.

    Args:
        jobs: By key; of those that are ready the first listed is submitted first.
        settled: Called with the key of each job that has ended, and all results by then.
        most: Number of jobs to submit at a time; by default one more than the flow has workers.

    Raises:
        StoreFullError: a task found the disk full, so all further work would fail too.
    """
    waiting, running = dict(jobs), dict[K, PrefectFuture[Any]]()
    results, failures = dict[K, Any](), dict[K, str]()
    finished, most = SimpleQueue[K](), most or places()
    of_stage, done = Counter(job.stage for job in jobs.values()), Counter[str]()

    def settle(key: K) -> None:
        stage = jobs[key].stage
        done[stage] += 1
        report(stage, done[stage], of_stage[stage])
        if settled:
            settled(key, results)

    while waiting or running:
        all_ready = True
        for key, job in list(waiting.items()):
            if len(running) >= (most if all_ready else max(1, most - 1)):
                break
            if any(other in waiting or other in running for other in (*job.needs, *job.after)):
                all_ready = False
                continue
            del waiting[key]
            future = _submitted(key, job, results, failures)
            if future is None:
                settle(key)
            else:
                running[key] = future
                future.add_done_callback(partial(_put, finished, key))
        if running:
            key = finished.get()
            result, cause = result_of(running.pop(key))
            if cause is None:
                results[key] = result
            else:
                failures[key] = cause
            settle(key)
    return results, failures


def _submitted(
    key: K, job: Job, results: Mapping[K, Any], failures: MutableMapping[K, str]
) -> PrefectFuture[Any] | None:
    """The task of a job; None if there is none, which is a failure if an input is missing."""
    if not results.keys() >= set(job.needs):
        failures[key] = ""
        return None
    with keep_going(failures, key):
        return job.submit(results)
    return None


def _put(finished: SimpleQueue[K], key: K, _: PrefectFuture[Any]) -> None:
    finished.put(key)
