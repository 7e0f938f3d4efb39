"""A run requested on the map is submitted once, or refused with a reason."""

import httpx
import pytest
from prefect.exceptions import ObjectNotFound

from solmap.flows.service import submission as requests
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.edits import RequestKind, RequestState, RunRequests


@pytest.fixture
def submitted(monkeypatch):
    requested = []

    def submit(deployment, parameters):
        requested.append((deployment, dict(parameters)))
        return "wise-lynx"

    monkeypatch.setattr(requests, "submit", submit)
    return requested


def test_requests_start_runs_of_their_deployments(tmp_path, submitted):
    book, catalogue = RunRequests.of(tmp_path), Catalogue.open(tmp_path)
    book.add(RequestKind.OVERALL, "MER2", "Ada")
    book.add(RequestKind.DOWNLINK, None, "Ada")
    lines = requests.submit_requests(tmp_path, has_inbox=True)
    assert lines[0] == "Ada requested overall adjustment: taken, wise-lynx"
    assert submitted == [
        ("overall-adjustment/weekly", {"mission": "MER2"}),
        ("downlink/inbox", {}),
    ]
    assert book.waiting() == []
    assert requests.submit_requests(tmp_path, has_inbox=True) == []
    assert [event.kind for event in catalogue.events_since(0)] == ["requests.changed"] * 2


def test_a_downlink_without_an_inbox_is_refused(tmp_path, submitted):
    book = RunRequests.of(tmp_path)
    book.add(RequestKind.DOWNLINK, None, "Ada")
    requests.submit_requests(tmp_path, has_inbox=False)
    (requested,) = book.requests()
    assert requested.state is RequestState.REFUSED
    assert "no inbox is watched" in requested.answer
    assert submitted == []


def test_a_request_waits_until_the_scheduler_has_started(tmp_path, monkeypatch):
    def unknown(_deployment, _parameters):
        raise ObjectNotFound(http_exc=Exception("404"))

    monkeypatch.setattr(requests, "submit", unknown)
    book = RunRequests.of(tmp_path)
    book.add(RequestKind.REGION, None, "Ada")
    assert requests.submit_requests(tmp_path, has_inbox=False) == []
    assert len(book.waiting()) == 1


def test_a_request_waits_while_the_scheduler_does_not_answer(tmp_path, monkeypatch):
    def refuse(_deployment, _parameters):
        raise httpx.ConnectError("refused")

    monkeypatch.setattr(requests, "submit", refuse)
    book = RunRequests.of(tmp_path)
    book.add(RequestKind.REGION, None, "Ada")
    with pytest.raises(httpx.ConnectError):
        requests.submit_requests(tmp_path, has_inbox=False)
    assert len(book.waiting()) == 1
