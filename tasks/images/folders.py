"""Files of a folder that belong to a downlink. Imports nothing: `solmap run` calls it first."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

IMAGE_SUFFIXES = frozenset({".img"})
IMAGE_FILE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
VECTOR_SUFFIXES = frozenset({".svf", ".rvf"})
MANUAL_TIE_SUFFIXES = (".ties.csv", ".ties.geojson")
NO_FILES = "it holds no image (.img, .png, .jpg) and no vector file (.svf, .rvf)"
"""Message for a folder without any of them."""


def files_of(downlink: Path) -> list[Path]:
    """Every image, vector file and file of manual ties below a folder, by name.

    Suffixes may be written in any case. Entries of such a name that are not files are included, and
    so are unreadable folders: opening them reports the error.

    A PNG or JPEG named after an image beside it (X.png or X.img.jpg beside X.img) is an eight-bit
    copy, and is left out.
    """
    known = IMAGE_SUFFIXES | IMAGE_FILE_SUFFIXES | VECTOR_SUFFIXES
    files = sorted(
        path
        for path, is_closed in _below(downlink)
        if is_closed or path.suffix.lower() in known or is_manual_tie_file(path.name)
    )
    images = [path for path in files if path.suffix.lower() in IMAGE_SUFFIXES]
    shown = {(path.parent, name.lower()) for path in images for name in (path.stem, path.name)}
    return [
        path
        for path in files
        if path.suffix.lower() not in IMAGE_FILE_SUFFIXES
        or (path.parent, path.stem.lower()) not in shown
    ]


def _below(folder: Path) -> Iterator[tuple[Path, bool]]:
    """Entries below a folder except its folders; with True, unreadable folders."""
    waiting = [folder]
    while waiting:
        here = waiting.pop()
        try:
            found = [
                (here / one.name, one.is_dir(follow_symlinks=False)) for one in os.scandir(here)
            ]
        except OSError:
            yield here, True
            continue
        waiting += [path for path, is_folder in found if is_folder]
        yield from ((path, False) for path, is_folder in found if not is_folder)


def is_manual_tie_file(name: str) -> bool:
    """Whether a file of a downlink contains manual ties, by its name."""
    return name.lower().endswith(MANUAL_TIE_SUFFIXES)
