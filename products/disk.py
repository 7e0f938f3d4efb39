"""Whether a write failed because the disk is full."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

NEXT_TO_NOTHING = 1 << 20
"""Bytes free on a disk that a failed write is blamed on."""


def is_full(folder: Path, error: Exception) -> bool:
    """Whether `error`, met while writing below `folder`, means that its disk is full.

    Libraries often say only that writing failed; then the space that is left tells.
    """
    number = error.errno if isinstance(error, OSError) else None
    full = number in (errno.ENOSPC, errno.EDQUOT)
    return full or shutil.disk_usage(folder).free < NEXT_TO_NOTHING
