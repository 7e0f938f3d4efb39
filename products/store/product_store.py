"""The store: products are made once, then read by reference.

A product is drafted in a separate folder and moved into place when complete, so that existing
products are always complete, even if a process is killed. Beside each product is its provenance:
the recipe, the time and resources of its making, its size and checksum. The product's own bytes
hold no dates, so the same recipe gives the same bytes.

Products are in the store's folder or in an object store; drafts, databases and caches (indexes,
copies of objects) are always in the folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import socket
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

from solmap.products.errors import ProductError, ProductNotFoundError, StoreFullError
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.backends import (
    FolderBackend,
    ObjectStorage,
    StorageBackend,
    object_storage_of,
    remember_object_storage,
)
from solmap.products.store.faults import is_disk_full, require_writable
from solmap.products.store.object_backend import open_object_backend
from solmap.products.store.process import ResourceMeter

_PRODUCTS = "products"
_LEVELS = 4
"""Parts of the name of a product: `products/KIND/SCOPE/FILE`."""


@dataclass(frozen=True, slots=True)
class ProductStore:
    """Products, each under the digest of its recipe."""

    root: Path
    """The folder of this machine."""
    object_storage: ObjectStorage | None = None
    """The object store of the products; None: in the folder."""

    @classmethod
    def open(cls, root: Path, object_storage: ObjectStorage | None = None) -> ProductStore:
        """Open or create the store at `root`, and remove drafts of killed processes.

        A read-only one is opened for reading.

        Raises:
            ProductError: the folder cannot be made, or the URL cannot be used.
            StoreAwayError: the object store does not respond.
        """
        store = cls(root.resolve())
        try:
            store._drafts.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            if not (store.root / _PRODUCTS).is_dir():
                raise ProductError(
                    f"{root} cannot be a store: {error.strerror}; name a writable folder"
                ) from error
        store._clear_dead_drafts()
        object_storage = object_storage_of(store.root, object_storage)
        if object_storage is None:
            return store
        open_object_backend(object_storage, store.root).probe()
        remember_object_storage(object_storage, store.root)
        return cls(store.root, object_storage)

    @property
    def backend(self) -> StorageBackend:
        """Storage of its files; for maintenance, while products are reached by reference."""
        if self.object_storage is None:
            return FolderBackend(self.root)
        return open_object_backend(self.object_storage, self.root)

    @property
    def _drafts(self) -> Path:
        return self.root / "drafts"

    def path(self, ref: ProductRef) -> Path:
        """A local file of the product; read it soon, and do not change it.

        Raises:
            ProductNotFoundError: it has not been made.
        """
        path = self.backend.path(_name(ref))
        if path is None:
            raise _not_found(ref)
        return path

    def address(self, ref: ProductRef) -> Path | str:
        """GDAL's address of parts of a raster, whether it exists or not."""
        return self.backend.address(_name(ref))

    def size(self, ref: ProductRef) -> int:
        """Size of the product in bytes.

        Raises:
            ProductNotFoundError: it has not been made.
        """
        size = self.backend.size(_name(ref))
        if size is None:
            raise _not_found(ref)
        return size

    def chunks(self, ref: ProductRef, start: int, end: int) -> Iterator[bytes]:
        """The bytes of a product from `start` up to `end` in order, in pieces."""
        return self.backend.chunks(_name(ref), start, end)

    def has(self, ref: ProductRef) -> bool:
        """Whether the product has been made."""
        return self.backend.has(_name(ref))

    def versions(self, kind: ProductKind, scope: Scope) -> list[ProductRef]:
        """All products of a kind and scope, latest or not, in the order in which they were made."""
        names = self.backend.names(f"{_PRODUCTS}/{kind}/{scope.name}")
        found = [ProductRef(kind, scope, digest) for digest in _digests(names, kind)]
        if len(found) < 2:  # noqa: PLR2004 - one needs no order, and no reading
            return found
        return sorted(found, key=lambda ref: (self.made_at(ref), ref.digest))

    def refs(self) -> Iterator[ProductRef]:
        """Every existing product, latest or not, in the order of their names."""
        for kind in sorted(ProductKind):
            for name in sorted(self.backend.names(f"{_PRODUCTS}/{kind}")):
                parts = name.split("/")
                for digest in _digests([name], kind) if len(parts) == _LEVELS else ():
                    yield ProductRef(kind, Scope(self._level(kind, name), parts[2]), digest)

    def remove(self, ref: ProductRef) -> None:
        """Remove a product, then its provenance; it may not exist any more."""
        require_writable(self.root)
        self.backend.remove(_name(ref))
        self.backend.remove(provenance_name(_name(ref)))

    def make(self, recipe: Recipe, write: Callable[[Path], None]) -> ProductRef:
        """Make the product of `recipe` with `write`, unless it exists.

        Raises:
            NotMadeError: it does not exist, and products are only looked up here.
            StoreFullError: the disk is full; the draft is removed, finished products are kept.
            StoreAwayError: the object store does not respond; no part of the product is visible.
        """
        ref = recipe.ref
        if self.has(ref):
            return ref
        if _only_looks_up.get():
            raise NotMadeError(f"{ref} does not exist yet")
        name = _name(ref)
        effort = ResourceMeter()
        with (
            self._draft() as folder,
            self._explaining_full_disk(f"making {ref.kind} of {ref.scope}"),
        ):
            draft = folder / PurePosixPath(name).name
            write(draft)
            notes = folder / PurePosixPath(provenance_name(name)).name
            notes.write_text(json.dumps(_provenance(recipe, draft, effort)))
            # the product last: if it exists, its provenance does too
            self.backend.put(notes, provenance_name(name), once=False)
            self.backend.put(draft, name, once=True)
        return ref

    def provenance(self, ref: ProductRef) -> dict[str, Any]:
        """Recipe, date, duration, size and checksum of a product."""
        found = self.backend.read(provenance_name(_name(ref)))
        if found is None:
            raise _not_found(ref)
        return json.loads(found)

    def made_at(self, ref: ProductRef) -> str:
        """When the product was made, UTC, ISO 8601."""
        return str(self.provenance(ref)["made_at"])

    def write_document(self, name: str, text: str) -> None:
        """Write or replace a document beside the products, such as `stac/catalog.json`."""
        with self._draft() as folder:
            draft = folder / "document"
            draft.write_text(text, encoding="utf-8")
            self.backend.put(draft, name, once=False)

    def document(self, name: str) -> str | None:
        """A document beside the products; None where there is none."""
        found = self.backend.read(name)
        return None if found is None else found.decode()

    def _level(self, kind: ProductKind, name: str) -> ScopeLevel:
        """Level of a product's scope: by its kind, or else by its provenance."""
        if kind.level is not None:
            return kind.level
        try:
            notes = json.loads(self.backend.read(provenance_name(name)) or b"{}")
            return ScopeLevel(notes["recipe"]["scope"]["level"])
        except (ValueError, LookupError, TypeError):
            # its provenance is broken, which is reported when it is read
            return ScopeLevel.REGION

    def admit(self, name: str, chunks: Iterable[bytes], sha256: str) -> bool:
        """Take a file of a backup under its name if its checksum fits; returns whether it did.

        Raises:
            StoreFullError: the disk is full.
        """
        with self._draft() as folder, self._explaining_full_disk(f"restoring {name}"):
            draft = folder / "file"
            if write_chunks(draft, chunks) != sha256:
                return False
            self.backend.put(draft, name, once=False)
        return True

    @contextlib.contextmanager
    def _draft(self) -> Iterator[Path]:
        require_writable(self.root)
        self._drafts.mkdir(parents=True, exist_ok=True)  # a store opened by another machine
        prefix = f"{socket.gethostname()}-{os.getpid()}-"
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=self._drafts))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    @contextlib.contextmanager
    def _explaining_full_disk(self, what: str) -> Iterator[None]:
        """Report that the disk is full, even if a library only reports that writing failed."""
        try:
            yield
        except Exception as error:
            if is_disk_full(self.root, error):
                raise StoreFullError(
                    f"the disk is full while {what}; free some space and run again: finished "
                    "products are kept"
                ) from error
            raise

    def _clear_dead_drafts(self) -> None:
        mine = f"{socket.gethostname()}-"
        for folder in self._drafts.glob(f"{mine}*"):
            process = folder.name.removeprefix(mine).split("-")[0]
            if process.isdigit() and not Path(f"/proc/{process}").exists():
                shutil.rmtree(folder, ignore_errors=True)


