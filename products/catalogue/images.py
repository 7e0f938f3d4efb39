"""Images as products: labels and pixels, read through the catalogue.

A run needs the labels of a whole mission to chain its stops; parsing those of ten thousand images
takes a minute. So labels are cached as JSON in the catalogue's database, under the digest of the
image and the version of the reader. The cache can be rebuilt from the images.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from solmap.photogrammetry.archive.images.reading import (
    ReadImage,
    read_image,
    read_image_record,
)
from solmap.photogrammetry.archive.images.record_json import label_of_text, text_of_label
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.imagery import RoverImage
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.database import LABELS, upsert, write_transaction
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import StoreFullError, StoreReadOnlyError
from solmap.products.formats.documents.archives import read_radiometry
from solmap.products.model import SCIENCE_VERSION, ProductRef
from solmap.products.store.product_store import ProductStore

_READER = f"{SCIENCE_VERSION}/{version('solmap')}"
_AT_ONCE = 500
"""Rows read or written in one statement."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelCache:
    """The labels in the catalogue's database."""

    engine: sa.Engine

    def find(self, digests: Iterable[str]) -> dict[str, RoverImage]:
        """The cached labels of some images, by the digest of the image."""
        found: dict[str, RoverImage] = {}
        with self.engine.connect() as connection:
            for some in _batches(digests):
                names = [f"{digest}/{_READER}" for digest in some]
                query = sa.select(LABELS).where(LABELS.c.digest.in_(names))
                for name, text in connection.execute(query):
                    # read again, and rejected then
                    with contextlib.suppress(PhotogrammetryError):
                        found[name.partition("/")[0]] = label_of_text(text)
        return found

    def keep(self, labels: Mapping[str, RoverImage]) -> None:
        """Store labels by the digests of their images; nothing without write permission."""
        try:
            with write_transaction(self.engine) as connection:
                for digest, label in labels.items():
                    text = {"document": text_of_label(label)}
                    upsert(connection, LABELS, {"digest": f"{digest}/{_READER}"}, text)
        except (SQLAlchemyError, StoreFullError, StoreReadOnlyError):
            return


def _batches(digests: Iterable[str]) -> Iterable[list[str]]:
    known = list(digests)
    return (known[start : start + _AT_ONCE] for start in range(0, len(known), _AT_ONCE))


REMEMBERED = 1 << 15
"""Labels kept in memory per process: more than the Navcam frames of a rover; about 6 kB each."""


@dataclass(frozen=True, slots=True)
class ImageFile:
    """An ingested image, with the tables and flat fields for reading its pixels."""

    image: ProductRef
    radiometry: ProductRef | None = None
    """Radiometric tables; None: the pixels as they are stored."""

    @property
    def inputs(self) -> tuple[ProductRef, ...]:
        """The products that its pixels depend on."""
        return (self.image,) if self.radiometry is None else (self.image, self.radiometry)


def image_file(entry: ImageEntry) -> ImageFile:
    """The file of a catalogued image."""
    return ImageFile(entry.ref, entry.radiometry)


def read_product_image(file: ImageFile, store: ProductStore) -> ReadImage:
    """An ingested image, label and pixels."""
    radiometry = None if file.radiometry is None else read_radiometry(store.path(file.radiometry))
    data = store.path(file.image).read_bytes()
    return read_image(data, f"{file.image.scope.name}.img", radiometry=radiometry)


def read_product_record(file: ImageFile, store: ProductStore) -> RoverImage:
    """The label of an ingested image, from memory if the process has read it."""
    known = _remembered.get((store.root, file.image.digest))
    if known is not None:
        return known
    data = store.path(file.image).read_bytes()
    return read_image_record(data, f"{file.image.scope.name}.img")


def image_record(entry: ImageEntry, workspace: Workspace) -> RoverImage:
    """The label of an ingested image; read once per process, because products never change."""
    name = _name(entry, workspace)
    known = _remembered.get(name)
    if known is None:
        known = read_image_record(workspace.store.path(entry.ref).read_bytes(), f"{entry.id}.IMG")
        _remember({name: known})
    return known


def image_records(entries: Iterable[ImageEntry], workspace: Workspace) -> list[RoverImage]:
    """The labels of several ingested images; they are cached in the catalogue."""
    requested = {_name(entry, workspace): entry for entry in entries}
    book = LabelCache(workspace.catalogue.engine)
    kept = book.find(digest for root, digest in requested if (root, digest) not in _remembered)
    _remember({(workspace.store.root, digest): label for digest, label in kept.items()})
    fresh = [name for name in requested if name not in _remembered]
    records = {name: image_record(entry, workspace) for name, entry in requested.items()}
    if fresh:
        book.keep({name[1]: records[name] for name in fresh})
    return list(records.values())


_Name = tuple[Path, str]
_remembered: dict[_Name, RoverImage] = {}
"""Labels by their store and the digests of their images, the oldest first."""


def _name(entry: ImageEntry, workspace: Workspace) -> _Name:
    return workspace.store.root, entry.ref.digest


def _remember(labels: Mapping[_Name, RoverImage]) -> None:
    _remembered.update(labels)
    for name in list(_remembered)[: max(0, len(_remembered) - REMEMBERED)]:
        _remembered.pop(name, None)
