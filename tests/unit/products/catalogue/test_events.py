"""Events are returned in order, once each, and removed when there are many newer ones."""

import pytest

from solmap.products.catalogue import events
from solmap.products.catalogue.catalogue import Catalogue


@pytest.fixture
def catalogue(tmp_path, catalogue_url):
    return Catalogue.open(tmp_path, catalogue_url)


def test_events_are_returned_in_order_after_the_last_seen(catalogue):
    for number in range(5):
        catalogue.append_event("run.changed", {"number": number})
    reported = catalogue.events_since(2)
    assert [event.id for event in reported] == [3, 4, 5]
    assert [event.document["number"] for event in reported] == [2, 3, 4]
    assert catalogue.version() == 5
    assert catalogue.events_since(5) == []


def test_removed_events_are_reported_to_clients_that_missed_them(catalogue, monkeypatch):
    monkeypatch.setattr(events, "KEPT", 10)
    for number in range(25):
        catalogue.append_event("run.changed", {"number": number})
    assert [event.id for event in catalogue.events_since(0)] == list(range(16, 26))
    with catalogue.engine.connect() as connection:
        assert events.is_gone(connection, 14)
        assert not events.is_gone(connection, 15)
        assert not events.is_gone(connection, 25)


def test_numbering_continues_when_a_new_process_opens_the_catalogue(
    catalogue, tmp_path, catalogue_url
):
    catalogue.append_event("run.changed", {})
    again = Catalogue.open(tmp_path, catalogue_url)
    again.append_event("run.changed", {})
    assert [event.id for event in catalogue.events_since(0)] == [1, 2]


def test_a_failed_transaction_emits_no_event(catalogue):
    with catalogue.engine.connect() as connection:
        events.append(connection, "run.changed", {})
        connection.rollback()
    assert catalogue.version() == 0


def test_the_progress_of_runs_publishes_nothing(catalogue, monkeypatch):
    monkeypatch.setattr(events, "KEPT", 10)
    catalogue.append_event(events.LAYERS_PUBLISHED, {})
    before = catalogue.published_version()
    catalogue.append_event(events.RUN_CHANGED, {})
    assert catalogue.published_version() == before
    catalogue.append_event(events.IMAGES_INGESTED, {})
    assert catalogue.published_version() > before
    for _ in range(20):  # until what was published is forgotten: nobody takes new for old then
        catalogue.append_event(events.RUN_CHANGED, {})
    assert catalogue.published_version() == catalogue.version()