def _name(ref: ProductRef) -> str:
    return f"{_PRODUCTS}/{ref.file_name}"


def provenance_name(name: str) -> str:
    """The name of the provenance file of a product."""
    folder, _, file = name.rpartition("/")
    return f"{folder}/{file.split('.')[0]}.provenance.json"


def _digests(names: Iterable[str], kind: ProductKind) -> Iterator[str]:
    """The digests of the products among some names; provenance may have a product's suffix."""
    for name in names:
        digest = name.rpartition("/")[2].removesuffix(kind.suffix)
        if name.endswith(kind.suffix) and "." not in digest:
            yield digest


class NotMadeError(BaseException):
    """A product is missing where products are only looked up; no handler of errors catches it."""


_only_looks_up: ContextVar[bool] = ContextVar("solmap_only_looks_up", default=False)


@contextlib.contextmanager
def looking_up() -> Iterator[None]:
    """In the block stores make no product: where one is missing, `make` raises `NotMadeError`."""
    before = _only_looks_up.set(True)
    try:
        yield
    finally:
        _only_looks_up.reset(before)


def _not_found(ref: ProductRef) -> ProductNotFoundError:
    return ProductNotFoundError(
        f"{ref.kind} of {ref.scope} with digest {ref.digest} is not in the store; "
        "run the processing that makes it (`solmap run`)"
    )


def write_chunks(path: Path, chunks: Iterable[bytes]) -> str:
    """Write a new file, and flush it to the disk; returns its checksum."""
    digest = hashlib.sha256()
    with path.open("wb") as file:
        for chunk in chunks:
            digest.update(chunk)
            file.write(chunk)
        file.flush()
        os.fsync(file.fileno())
    return digest.hexdigest()


@cache
def _software() -> str:
    return f"solmap {version('solmap')}"


def _provenance(recipe: Recipe, draft: Path, effort: ResourceMeter) -> dict[str, Any]:
    with draft.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return {
        "recipe": recipe.document,
        "made_at": datetime.now(UTC).isoformat(timespec="seconds"),
        **effort.usage(),
        "bytes": draft.stat().st_size,
        "sha256": sha256,
        "software": _software(),
    }
