"""Errors of disks, networks and databases: transient ones, and full disks.

A transient error may be gone at the next attempt: a network file system hangs for a moment, or
another process holds the database. Images that cannot be matched, wrong settings and a full disk
fail in the same way again.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from sqlalchemy.exc import DBAPIError, OperationalError

from solmap.products.errors import StoreAwayError, StoreReadOnlyError

T = TypeVar("T")

_ATTEMPTS = 4
_FIRST_PAUSE_S, _PAUSE_RATIO = 0.5, 4
"""Pauses of 0.5, 2 and 8 s between the attempts."""

TRANSIENT_ERRNOS = {
    errno.EIO,
    errno.EREMOTEIO,
    errno.ESTALE,
    errno.EAGAIN,
    errno.EBUSY,
    errno.EINTR,
    errno.ENFILE,
    errno.EMFILE,
    errno.EPIPE,
    errno.ETIMEDOUT,
    errno.ECONNRESET,
    errno.ECONNABORTED,
    errno.ECONNREFUSED,
    errno.ENETDOWN,
    errno.ENETUNREACH,
    errno.ENETRESET,
    errno.EHOSTDOWN,
    errno.EHOSTUNREACH,
}
"""Error numbers of the system that are transient."""
_TRANSIENT_SQLITE = {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_IOERR}
_PRIMARY_CODE = 0xFF
"""Mask of the primary part of an SQLite error code; the rest is detail."""
_PARSED_AT_ONCE = "recursion depth mismatch"
"""Python 3.11 raises it, rarely, when two threads parse source text at once, of tracebacks too."""
_FULL_DISK = "53100"
"""PostgreSQL's code for it; it is not transient."""


def retry_transient(call: Callable[[], T]) -> T:
    """The result of a call, which is repeated after a transient error.

    For parts of a stage that may fail separately, like the files of a downlink; whole stages are
    retried by the engine.
    """
    from tenacity import (  # noqa: PLC0415 - slow to import, and commands that list retry nothing
        Retrying,
        retry_if_exception,
        stop_after_attempt,
        wait_exponential,
    )

    return Retrying(
        retry=retry_if_exception(is_transient),
        stop=stop_after_attempt(_ATTEMPTS),
        wait=wait_exponential(multiplier=_FIRST_PAUSE_S, exp_base=_PAUSE_RATIO),
        reraise=True,
    )(call)


def is_transient(error: BaseException) -> bool:
    """Whether an error may be gone at the next attempt."""
    if isinstance(error, StoreAwayError):
        return True
    if isinstance(error, sqlite3.Error):
        code: int = getattr(error, "sqlite_errorcode", 0)
        return code & _PRIMARY_CODE in _TRANSIENT_SQLITE
    if isinstance(error, DBAPIError):
        return _database_is_away(error)
    if isinstance(error, OSError):
        return error.errno in TRANSIENT_ERRNOS or isinstance(error, TimeoutError | ConnectionError)
    return isinstance(error, SystemError) and _PARSED_AT_ONCE in str(error)


def _database_is_away(error: DBAPIError) -> bool:
    """Whether the connection was lost, or another transaction interfered."""
    if isinstance(error.orig, sqlite3.Error):
        return is_transient(error.orig)
    return (
        isinstance(error, OperationalError) or error.connection_invalidated
    ) and not is_database_full(error)


def is_database_full(error: DBAPIError | sqlite3.Error) -> bool:
    """Whether a database could not be written because its disk is full."""
    cause = error.orig if isinstance(error, DBAPIError) else error
    code: int = getattr(cause, "sqlite_errorcode", 0)
    is_full = getattr(cause, "sqlstate", None) == _FULL_DISK
    return is_full or code & _PRIMARY_CODE == sqlite3.SQLITE_FULL


_FULL_BYTES = 1 << 20
"""Free bytes below which a failed write is attributed to a full disk."""


def is_disk_full(folder: Path, error: Exception) -> bool:
    """Whether `error`, raised while writing below `folder`, means that its disk is full.

    Libraries often report only that writing failed; then the free space decides.
    """
    number = error.errno if isinstance(error, OSError) else None
    full = number in (errno.ENOSPC, errno.EDQUOT)
    with contextlib.suppress(OSError):  # the disk is not available
        full = full or shutil.disk_usage(folder).free < _FULL_BYTES
    return full


def is_read_only(path: Path) -> bool:
    """Whether a folder, or a file and its folder, exists and this process may not change it."""
    folder = path if path.is_dir() else path.parent
    return any(there.exists() and not os.access(there, os.W_OK) for there in (folder, path))


def require_writable(root: Path) -> None:
    """Raise an error if the store at `root` exists and is read-only.

    Raises:
        StoreReadOnlyError: it is read-only.
    """
    if is_read_only(root):
        raise StoreReadOnlyError(
            f"{root} is read-only for this user or on this disk: its products can be served and "
            "listed; to change it, use a copy or its owner's account"
        )
