"""Images as products: how their labels and pixels are read back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from solmap.photogrammetry.archive.reading import ReadImage, read_image, read_image_record
from solmap.photogrammetry.imagery import RoverImage
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.labels import LabelBook
from solmap.products.model import ProductRef
from solmap.products.radiometry import read_radiometry
from solmap.products.store.product_store import ProductStore

REMEMBERED = 1 << 15
"""Labels that one process keeps: more than the Navcam frames of a rover; some 6 kB each."""


@dataclass(frozen=True, slots=True)
class ImageFile:
    """An ingested image, and the tables and flat fields that its pixels are read with."""

    image: ProductRef
    radiometry: ProductRef | None = None
    """None: the pixels are taken as they are stored."""

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


def image_record(entry: ImageEntry, workspace: Workspace) -> RoverImage:
    """The label of an ingested image; read once a process, for a product never changes."""
    name = _name(entry, workspace)
    known = _remembered.get(name)
    if known is None:
        known = read_image_record(workspace.store.path(entry.ref).read_bytes(), f"{entry.id}.IMG")
        _remember({name: known})
    return known


def image_records(entries: Iterable[ImageEntry], workspace: Workspace) -> list[RoverImage]:
    """The labels of several ingested images; the catalogue keeps them from now on."""
    asked = {_name(entry, workspace): entry for entry in entries}
    book = LabelBook(workspace.catalogue.engine)
    kept = book.known(digest for root, digest in asked if (root, digest) not in _remembered)
    _remember({(workspace.store.root, digest): label for digest, label in kept.items()})
    fresh = [name for name in asked if name not in _remembered]
    records = {name: image_record(entry, workspace) for name, entry in asked.items()}
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
