"""`solmap up` reports a fault once and continues."""

import time

import pytest

from solmap.config.settings import Settings


@pytest.fixture
def machine(tmp_path, engine):  # noqa: ARG001 - Prefect reads its settings at import
    from solmap.flows.service.inbox import Inbox, InboxParams  # noqa: PLC0415
    from solmap.flows.service.machine import Machine  # noqa: PLC0415

    inbox = tmp_path / "inbox"
    inbox.mkdir()
    (inbox / "a.img").write_bytes(b"1")
    message: list[str] = []
    made = Machine(Settings(store=tmp_path / "store", inbox=inbox), message.append)
    made.store.mkdir()
    made._inbox = Inbox(inbox, tmp_path / "inbox.json", InboxParams(settle_s=0.0))
    made._stuck_checked_at = time.monotonic()
    return made, message


def test_files_before_the_deployments_wait_without_a_message(machine, monkeypatch):
    from solmap.flows.service import submission  # noqa: PLC0415

    up, message = machine
    monkeypatch.setattr(submission, "DOWNLINK", "downlink/not-served-yet")
    up.check()  # the engine of the tests has no deployment of this name
    assert message == []
    assert up._running is None


def test_an_error_is_logged_once_and_retried(machine, monkeypatch):
    from solmap.flows.service import submission  # noqa: PLC0415

    up, message = machine

    def trouble(*_):
        raise RuntimeError("no luck")

    with monkeypatch.context() as patched:
        patched.setattr(submission, "submit_inbox", trouble)
        up.check()
        up.check()
    assert message == ["RuntimeError: no luck; retried until it works"]
    run = submission.SubmittedRun("id", "a-run", "delivery")
    monkeypatch.setattr(submission, "submit_inbox", lambda *_: run)
    up.check()
    assert message[1].startswith("files came: run a-run")


def test_a_failed_run_does_not_count_as_processed(machine, monkeypatch):
    from solmap.flows.service import submission  # noqa: PLC0415

    up, message = machine
    runs = iter("abc")

    def submit(delivery, _):
        return submission.SubmittedRun("id", next(runs), delivery)

    monkeypatch.setattr(submission, "submit_inbox", submit)
    monkeypatch.setattr(submission, "final_state", lambda _: "FAILED")
    up.check()
    up.check()
    assert message[-1] == "the run of the inbox failed, see `solmap status`; tried again in 1 min"
    up._inbox._not_before = 0.0
    up.check()
    monkeypatch.setattr(submission, "final_state", lambda _: "COMPLETED")
    up.check()
    assert message[-1] == "the inbox was processed: completed"
    up.check()
    assert up._running is None
