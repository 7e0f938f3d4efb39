"""A store as an earlier version left it: two stops, all layers, edits, tokens, requests, runs."""

from __future__ import annotations

import tarfile
from pathlib import Path

ARCHIVE = Path(__file__).resolve().parents[1] / "fixtures" / "store-unversioned.tar.xz"
"""Made by commit f1db3ea, before stores had a version; its token is in `token.txt`."""
LAYERS, IMAGES, EDITS, EVENTS = 57, 4, 3, 59


def unpack_old_store(folder: Path) -> Path:
    """Unpack it below a folder; its root."""
    with tarfile.open(ARCHIVE) as tar:
        tar.extractall(folder, filter="data")
    return folder / "store"
