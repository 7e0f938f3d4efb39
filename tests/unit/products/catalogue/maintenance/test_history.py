"""Old history is removed, published layers stay, and requests for removed events are answered."""

import os
from datetime import UTC, datetime, timedelta

import pytest
import sqlalchemy as sa

from solmap.products.catalogue import events
from solmap.products.catalogue.catalogue import MissionEntry, Outcome
from solmap.products.catalogue.edits import RequestKind, RequestState, RunRequests
from solmap.products.catalogue.maintenance.history import trim_history
from solmap.products.catalogue.runs import Run, RunRecords
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint

OLD = (datetime.now(UTC) - timedelta(days=100)).isoformat(timespec="milliseconds")


@pytest.fixture
def workspace(tmp_path, catalogue_url):
    return Workspace.open(tmp_path / "store", catalogue_url)


def age(workspace, table, up_to=None):
    with workspace.catalogue.engine.begin() as connection:
        rows = table.update()
        if up_to is not None:
            rows = rows.where(table.c.id <= up_to)
        connection.execute(rows.values(at=OLD))


def test_old_events_are_removed_and_numbering_continues(workspace):
    catalogue = workspace.catalogue
    for _ in range(4):
        catalogue.append_event(events.RUN_CHANGED, {})
    age(workspace, events.EVENTS, up_to=2)
    trim_history(workspace, 90)
    assert [event.id for event in catalogue.events_since(0)] == [3, 4]
    age(workspace, events.EVENTS)
    trim_history(workspace, 90)
    assert [event.id for event in catalogue.events_since(0)] == [4]
    with catalogue.engine.connect() as connection:
        assert events.is_gone(connection, 2)
        assert not events.is_gone(connection, 3)
    catalogue.append_event(events.RUN_CHANGED, {})
    assert catalogue.version() == 5


def test_the_last_publication_stays_with_all_events_since(workspace):
    catalogue = workspace.catalogue
    entry = MissionEntry(
        "MER2", "Spirit", LandingPoint("here", 0.0, 0.0, 3_393_000.0, "a book"), None
    )
    for _ in range(3):
        catalogue.append_event(events.RUN_CHANGED, {})
    catalogue.publish(missions=[entry])
    catalogue.append_event(events.RUN_CHANGED, {})
    before = catalogue.published_version()
    age(workspace, events.EVENTS)
    trim_history(workspace, 90)
    assert [event.id for event in catalogue.events_since(0)] == [4, 5]
    assert catalogue.published_version() == before


def test_an_empty_history_is_trimmed_too(workspace):
    trim_history(workspace, 90)
    assert workspace.catalogue.version() == 0


def test_old_runs_and_answered_requests_are_removed_and_edits_and_outcomes_kept(workspace):
    records, requests = (
        RunRecords(workspace.catalogue.engine),
        RunRequests.of(workspace.store.root),
    )
    old, young = Run.start("downlink", "old"), Run.start("downlink", "young")
    records.write(young)
    with workspace.catalogue.engine.begin() as connection:
        connection.execute(
            sa.text("UPDATE runs SET started_at = :old").bindparams(old="2020-01-01T00:00:00.000")
        )
    records.write(old)
    for kind in RequestKind:
        requests.add(kind, "MER2", "ada")
    requests.answer(1, RequestState.TAKEN, "run-1")
    workspace.catalogue.publish(
        outcomes=[Outcome("x.img", is_failure=True, notes=("broken",), at=OLD)]
    )
    trim_history(workspace, 90)
    assert [run.subject for run in records.runs()] == ["old"]
    assert len(requests.requests()) == len(RequestKind)
    trim_history(workspace, -1)
    unanswered = list(range(len(RequestKind), 1, -1))
    assert [one.id for one in requests.requests()] == unanswered
    assert records.runs() == []
    assert len(workspace.catalogue.outcomes()) == 1


@pytest.mark.parametrize("copies", ["before-schema-1", "before-restore-20261123T012000Z"])
def test_old_rotated_logs_and_safety_copies_are_removed(workspace, copies):
    root = workspace.store.root
    (root / "logs").mkdir()
    (root / copies).mkdir()
    names = ("logs/flows.jsonl", "logs/flows.jsonl.1", "logs/flows.jsonl.2", copies)
    for name in names:
        if not (root / name).exists():
            (root / name).write_text("{}\n")
        if not name.endswith(".1"):
            os.utime(root / name, (0, 0))
    trim_history(workspace, 90)
    assert [name for name in names if (root / name).exists()] == list(names[:2])
