"""The files of a downlink: which are taken, which label belongs to which, how they are kept."""

from __future__ import annotations

import hashlib
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
from solmap.tasks.scopes import file_scope

IMAGE_SUFFIXES = frozenset({".img"})
PICTURE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
VECTOR_SUFFIXES = frozenset({".svf", ".rvf"})
MANUAL_TIE_SUFFIXES = (".ties.csv", ".ties.geojson")
LABEL_ENDINGS = (".lbl", ".LBL", ".xml", ".XML", "-metadata.json", ".json")
"""What follows the stem of an image in the name of its label, where that is a file of its own."""
MAX_FILE_BYTES = 256 << 20
"""Far above any frame of these cameras; a larger file is not read into memory."""


def files_of(downlink: Path) -> list[Path]:
    """Every image, picture, vector file and file of manual ties below a folder, by name.

    Suffixes may be written in any case.

    A picture that is called after an image beside it (X.png or X.img.jpg beside X.img) shows the
    same in eight bits, and is left out.
    """
    known = IMAGE_SUFFIXES | PICTURE_SUFFIXES | VECTOR_SUFFIXES
    files = [
        path
        for path in downlink.rglob("*")
        if path.suffix.lower() in known or is_manual_tie_file(path.name)
    ]
    files = sorted(path for path in files if path.is_file())
    images = [path for path in files if path.suffix.lower() in IMAGE_SUFFIXES]
    shown = {(path.parent, name.lower()) for path in images for name in (path.stem, path.name)}
    return [
        path
        for path in files
        if path.suffix.lower() not in PICTURE_SUFFIXES
        or (path.parent, path.stem.lower()) not in shown
    ]


def is_settled(file: Path, settle_s: float) -> bool:
    """Whether a file, and the label beside it, have not changed for so many seconds.

    A date in the future is a clock that goes wrong, and no file that still arrives.
    """
    if settle_s <= 0.0:
        return True
    now = time.time()
    ages = (now - part.stat().st_mtime for part in (file, *_labels_beside(file)) if part.exists())
    return all(age >= settle_s or age < 0.0 for age in ages)


def file_bytes(path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        LabelError: it is too large for an image.
        OSError: it cannot be read.
    """
    size = path.stat().st_size
    if size > MAX_FILE_BYTES:
        raise LabelError(f"{path.name} is {size >> 20} MiB: no image of these cameras")
    return path.read_bytes()


def image_bytes(path: Path) -> bytes:
    """An image with its label: as it came, or joined to the label that lies beside it.

    Raises:
        LabelError: it is too large, or a picture without a label.
        OSError: it cannot be read.
    """
    data = file_bytes(path)
    if has_attached_label(data):
        return data
    for label in _labels_beside(path):
        return join_label(label.read_bytes(), data, label.name)
    if is_picture(data):
        raise LabelError(
            f"{path.name}: a picture without a label; it takes {path.stem}-metadata.json, .xml or "
            ".lbl beside it to say where it was taken from"
        )
    return data


def _labels_beside(path: Path) -> Iterator[Path]:
    for ending in LABEL_ENDINGS:
        label = path.with_name(path.stem + ending)
        if label.is_file() and label.stat().st_size <= MAX_DETACHED_BYTES:
            yield label


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


def write_bytes(draft: Path, data: bytes) -> None:
    """Write a file as it came."""
    draft.write_bytes(data)
