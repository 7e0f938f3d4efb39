"""Files delivered or named by people: only regular files are opened, and they are read in bounds.

A folder may contain a FIFO, whose reading never ends, a device, whose reading has effects, or a
link to a file outside. Links to regular files of the same folder are permitted. Others raise
`OSError`, with the reason in `strerror`.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from solmap.products.errors import printable

MAX_FILE_BYTES = 256 << 20
"""Largest size of an image file: three bands of floats of the largest rover camera have 236 MB."""
MAX_ROWS_BYTES = 4 << 20
"""Largest size of vector files and manual ties: 138 sites take 55 kB, 10,000 ties 1 MB."""
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


@contextmanager
def open_user_file(path: Path, folder: Path | None = None) -> Iterator[BufferedReader]:
    """A file opened for reading, after a check of its type.

    Args:
        path: Its path.
        folder: Folder within which links are permitted: that of a delivery; by default that of
            the file.

    Raises:
        OSError: it is not a regular file, is outside the folder, or cannot be opened.
    """
    folder = (folder or path.parent).resolve()
    try:
        place = path.resolve(strict=True)
    except RuntimeError:  # raised by Python 3.11 for links in a circle
        raise OSError(errno.ELOOP, "a link to itself", str(path)) from None
    if path.is_symlink() and not place.is_relative_to(folder):
        raise OSError(
            errno.EACCES, "a link that leads out of its folder is not followed", str(path)
        )
    _check_regular(path, place.lstat())  # opening a device may have effects
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_NOCTTY | os.O_CLOEXEC
    with os.fdopen(os.open(place, flags), "rb") as file:
        _check_regular(path, os.fstat(file.fileno()))  # another file may be there by now
        opened = Path(f"/proc/self/fd/{file.fileno()}")
        if opened.exists() and opened.readlink() != place:  # by a folder replaced by a link
            raise OSError(errno.EACCES, "it was replaced while it was opened", str(path))
        yield file


def read_user_file(
    path: Path, folder: Path | None = None, *, most_bytes: int = MAX_FILE_BYTES
) -> bytes:
    """The bytes of a file that `open_user_file` opens.

    At most its size is read, so that kernel files without size end at once.

    Raises:
        OSError: it is not such a file, is larger than `most_bytes`, or cannot be read.
    """
    with open_user_file(path, folder) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most_bytes:
            text = f"{size} bytes are too many: at most {most_bytes} of such a file are read"
            raise OSError(errno.EFBIG, text, str(path))
        return file.read(size)


def reason_of(error: OSError) -> str:
    """The reason why a file could not be read, without its number and path."""
    return error.strerror or str(error)


def plain_name(name: str) -> str:
    """A file's name as text that can be printed, stored and sent.

    Bytes that are not UTF-8, control characters and marks that turn the direction of writing are
    escaped.
    """
    return printable(os.fsencode(name).decode("utf-8", "backslashreplace"))


def _check_regular(path: Path, facts: os.stat_result) -> None:
    if not stat.S_ISREG(facts.st_mode):
        kind = _KINDS.get(stat.S_IFMT(facts.st_mode), "of an unknown type")
        raise OSError(errno.EINVAL, f"it is {kind}; only regular files are read", str(path))
