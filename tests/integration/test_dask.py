"""Tasks on worker processes of a real Dask cluster: same results, same words, nothing in common."""

import os

import pytest

from solmap.products.store.product_store import ProductStore
from tests.support.engine_overhead import run_on, stages

pytest.importorskip("prefect_dask", reason="prefect-dask is not installed (solmap[cluster])")
pytestmark = [pytest.mark.timeout(300), pytest.mark.usefixtures("engine")]


@pytest.fixture(scope="module", autouse=True)
def _one_cluster():
    """The cluster that flows keep ends with these tests."""
    yield
    from solmap.flows.runtime.runners import local_cluster  # noqa: PLC0415 - imports Prefect

    if local_cluster.cache_info().currsize:
        local_cluster(2).close()
        local_cluster.cache_clear()


def outcome(engine: str, store: ProductStore):
    """Outcomes of good tasks, of one that fails, of one that needs it, and of one after both."""
    from solmap.flows.runtime.jobs import Job, run_jobs  # noqa: PLC0415 - imports Prefect
    from solmap.flows.runtime.progress import listen  # noqa: PLC0415

    task, steps = stages(), []

    def body():
        def job(what, number, **order):
            return Job("try", lambda _: task[what].submit(number, store), **order)

        jobs = {f"good {number}": job("nothing", number) for number in range(6)}
        jobs["bad"] = job("broken", 7)
        jobs["later"] = job("nothing", 8, needs=["good 1", "bad"])
        jobs["after"] = Job(
            "try",
            lambda made: task["nothing"].submit(sorted(map(str, made)), store),
            needs=["good 1"],
            after=["bad", "later", *jobs],
        )
        jobs["none"] = Job("try", lambda _: None)
        with listen(steps.append):
            return run_jobs(jobs)

    done, failed = run_on(engine, body)
    return done, failed, steps


def test_workers_give_the_same_results_and_report_the_same_failures(tmp_path):
    store = ProductStore.open(tmp_path / "store")
    here, failed_here, read_here = outcome("threads", store)
    there, failed_there, read_there = outcome("dask", store)
    assert failed_here == failed_there
    assert failed_there["bad"].startswith("ProductNotFoundError: dtm of stop7")
    assert failed_there["later"] == ""  # its cause has been reported
    assert {key: value[0] for key, value in there.items()} == {
        key: value[0] for key, value in here.items()
    }
    assert here["after"][0] == [f"good {number}" for number in range(6)]  # and all others are done
    assert {"none", "later"}.isdisjoint(here)
    assert {value[1] for value in here.values()} == {os.getpid()}
    assert os.getpid() not in {value[1] for value in there.values()}
    assert read_there == read_here  # progress arrives as it does from threads
    assert [(step.done, step.total) for step in read_there] == [(n, 10) for n in range(1, 11)]


def test_a_full_disk_stops_the_flow_on_workers_too():
    from solmap.flows.runtime.failures import wait_for  # noqa: PLC0415 - imports Prefect
    from solmap.products.errors import StoreFullError  # noqa: PLC0415

    task = stages()["full"]
    with pytest.raises(StoreFullError, match="the disk is full"):
        run_on("dask", lambda: wait_for("fill", {"full": task.submit()}))


@pytest.mark.slow
def test_a_worker_that_is_killed_repeatedly_is_one_failure(tmp_path):
    from solmap.flows.runtime.failures import wait_for  # noqa: PLC0415 - imports Prefect

    store, task = ProductStore.open(tmp_path / "store"), stages()

    def body():
        futures = {"kill": task["kill"].submit(), "good": task["nothing"].submit(1, store)}
        return wait_for("kill", futures)

    done, failed = run_on("dask", body)
    assert list(done) == ["good"]
    assert failed["kill"].startswith("KilledWorker: ")
