"""The files of a downlink: which label belongs to which, how they are kept."""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from solmap.photogrammetry.archive.file_names import parse_file_name
from solmap.photogrammetry.archive.images.derived_rasters import KINDS
from solmap.photogrammetry.archive.images.pixels import is_picture
from solmap.photogrammetry.archive.images.reading import (
    describe_image,
    has_attached_label,
)
from solmap.photogrammetry.archive.labels.detached import MAX_DETACHED_BYTES, join_label
from solmap.photogrammetry.errors import LabelError
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.products.store.user_files import plain_name, read_user_file
from solmap.tasks.images.folders import IMAGE_SUFFIXES, PICTURE_SUFFIXES
from solmap.tasks.scopes import file_scope

LABEL_ENDINGS = (".lbl", ".LBL", ".xml", ".XML", "-metadata.json", ".json")
"""What follows the stem of an image in the name of its label, where that is a file of its own."""


OWN_RIG = "`solmap run` takes pictures of an own stereo rig from a folder with a rig.toml"
FETCHED = frozenset({"NAVCAM", "PANCAM", "MASTCAM", "FRONT_HAZCAM", "REAR_HAZCAM"})
"""Instruments that `solmap fetch` brings."""


def remedy(name: str) -> str:
    """What helps with a file that cannot be taken: a command, by the file's name.

    Empty where the name says nothing of the image.
    """
    try:
        found = parse_file_name(name)
    except LabelError:
        return ""
    if found.product_type in KINDS and Path(name).suffix.lower() in IMAGE_SUFFIXES:
        return f"`solmap inspect {name}` says what it holds"
    if found.sol is None or found.instrument not in FETCHED or found.sol < 0:
        return ""
    is_raw = Path(name).suffix.lower() in PICTURE_SUFFIXES and not found.mission.startswith("MER")
    return (
        f"`solmap fetch --mission {found.mission} --sols {found.sol} --instrument "
        f"{found.instrument.lower()}{' --raw' * is_raw} --out FOLDER` brings the images of that sol"
    )


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
            f"; {remedy(name) or OWN_RIG}"
        )
    return data


def may_be_of_use(path: Path, downlink: Path) -> bool:
    """Whether a file of a downlink is anything but an image that cannot be described."""
    if path.suffix.lower() not in IMAGE_SUFFIXES | PICTURE_SUFFIXES:
        return True
    try:
        describe_image(image_bytes(path, downlink), plain_name(path.name))
    except Exception:  # noqa: BLE001 - whoever takes the file says what is wrong with it
        return False
    return True


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
