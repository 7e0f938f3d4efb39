"""The store: products are made once, then read by reference.

A product is drafted in a folder of its own and renamed into place when it is whole, so that a file
that exists is complete, whatever was killed. Beside each product lies its provenance: the recipe,
when and how long it was made, its size and checksum. The product's own bytes hold no dates, so the
same recipe gives the same bytes.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from products.disk import is_full
from products.errors import ProductError, ProductNotFoundError, StoreFullError
from products.model import LEVEL, SUFFIX, ProductKind, ProductRef, Recipe, Scope, ScopeLevel

_CHUNK = 1 << 20


@dataclass(frozen=True, slots=True)
class ProductStore:
    """A folder of products, each under the digest of its recipe."""

    root: Path

    @classmethod
    def open(cls, root: Path) -> ProductStore:
        """Open or found the store at `root`, and clear the drafts that killed processes left.

        Raises:
            ProductError: the folder cannot be made or written to.
        """
        store = cls(root.resolve())
        try:
            store._drafts.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ProductError(
                f"{root} cannot hold a store: {error.strerror}; name a folder that can be written"
            ) from error
        store._clear_dead_drafts()
        return store

    @property
    def _products(self) -> Path:
        return self.root / "products"

    @property
    def _drafts(self) -> Path:
        return self.root / "drafts"

    def path(self, ref: ProductRef) -> Path:
        """Where the product lies.

        Raises:
            ProductNotFoundError: it has not been made.
        """
        path = self._products / ref.file_name
        if not path.is_file():
            raise ProductNotFoundError(
                f"{ref.kind} of {ref.scope} with digest {ref.digest} is not in the store; "
                "run the flow that makes it"
            )
        return path

    def has(self, ref: ProductRef) -> bool:
        """Whether the product has been made."""
        return (self._products / ref.file_name).is_file()

    def versions(self, kind: ProductKind, scope: Scope) -> list[ProductRef]:
        """All products of a kind and scope, latest or not, in the order in which they were made."""
        suffix = SUFFIX[kind]
        files = (self._products / str(kind) / scope.name).glob(f"*{suffix}")
        digests = [file.name.removesuffix(suffix) for file in files]
        found = [ProductRef(kind, scope, digest) for digest in digests if "." not in digest]
        if len(found) < 2:  # noqa: PLR2004 - one needs no order, and no reading
            return found
        return sorted(found, key=lambda ref: (self.made_at(ref), ref.digest))

    def refs(self) -> Iterator[ProductRef]:
        """Every product there is, latest or not, in the order of their names."""
        for kind in sorted(ProductKind):
            suffix = SUFFIX[kind]
            for file in sorted((self._products / str(kind)).glob(f"*/*{suffix}")):
                digest = file.name.removesuffix(suffix)
                if "." not in digest:  # provenance may end like a product
                    yield ProductRef(kind, _scope(kind, file), digest)

    def remove(self, ref: ProductRef) -> None:
        """Have a product no longer; it may be gone already. Its provenance goes after it."""
        path = self._products / ref.file_name
        path.unlink(missing_ok=True)
        path.with_name(_provenance_name(path)).unlink(missing_ok=True)

    def make(self, recipe: Recipe, write: Callable[[Path], None]) -> ProductRef:
        """Make the product of `recipe` with `write`, unless it is there already.

        Raises:
            StoreFullError: the disk is full; the draft is gone, everything made before remains.
        """
        ref = recipe.ref
        if self.has(ref):
            return ref
        target = self._products / ref.file_name
        started = time.monotonic()
        with self._draft() as folder, self._explaining_full_disk(ref):
            draft = folder / target.name
            write(draft)
            notes = folder / _provenance_name(target)
            notes.write_text(json.dumps(_provenance(recipe, draft, time.monotonic() - started)))
            target.parent.mkdir(parents=True, exist_ok=True)
            for file in (notes, draft):  # the product last: where it is, its provenance is too
                _settle(file)
                file.replace(target.parent / file.name)
        return ref

    def provenance(self, ref: ProductRef) -> dict[str, Any]:
        """Recipe, date, duration, size and checksum of a product."""
        path = self.path(ref)
        return json.loads(path.with_name(_provenance_name(path)).read_text())

    def made_at(self, ref: ProductRef) -> str:
        """When the product was made, UTC, ISO 8601."""
        return str(self.provenance(ref)["made_at"])

    @contextlib.contextmanager
    def _draft(self) -> Iterator[Path]:
        prefix = f"{socket.gethostname()}-{os.getpid()}-"
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=self._drafts))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    @contextlib.contextmanager
    def _explaining_full_disk(self, ref: ProductRef) -> Iterator[None]:
        """Say plainly that the disk is full, also where a library only says that writing failed."""
        try:
            yield
        except Exception as error:
            if is_full(self.root, error):
                raise StoreFullError(
                    f"the disk is full while making {ref.kind} of {ref.scope}; free some space "
                    "and run again: what was made before is kept"
                ) from error
            raise

    def _clear_dead_drafts(self) -> None:
        mine = f"{socket.gethostname()}-"
        for folder in self._drafts.glob(f"{mine}*"):
            process = folder.name.removeprefix(mine).split("-")[0]
            if process.isdigit() and not Path(f"/proc/{process}").exists():
                shutil.rmtree(folder, ignore_errors=True)


def _scope(kind: ProductKind, product: Path) -> Scope:
    """What a product is about; where its kind does not say the level, its provenance does."""
    level = LEVEL.get(kind)
    if level is None:
        notes = json.loads(product.with_name(_provenance_name(product)).read_text())
        level = ScopeLevel(notes["recipe"]["scope"]["level"])
    return Scope(level, product.parent.name)


def _provenance_name(product: Path) -> str:
    return f"{product.name.split('.')[0]}.provenance.json"


def _provenance(recipe: Recipe, draft: Path, seconds: float) -> dict[str, Any]:
    digest = hashlib.sha256()
    with draft.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return {
        "recipe": recipe.document,
        "made_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "seconds": round(seconds, 3),
        "bytes": draft.stat().st_size,
        "sha256": digest.hexdigest(),
        "software": f"solmap {version('solmap')}",
    }


def _settle(file: Path) -> None:
    """Have the file's bytes on the disk before its name is."""
    with file.open("rb") as opened:
        os.fsync(opened.fileno())
