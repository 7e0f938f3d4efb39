"""What trying again may help against, and what it cannot."""

import errno
import sqlite3
import time
from pathlib import Path

import pytest
import sqlalchemy as sa
from sqlalchemy.exc import OperationalError

from solmap.photogrammetry.errors import MatchingError
from solmap.products.errors import ProductError, StoreAwayError, StoreFullError
from solmap.products.store.faults import is_transient, retry_transient


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.EIO, "Input/output error"),
        OSError(errno.ESTALE, "Stale file handle"),
        BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"),
        ConnectionResetError(errno.ECONNRESET, "Connection reset by peer"),
        TimeoutError("no answer"),
        StoreAwayError("the bucket does not answer"),
    ],
)
def test_disk_and_network_errors_are_transient(error: Exception) -> None:
    assert is_transient(error)


@pytest.mark.parametrize(
    "error",
    [
        MatchingError("no texture"),
        ProductError("broken"),
        StoreFullError("the disk is full"),
        OSError(errno.ENOSPC, "No space left on device"),
        OSError(errno.EDQUOT, "Disk quota exceeded"),
        FileNotFoundError(errno.ENOENT, "No such file or directory"),
        PermissionError(errno.EACCES, "Permission denied"),
        OSError("no number at all"),
        MemoryError(),
        ValueError("a mistake"),
        KeyboardInterrupt(),
    ],
)
def test_deterministic_errors_are_not_transient(error: BaseException) -> None:
    assert not is_transient(error)


def test_a_locked_database_is_transient_and_a_missing_table_is_not(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'catalogue.sqlite'}"
    engine = sa.create_engine(url, connect_args={"timeout": 0.05})
    with sqlite3.connect(tmp_path / "catalogue.sqlite") as holder:
        holder.execute("CREATE TABLE kept(number)")
        holder.commit()
        holder.execute("BEGIN EXCLUSIVE")
        with engine.connect() as other, pytest.raises(OperationalError, match="locked") as locked:
            other.execute(sa.text("SELECT * FROM kept"))
        holder.rollback()
    with engine.connect() as other, pytest.raises(OperationalError, match="no such") as missing:
        other.execute(sa.text("SELECT * FROM lost"))
    holder.close()
    engine.dispose()
    assert is_transient(locked.value)
    assert not is_transient(missing.value)


def test_a_full_database_is_not_transient(tmp_path: Path) -> None:
    small = sqlite3.connect(tmp_path / "small.sqlite")
    small.execute("PRAGMA max_page_count = 2")
    with pytest.raises(sqlite3.OperationalError, match="full") as full:
        small.execute("CREATE TABLE a(b)").execute("CREATE TABLE c(d)")
    small.close()
    assert not is_transient(full.value)


def test_a_transient_error_is_retried_three_times_and_any_other_not_once(monkeypatch) -> None:
    pauses: list[float] = []
    monkeypatch.setattr(time, "sleep", pauses.append)
    errors: list[Exception] = [OSError(errno.EIO, "stumbled")] * 3

    def call() -> str:
        if errors:
            raise errors.pop()
        return "read"

    assert retry_transient(call) == "read"
    assert pauses == [0.5, 2.0, 8.0]
    errors += [OSError(errno.EIO, "stumbled")] * 5
    with pytest.raises(OSError, match="stumbled"):
        retry_transient(call)
    assert len(errors) == 1
    errors[:] = [ValueError("wrong")] * 2
    with pytest.raises(ValueError, match="wrong"):
        retry_transient(call)
    assert len(errors) == 1
