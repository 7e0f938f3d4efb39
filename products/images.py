"""Images as products: how their labels and pixels are read back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from photogrammetry.imagery import RoverImage
from photogrammetry.pds3.reading import ReadImage, read_image, read_image_record
from products.catalogue import ImageEntry
from products.model import ProductRef
from products.radiometry import read_radiometry
from products.store import ProductStore
from products.workspace import Workspace

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
    return _record(workspace.store.path(entry.ref), entry.id)


def image_records(entries: Iterable[ImageEntry], workspace: Workspace) -> list[RoverImage]:
    """The labels of several ingested images."""
    return [image_record(entry, workspace) for entry in entries]


@lru_cache(maxsize=REMEMBERED)
def _record(path: Path, image_id: str) -> RoverImage:
    return read_image_record(path.read_bytes(), f"{image_id}.IMG")
