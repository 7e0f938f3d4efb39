"""A flow's record of itself: what it reports is written down, and how it ends."""

import sqlite3

import pytest
from sqlalchemy.exc import OperationalError

from solmap.flows.runtime.progress import report
from solmap.flows.runtime.run_record import record_run
from solmap.products.catalogue.maintenance.pruning import PruningParams, prune
from solmap.products.catalogue.runs import RunRecords, RunState
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, StoreReadOnlyError


@pytest.fixture
def workspace(tmp_path):
    return Workspace.open(tmp_path)


def kept(workspace):
    (run,) = RunRecords(workspace.catalogue.engine).runs()
    return run


def test_progress_is_recorded_during_the_run(workspace):
    with record_run("downlink", "sol156", workspace) as record:
        report("match pairs", 2, 7)
        record.add_lines(["an image has no partner"])
        run = kept(workspace)
        assert (run.state, run.stage, run.done, run.total) == (
            RunState.RUNNING,
            "match pairs",
            2,
            7,
        )
    assert kept(workspace).state is RunState.SUCCEEDED
    assert kept(workspace).lines == ("an image has no partner",)


def test_a_run_with_failures_ends_as_failed(workspace):
    with record_run("downlink", "sol156", workspace) as record:
        record.fail_if([])
        record.fail_if(["sol 156: the network is singular"])
    assert kept(workspace).state is RunState.FAILED
    assert kept(workspace).lines == ("failed: sol 156: the network is singular",)


def test_an_exception_ends_the_run_and_is_named(workspace):
    with pytest.raises(ValueError, match="no such folder"), record_run("downlink", "x", workspace):
        raise ValueError("no such folder")
    assert kept(workspace).state is RunState.FAILED
    assert kept(workspace).lines == ("failed: ValueError: no such folder",)


def test_many_quick_parts_are_recorded_together(workspace):
    with record_run("downlink", "sol156", workspace):
        for done in range(1, 1001):
            report("ingest files", done, 1000)
    assert workspace.catalogue.version() < 20
    assert kept(workspace).done == 1000


def test_a_record_that_cannot_be_written_does_not_stop_the_run(workspace, monkeypatch, caplog):
    def refuse(_book, _run):
        raise OperationalError("write", {}, Exception("database is locked"))

    monkeypatch.setattr(RunRecords, "write", refuse)
    with record_run("downlink", "sol156", workspace):
        report("match pairs", 1, 1)
    assert "database is locked" in caplog.text


def test_nothing_is_pruned_during_runs(workspace):
    with (
        record_run("downlink", "sol156", workspace),
        record_run("region", "MER2", workspace),
        pytest.raises(ProductError, match="prune when it has ended"),
    ):
        prune(workspace, PruningParams())
    assert prune(workspace, PruningParams()) == []


@pytest.mark.parametrize(
    "error", [sqlite3.OperationalError("database is locked"), StoreReadOnlyError("of another user")]
)
def test_history_that_cannot_be_trimmed_stops_no_run(workspace, monkeypatch, error):
    def fail(*_):
        raise error

    monkeypatch.setattr("solmap.flows.runtime.run_record.trim_history", fail)
    with record_run("downlink", "sol156", workspace):
        pass
    assert kept(workspace).state is RunState.SUCCEEDED
