"""Storage backends: the bytes of a store in a folder or an object store.

Names are paths below the store, `products/dtm/<scope>/<digest>.tif`, the same in both. Named files
are always complete. The backend of object stores is `products.store.object_backend`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from solmap.products.errors import ProductError

_CHUNK = 1 << 20
_URL = "products.url"
"""File in the store's folder with the location of its products, if elsewhere."""


@dataclass(frozen=True, slots=True)
class ObjectStorage:
    """An object store for products."""

    url: str
    """URL, for example `s3://bucket/prefix`."""
    cache_gb: float = 20.0
    """Limit of local copies."""


class StorageBackend(Protocol):
    """A location for the files of a store. `FolderBackend` and `ObjectBackend` implement it."""

    def has(self, name: str) -> bool:
        """Whether there is a file of this name."""
        ...

    def path(self, name: str) -> Path | None:
        """A local file with the same bytes; None where there is none of this name."""
        ...

    def address(self, name: str) -> Path | str:
        """What GDAL opens to read parts of the file in place; nothing is requested or fetched."""
        ...

    def read(self, name: str) -> bytes | None:
        """A small file, completely; None where there is none."""
        ...

    def size(self, name: str) -> int | None:
        """Size of the file in bytes; None where there is none."""
        ...

    def chunks(self, name: str, start: int, end: int) -> Iterator[bytes]:
        """The bytes from `start` up to `end` in order, in pieces."""
        ...

    def put(self, file: Path, name: str, *, once: bool) -> None:
        """Move a complete file here under a name; with `once` an existing one may stay."""
        ...

    def names(self, folder: str) -> Iterator[str]:
        """All names below a folder, in no order."""
        ...

    def remove(self, name: str) -> None:
        """Remove the file; it may not exist any more."""
        ...


@dataclass(frozen=True, slots=True)
class FolderBackend:
    """A folder on a disk; files are renamed into it, so drafts are on the same disk."""

    root: Path

    def has(self, name: str) -> bool:
        """Whether there is a file of this name."""
        return (self.root / name).is_file()

    def path(self, name: str) -> Path | None:
        """The file itself."""
        return self.root / name if self.has(name) else None

    def address(self, name: str) -> Path:
        """The file itself."""
        return self.root / name

    def read(self, name: str) -> bytes | None:
        """A small file, whole."""
        try:
            return (self.root / name).read_bytes()
        except FileNotFoundError:
            return None

    def size(self, name: str) -> int | None:
        """How many bytes the file has."""
        return (self.root / name).stat().st_size if self.has(name) else None

    def chunks(self, name: str, start: int, end: int) -> Iterator[bytes]:
        """The bytes from `start` up to `end` in order."""
        with (self.root / name).open("rb") as file:
            file.seek(start)
            while start < end and (chunk := file.read(min(_CHUNK, end - start))):
                start += len(chunk)
                yield chunk

    def put(self, file: Path, name: str, *, once: bool) -> None:  # noqa: ARG002 - same bytes
        """Flush the file's bytes to the disk, then rename it."""
        with file.open("rb") as opened:
            os.fsync(opened.fileno())
        target = self.root / name
        target.parent.mkdir(parents=True, exist_ok=True)
        file.replace(target)

    def names(self, folder: str) -> Iterator[str]:
        """All names below a folder."""
        for path in (self.root / folder).rglob("*"):
            if path.is_file():
                yield path.relative_to(self.root).as_posix()

    def remove(self, name: str) -> None:
        """Remove the file."""
        (self.root / name).unlink(missing_ok=True)


def object_storage_of(root: Path, requested: ObjectStorage | None) -> ObjectStorage | None:
    """The object store of a store's products: at the given URL, or at the recorded one.

    Raises:
        ProductError: the store has its products elsewhere.
    """
    file = root / _URL
    before = file.read_text().strip() if file.is_file() else None
    if requested is None:
        return None if before is None else ObjectStorage(before)
    if requested.url == before:
        return requested
    if before is not None:
        raise ProductError(
            f"the products of {root} are at {before}, not at {requested.url}; set "
            f"SOLMAP_STORE_URL={before}, or copy them there and remove {file}"
        )
    if any(FolderBackend(root).names("products")):
        raise ProductError(
            f"{root} contains products; copy its folders products/ and stac/ to "
            f"{requested.url} with a tool of the object store and remove them here, "
            "or name another folder"
        )
    return requested


def remember_object_storage(object_storage: ObjectStorage, root: Path) -> None:
    """Record the location of a store's products."""
    if object_storage_of(root, None) != object_storage:
        draft = root / f".{_URL}.{os.getpid()}"
        draft.write_text(f"{object_storage.url}\n")
        draft.replace(root / _URL)
