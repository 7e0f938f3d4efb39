"""The log of edits is only appended to; taking back is an edit that can be taken back."""

import sqlite3

import pytest

from solmap.products.catalogue.edits import (
    EditConflictError,
    EditKind,
    EditLog,
    RequestKind,
    RequestState,
    RunRequests,
)
from solmap.products.errors import ProductNotFoundError


@pytest.fixture
def log(tmp_path):
    return EditLog.of(tmp_path)


def counting(log):
    return [edit.id for edit in log.edits("MER2") if edit.counts]


def test_edits_are_read_in_order_with_author_and_reason(log):
    log.append("MER2", EditKind.TIE, {"action": "veto"}, "Ada", "wrong rock")
    log.append("MER1", EditKind.ANNOTATION, {"text": "Endurance"}, "Ben")
    (edit,) = log.edits("MER2")
    assert (edit.document, edit.author, edit.note) == ({"action": "veto"}, "Ada", "wrong rock")
    assert [one.mission for one in log.edits()] == ["MER2", "MER1"]
    assert log.effective(EditKind.TIE) == [edit]


def test_a_revoked_edit_does_not_count_until_the_revocation_is_revoked(log):
    first = log.append("MER2", EditKind.TIE, {}, "Ada")
    log.append("MER2", EditKind.TIE, {}, "Ada")
    back = log.undo("MER2", first.id, "Ben")
    assert counting(log) == [2, 3]
    again = log.undo("MER2", back.id, "Ada")
    assert counting(log) == [1, 2, 4]
    log.undo("MER2", again.id, "Ben")
    assert counting(log) == [2, 3, 5]
    assert len(log.edits("MER2")) == 5


def test_an_edit_is_revoked_once_and_only_by_its_mission(log):
    edit = log.append("MER2", EditKind.TIE, {}, "Ada")
    log.undo("MER2", edit.id, "Ada")
    with pytest.raises(EditConflictError, match="undone already"):
        log.undo("MER2", edit.id, "Ben")
    with pytest.raises(ProductNotFoundError, match="MER1 has no edit 1"):
        log.undo("MER1", edit.id, "Ben")


@pytest.mark.parametrize("sql", ["DELETE FROM edits", "UPDATE edits SET author = 'Eve'"])
def test_the_database_refuses_to_delete_edits(log, sql):
    log.append("MER2", EditKind.TIE, {}, "Ada")
    with sqlite3.connect(log.path) as connection, pytest.raises(sqlite3.IntegrityError):
        connection.execute(sql)
    assert [edit.author for edit in log.edits()] == ["Ada"]


def test_nothing_is_written_before_the_first_edit(log):
    assert log.edits() == []
    assert not log.path.exists()


def test_identical_run_requests_are_stored_once_until_taken(tmp_path):
    book = RunRequests.of(tmp_path)
    first = book.add(RequestKind.OVERALL, "MER2", "Ada")
    assert book.add(RequestKind.OVERALL, "MER2", "Ben") == first
    other = book.add(RequestKind.OVERALL, None, "Ben")
    assert [one.id for one in book.waiting()] == [first.id, other.id]
    book.answer(first.id, RequestState.TAKEN, "wise-lynx")
    assert [one.id for one in book.waiting()] == [other.id]
    later = book.add(RequestKind.OVERALL, "MER2", "Ada")
    assert later.id not in (first.id, other.id)
    assert book.requests()[-1].answer == "wise-lynx"
