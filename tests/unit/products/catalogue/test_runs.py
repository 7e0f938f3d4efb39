"""Runs are recorded, announced by events, and marked lost when their process has ended."""

import dataclasses
import subprocess
import sys

import pytest

from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.runs import Run, RunRecords, RunState
from solmap.products.errors import ProductNotFoundError


@pytest.fixture
def catalogue(tmp_path, catalogue_url):
    return Catalogue.open(tmp_path, catalogue_url)


@pytest.fixture
def book(catalogue):
    return RunRecords(catalogue.engine)


def test_a_run_is_read_as_it_was_written(book):
    run = (
        Run.start("downlink", "sol156")
        .with_progress("match pairs", 3, 10)
        .with_lines(["one image is broken"])
    )
    book.write(run)
    assert book.run(run.id) == run
    book.write(run.with_end(RunState.SUCCEEDED))
    (kept,) = book.runs()
    assert kept.state is RunState.SUCCEEDED
    assert kept.ended_at is not None


def test_every_change_of_a_run_is_an_event(book, catalogue):
    run = Run.start("downlink", "sol156")
    book.write(run)
    book.write(run.with_progress("match pairs", 1, 2))
    reported = catalogue.events_since(0)
    assert [event.kind for event in reported] == ["run.changed"] * 2
    assert reported[1].document["stage"] == "match pairs"
    assert (reported[1].document["done"], reported[1].document["total"]) == (1, 2)


def test_a_run_whose_process_has_ended_is_marked_lost(book):
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    run = Run.start("downlink", "sol156")
    host = run.process.rpartition("-")[0]
    book.write(dataclasses.replace(run, process=f"{host}-{gone.pid}"))
    assert book.run(run.id).state is RunState.LOST
    elsewhere = dataclasses.replace(run, id="other", process=f"another-host-{gone.pid}")
    book.write(elsewhere)
    assert book.run("other").state is RunState.RUNNING  # nothing is known of it


def test_an_unknown_run_is_named(book):
    with pytest.raises(ProductNotFoundError, match="there is no run 'x'"):
        book.run("x")
