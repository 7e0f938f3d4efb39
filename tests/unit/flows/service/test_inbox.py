"""Which files a watched folder delivers, and when."""

import json
from pathlib import Path

import pytest

from solmap.flows.service.inbox import Inbox, InboxParams

PARAMS = InboxParams(settle_s=10.0, patience_s=60.0)


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "inbox"
    folder.mkdir()
    return folder


@pytest.fixture
def inbox(folder, tmp_path):
    return Inbox(folder, tmp_path / "inbox.json", PARAMS)


def test_an_empty_folder_delivers_nothing(inbox):
    assert inbox.poll(0.0) is None
    assert inbox.poll(100.0) is None


def test_a_file_is_delivered_after_its_size_is_stable(inbox, folder):
    (folder / "a.img").write_bytes(b"1")
    assert inbox.poll(0.0) is None
    assert inbox.poll(9.0) is None
    assert inbox.poll(10.0) is not None


def test_a_growing_file_is_waited_for(inbox, folder):
    file = folder / "a.img"
    for at in range(0, 50, 5):
        file.write_bytes(b"1" * (at + 1))
        assert inbox.poll(float(at)) is None
    assert inbox.poll(60.0) is not None


def test_complete_files_wait_for_arriving_ones_but_not_forever(inbox, folder):
    (folder / "a.img").write_bytes(b"1")
    growing = folder / "b.img"
    handed = []
    for at in range(0, 100, 5):
        growing.write_bytes(b"1" * (at + 1))
        if inbox.poll(float(at)):
            handed.append(at)
    assert handed[0] == 70  # whole at 10, and 60 of patience


def test_processed_files_are_not_delivered_again_by_another_watcher(inbox, folder, tmp_path):
    (folder / "a.img").write_bytes(b"1")
    inbox.poll(0.0)
    delivery = inbox.poll(20.0)
    inbox.mark_processed(delivery)
    assert inbox.poll(30.0) is None
    later = Inbox(folder, tmp_path / "inbox.json", PARAMS)
    later.poll(0.0)
    assert later.poll(20.0) is None


def test_a_late_or_changed_file_makes_another_delivery(inbox, folder):
    (folder / "a.img").write_bytes(b"1")
    inbox.poll(0.0)
    first = inbox.poll(20.0)
    inbox.mark_processed(first)
    (folder / "a.lbl").write_bytes(b"PDS_VERSION_ID = PDS3")  # a label counts as well
    inbox.poll(30.0)
    second = inbox.poll(41.0)
    assert second not in {None, first}
    inbox.mark_processed(second)
    (folder / "a.img").write_bytes(b"12")
    inbox.poll(50.0)
    assert inbox.poll(61.0) not in {None, first, second}


@pytest.mark.parametrize("name", [".a.img.x7", "a.img.part", "a.img.tmp", ".rsync/a.img"])
def test_temporary_files_of_transfers_are_skipped(inbox, folder, name):
    file = folder / name
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(b"1")
    inbox.poll(0.0)
    assert inbox.poll(20.0) is None


@pytest.mark.parametrize("memory", ["", "{", "[]", json.dumps({"delivery": 3})])
def test_an_unreadable_record_of_deliveries_only_repeats_processing(folder, tmp_path, memory):
    (tmp_path / "inbox.json").write_text(memory)
    inbox = Inbox(folder, tmp_path / "inbox.json", PARAMS)
    (folder / "a.img").write_bytes(b"1")
    inbox.poll(0.0)
    assert inbox.poll(20.0) is not None


def test_a_missing_folder_delivers_nothing(inbox, folder):
    folder.rmdir()
    assert inbox.poll(0.0) is None


def test_a_delivery_with_a_failed_run_is_retried_after_growing_pauses(inbox, folder):
    (folder / "a.img").write_bytes(b"1")
    inbox.poll(0.0)
    now, pauses = 20.0, []
    while delivery := inbox.poll(now):
        pause = inbox.mark_failed(delivery, now)
        if pause is None:
            break
        assert inbox.poll(now + pause - 1.0) is None
        pauses.append(pause)
        now += pause
    assert pauses == sorted(set(pauses))
    assert len(pauses) == 4
    assert inbox.poll(now + 1e6) is None  # often enough
    (folder / "b.img").write_bytes(b"1")
    inbox.poll(now + 1e6)
    assert inbox.poll(now + 1e6 + 20.0) is not None  # another delivery


def test_the_number_of_failed_deliveries_survives_a_restart(inbox, folder, tmp_path):
    (folder / "a.img").write_bytes(b"1")
    inbox.poll(0.0)
    delivery = inbox.poll(20.0)
    for _ in range(4):
        assert inbox.mark_failed(delivery) is not None
    again = Inbox(folder, tmp_path / "inbox.json", PARAMS)
    again.poll(0.0)
    assert again.poll(20.0) == delivery
    assert again.mark_failed(delivery) is None
    assert again.poll(1e9) is None
    again.mark_processed("another")
    assert json.loads((tmp_path / "inbox.json").read_text()) == {"delivery": "another"}


def test_names_that_are_not_utf_8_are_delivered(inbox, folder):
    (folder / "\udcff.img").write_bytes(b"1")
    inbox.poll(0.0)
    assert inbox.poll(20.0) is not None


def test_unreadable_folders_stop_no_delivery(inbox, folder, monkeypatch):
    (folder / "a.img").write_bytes(b"1")
    (folder / "closed").mkdir()
    (folder / "closed" / "b.img").write_bytes(b"1")
    look = Path.stat

    def refuse(path, **options):
        if path.parent.name == "closed":  # as where a folder may be listed and not entered
            raise PermissionError(13, "Permission denied")
        return look(path, **options)

    monkeypatch.setattr(Path, "stat", refuse)
    assert inbox.poll(0.0) is None
    assert inbox.poll(20.0) is not None
