"""An S3-compatible object store as the place of products.

An object appears at once and whole, whether it was sent in one piece or in parts. Two makers of the
same product do not collide: small ones are created only where there is none, large ones replace
equal bytes. Tasks read copies on this machine, GDAL reads the objects in place.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from solmap.products.errors import StoreAwayError
from solmap.products.object_client import bucket_and_prefix, client_of, endpoint, explaining, says
from solmap.products.read_cache import ReadCache
from solmap.products.store.backends import Elsewhere

if TYPE_CHECKING:
    from obstore.store import S3Store

_CACHE = "cache"
_PIECE = 16 << 20
"""Larger files are sent in parts, which no condition can be put to."""
_PART, _PARTS_AT_ONCE = 8 << 20, 4
_NO_CONDITIONS = ("NotImplemented", "501 Not Implemented")


@dataclass(frozen=True, slots=True, eq=False)
class BucketShelf:
    """Objects below `prefix` of a bucket, with copies on this machine."""

    bucket: str
    prefix: str
    store: S3Store
    cache: ReadCache

    def has(self, name: str) -> bool:
        """Whether there is an object of this name."""
        return self.size(name) is not None

    def path(self, name: str) -> Path | None:
        """A copy, fetched where it is not here yet."""
        try:
            return self.cache.path(name, lambda half: self._fetch(name, half))
        except FileNotFoundError:
            return None

    def address(self, name: str) -> str:
        """What GDAL opens to read parts of the object."""
        return "/".join(part for part in ("/vsis3", self.bucket, self.prefix, name) if part)

    def read(self, name: str) -> bytes | None:
        """A small object, whole."""
        import obstore  # noqa: PLC0415 - only where a store is given by URL

        try:
            with explaining(self.url):
                return bytes(obstore.get(self.store, name).bytes())
        except FileNotFoundError:
            return None

    def size(self, name: str) -> int | None:
        """How many bytes the object has."""
        import obstore  # noqa: PLC0415

        try:
            with explaining(self.url):
                return obstore.head(self.store, name)["size"]
        except FileNotFoundError:
            return None

    def chunks(self, name: str, start: int, end: int) -> Iterator[bytes]:
        """The bytes from `start` up to `end` in order."""
        import obstore  # noqa: PLC0415

        if start >= end:
            return
        with explaining(self.url):
            found = obstore.get(self.store, name, options={"range": (start, end)})
            for chunk in found.stream(min_chunk_size=1 << 20):
                yield bytes(chunk)

    def take(self, file: Path, name: str, *, once: bool) -> None:
        """Send a file; what was sent is the copy on this machine too, if it is to stay as it is."""
        with explaining(self.url, sending=True):
            is_ours = self._send(file, name, once=once)
        if once and is_ours:
            self.cache.adopt(file, name)

    def names(self, folder: str) -> Iterator[str]:
        """All names below a folder."""
        import obstore  # noqa: PLC0415

        with explaining(self.url):
            for batch in obstore.list(self.store, prefix=folder):
                yield from (found["path"] for found in batch)

    def remove(self, name: str) -> None:
        """Have the object no longer, nor a copy of it here."""
        import obstore  # noqa: PLC0415

        with explaining(self.url), contextlib.suppress(FileNotFoundError):
            obstore.delete(self.store, name)
        self.cache.forget(name)

    def probe(self) -> None:
        """Ask the bucket for anything at all.

        Raises:
            StoreAwayError: nobody answers.
            ProductError: there is no such bucket, or the keys do not open it.
        """
        import obstore  # noqa: PLC0415

        with explaining(self.url):
            next(iter(obstore.list(self.store, chunk_size=1)), None)

    def _send(self, file: Path, name: str, *, once: bool) -> bool:
        """Send a file; False where an object of this name was there already and stays."""
        import obstore  # noqa: PLC0415
        from obstore.exceptions import AlreadyExistsError, BaseError  # noqa: PLC0415

        if file.stat().st_size > _PIECE:
            obstore.put(self.store, name, file, chunk_size=_PART, max_concurrency=_PARTS_AT_ONCE)
            return True
        if once:
            try:
                obstore.put(self.store, name, file, mode="create", use_multipart=False)
            except AlreadyExistsError:
                return False
            except BaseError as error:
                if not says(error, _NO_CONDITIONS):
                    raise
            else:
                return True
        obstore.put(self.store, name, file, use_multipart=False)
        return True

    def _fetch(self, name: str, half: Path) -> None:
        import obstore  # noqa: PLC0415

        with explaining(self.url), half.open("wb") as opened:
            found = obstore.get(self.store, name)
            for chunk in found.stream(min_chunk_size=1 << 20):
                opened.write(chunk)
            if opened.tell() != found.meta["size"]:
                raise StoreAwayError(
                    f"{self.url}/{name} broke off after {opened.tell()} of "
                    f"{found.meta['size']} bytes"
                )

    @property
    def url(self) -> str:
        """Where the objects are."""
        return f"s3://{self.bucket}/{self.prefix}".rstrip("/")


def bucket_shelf(elsewhere: Elsewhere, root: Path) -> BucketShelf:
    """The objects below a URL, with copies in a store's folder; one client for a whole process.

    Raises:
        ProductError: the URL is of another kind, or what reads it is not installed.
    """
    return _shelf(elsewhere, root, os.getpid(), endpoint())


@lru_cache(maxsize=16)
def _shelf(elsewhere: Elsewhere, root: Path, _process: int, _endpoint: str) -> BucketShelf:
    bucket, prefix = bucket_and_prefix(elsewhere.url)
    cache = ReadCache(root / _CACHE, round(elsewhere.cache_gb * (1 << 30)))
    return BucketShelf(bucket, prefix, client_of(bucket, prefix), cache)
