"""The files of a downlink: which are taken, which label belongs to which, how they are kept."""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from solmap.photogrammetry.archive.images.pixels import is_picture
from solmap.photogrammetry.archive.images.reading import (
    has_attached_label,
)
from solmap.photogrammetry.archive.labels.detached import MAX_DETACHED_BYTES, join_label
from solmap.photogrammetry.errors import LabelError
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.products.store.user_files import plain_name, read_user_file
from solmap.tasks.scopes import file_scope

IMAGE_SUFFIXES = frozenset({".img"})
PICTURE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
VECTOR_SUFFIXES = frozenset({".svf", ".rvf"})
MANUAL_TIE_SUFFIXES = (".ties.csv", ".ties.geojson")
LABEL_ENDINGS = (".lbl", ".LBL", ".xml", ".XML", "-metadata.json", ".json")
"""What follows the stem of an image in the name of its label, where that is a file of its own."""


NO_FILES = "it holds no image (.img, .png, .jpg) and no vector file (.svf, .rvf)"
"""What is said of a folder without any of them."""


def files_of(downlink: Path) -> list[Path]:
    """Every image, picture, vector file and file of manual ties below a folder, by name.

    Suffixes may be written in any case. What bears such a name and is no file is among them, and so
    is a folder that cannot be read: whoever opens it says so.

    A picture that is called after an image beside it (X.png or X.img.jpg beside X.img) shows the
    same in eight bits, and is left out.
    """
    known = IMAGE_SUFFIXES | PICTURE_SUFFIXES | VECTOR_SUFFIXES
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
        if path.suffix.lower() not in PICTURE_SUFFIXES
        or (path.parent, path.stem.lower()) not in shown
    ]


def _below(folder: Path) -> Iterator[tuple[Path, bool]]:
    """What lies below a folder but its folders; of these, with True, those that cannot be read."""
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


def is_settled(file: Path, settle_s: float) -> bool:
    """Whether a file, and the label beside it, have not changed for so many seconds.

    A date in the future is a clock that goes wrong, and no file that still arrives.
    """
    if settle_s <= 0.0:
        return True
    now = time.time()
    facts = (_facts(part) for part in (file, *_labels_beside(file)))
    ages = (now - known.st_mtime for known in facts if known is not None)
    return all(age >= settle_s or age < 0.0 for age in ages)


def image_bytes(path: Path, folder: Path | None = None) -> bytes:
    """An image with its label: as it came, or joined to the label that lies beside it.

    `folder` is that of the delivery, which links may not leave (`open_user_file`).

    Raises:
        LabelError: it is a picture without a label.
        OSError: it is no regular file, too large, or cannot be read.
    """
    data = read_user_file(path, folder)
    if has_attached_label(data):
        return data
    for label in _labels_beside(path):
        return join_label(read_user_file(label, folder), data, plain_name(label.name))
    if is_picture(data):
        name, stem = plain_name(path.name), plain_name(path.stem)
        raise LabelError(
            f"{name}: a picture without a label; it takes {stem}-metadata.json, .xml or "
            ".lbl beside it to say where it was taken from"
        )
    return data


def _labels_beside(path: Path) -> Iterator[Path]:
    for ending in LABEL_ENDINGS:
        label = path.with_name(path.stem + ending)
        facts = _facts(label)
        is_file = facts is not None and stat.S_ISREG(facts.st_mode)
        if facts is not None and is_file and facts.st_size <= MAX_DETACHED_BYTES:
            yield label


def _facts(path: Path) -> os.stat_result | None:
    """What the system says of a file; None where there is none or it cannot be asked."""
    try:
        return path.stat()
    except OSError:  # also of names that are too long
        return None


def is_manual_tie_file(name: str) -> bool:
    """Whether a file of a downlink holds manual ties, by its name."""
    return name.lower().endswith(MANUAL_TIE_SUFFIXES)


@dataclass(frozen=True, slots=True)
class ContentDigest:
    """What an ingested file is made from: its content."""

    sha256: str

    @classmethod
    def of(cls, data: bytes) -> ContentDigest:
        """The digest of a file."""
        return cls(hashlib.sha256(data).hexdigest())


def keep_file(kind: ProductKind, name: str, data: bytes, store: ProductStore) -> ProductRef:
    """Keep a file that is about more than one image, as it came, under its name and content."""
    recipe = Recipe(kind, file_scope(name), params=ContentDigest.of(data))
    return store.make(recipe, lambda draft: write_bytes(draft, data))


def keep_vector_file(name: str, data: bytes, store: ProductStore) -> ProductRef:
    """Keep a vector file beside earlier ones of its name: files add to each other."""
    return keep_file(
        ProductKind.VECTORS, f"{name}-{ContentDigest.of(data).sha256[:8]}", data, store
    )


def write_bytes(draft: Path, data: bytes) -> None:
    """Write a file as it came."""
    draft.write_bytes(data)
