"""The files of a downlink: labels of images, and how files are stored."""

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
from solmap.photogrammetry.archive.images.pixels import is_image_file
from solmap.photogrammetry.archive.images.reading import (
    describe_image,
    has_attached_label,
)
from solmap.photogrammetry.archive.labels.detached import MAX_DETACHED_BYTES, join_label
from solmap.photogrammetry.errors import LabelError
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.products.store.user_files import plain_name, read_user_file
from solmap.tasks.images.folders import IMAGE_FILE_SUFFIXES, IMAGE_SUFFIXES
from solmap.tasks.scopes import file_scope

LABEL_ENDINGS = (".lbl", ".LBL", ".xml", ".XML", "-metadata.json", ".json")
"""Suffixes of detached labels after the stem of an image."""


OWN_RIG = "`solmap run` ingests images of an own stereo rig from a folder with a rig.toml"
FETCHED = frozenset({"NAVCAM", "PANCAM", "MASTCAM", "FRONT_HAZCAM", "REAR_HAZCAM"})
"""Instruments that `solmap fetch` supports."""


def remedy(name: str) -> str:
    """Remedy for a file that cannot be ingested: a command, by the file's name.

    Empty where the name does not identify the image.
    """
    try:
        found = parse_file_name(name)
    except LabelError:
        return ""
    if found.product_type in KINDS and Path(name).suffix.lower() in IMAGE_SUFFIXES:
        return f"`solmap inspect {name}` prints its content"
    if found.sol is None or found.instrument not in FETCHED or found.sol < 0:
        return ""
    is_raw = Path(name).suffix.lower() in IMAGE_FILE_SUFFIXES and not found.mission.startswith(
        "MER"
    )
    return (
        f"`solmap fetch --mission {found.mission} --sols {found.sol} --instrument "
        f"{found.instrument.lower()}{' --raw' * is_raw} --out FOLDER` fetches the images of that "
        "sol"
    )


def is_settled(file: Path, settle_s: float) -> bool:
    """Whether a file, and the label beside it, have not changed for that many seconds.

    A date in the future is a wrong clock, not a file that is still arriving.
    """
    if settle_s <= 0.0:
        return True
    now = time.time()
    facts = (_facts(part) for part in (file, *_labels_beside(file)))
    ages = (now - known.st_mtime for known in facts if known is not None)
    return all(age >= settle_s or age < 0.0 for age in ages)


def image_bytes(path: Path, folder: Path | None = None) -> bytes:
    """An image with its label: as delivered, or joined to the label beside it.

    `folder` is that of the delivery, which links may not leave (`open_user_file`).

    Raises:
        LabelError: it is an image without a label.
        OSError: it is not a regular file, is too large, or cannot be read.
    """
    data = read_user_file(path, folder)
    if has_attached_label(data):
        return data
    for label in _labels_beside(path):
        return join_label(read_user_file(label, folder), data, plain_name(label.name))
    if is_image_file(data):
        name, stem = plain_name(path.name), plain_name(path.stem)
        raise LabelError(
            f"{name}: an image without a label; {stem}-metadata.json, .xml or .lbl beside it "
            f"should give its camera and pose; {remedy(name) or OWN_RIG}"
        )
    return data


def may_be_of_use(path: Path, downlink: Path) -> bool:
    """Whether a file of a downlink is anything but an image that cannot be described."""
    if path.suffix.lower() not in IMAGE_SUFFIXES | IMAGE_FILE_SUFFIXES:
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
    """The file's status; None where there is no file or the status is not available."""
    try:
        return path.stat()
    except OSError:  # also for names that are too long
        return None


@dataclass(frozen=True, slots=True)
class ContentDigest:
    """Recipe parameters of an ingested file: the digest of its content."""

    sha256: str

    @classmethod
    def of(cls, data: bytes) -> ContentDigest:
        """The digest of a file."""
        return cls(hashlib.sha256(data).hexdigest())


def keep_file(kind: ProductKind, name: str, data: bytes, store: ProductStore) -> ProductRef:
    """Store a file that concerns more than one image unchanged, by its name and content."""
    recipe = Recipe(kind, file_scope(name), params=ContentDigest.of(data))
    return store.make(recipe, lambda draft: write_bytes(draft, data))


def keep_vector_file(name: str, data: bytes, store: ProductStore) -> ProductRef:
    """Store a vector file beside earlier ones of its name: their contents are combined."""
    return keep_file(
        ProductKind.VECTORS, f"{name}-{ContentDigest.of(data).sha256[:8]}", data, store
    )


def write_bytes(draft: Path, data: bytes) -> None:
    """Write a file unchanged."""
    draft.write_bytes(data)
