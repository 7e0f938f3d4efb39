"""An S3-compatible object store as the place of products; keys by the usual AWS_* variables.

An object appears at once and whole, whether it was sent in one piece or in parts. Two makers of the
same product do not collide: small ones are created only where there is none, large ones replace
equal bytes. Tasks read copies on this machine, GDAL reads the objects in place.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from products.errors import ProductError, StoreAwayError
from products.read_cache import ReadCache
from products.shelves import Elsewhere

if TYPE_CHECKING:
    from obstore.store import S3Store

_PIECE = 16 << 20
"""Larger files are sent in parts, which no condition can be put to."""
_PART, _PARTS_AT_ONCE = 8 << 20, 4
_RETRIES, _RETRY_S = 4, 60
_CONNECT_S, _SILENCE_S, _REQUEST_S = 5, 60, 600
_CACHE = "cache"
_URLS = "say SOLMAP_STORE_URL=s3://bucket/prefix, or leave it out"
_REFUSALS = ("AccessDenied", "InvalidAccessKeyId", "SignatureDoesNotMatch", "403 Forbidden")
_NO_CONDITIONS = ("NotImplemented", "501 Not Implemented")
_GDAL = {
    "GDAL_HTTP_MAX_RETRY": "3",
    "GDAL_HTTP_RETRY_DELAY": "0.2",
    "GDAL_HTTP_CONNECTTIMEOUT": str(_CONNECT_S),
    "GDAL_HTTP_TIMEOUT": str(_SILENCE_S),
}


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
            with self._explaining():
                return bytes(obstore.get(self.store, name).bytes())
        except FileNotFoundError:
            return None

    def size(self, name: str) -> int | None:
        """How many bytes the object has."""
        import obstore  # noqa: PLC0415

        try:
            with self._explaining():
                return obstore.head(self.store, name)["size"]
        except FileNotFoundError:
            return None

    def chunks(self, name: str, start: int, end: int) -> Iterator[bytes]:
        """The bytes from `start` up to `end` in order."""
        import obstore  # noqa: PLC0415

        if start >= end:
            return
        with self._explaining():
            found = obstore.get(self.store, name, options={"range": (start, end)})
            for chunk in found.stream(min_chunk_size=1 << 20):
                yield bytes(chunk)

    def take(self, file: Path, name: str, *, once: bool) -> None:
        """Send a file; what was sent is the copy on this machine too, if it is to stay as it is."""
        with self._explaining(sending=True):
            is_ours = self._send(file, name, once=once)
        if once and is_ours:
            self.cache.adopt(file, name)

    def names(self, folder: str) -> Iterator[str]:
        """All names below a folder."""
        import obstore  # noqa: PLC0415

        with self._explaining():
            for batch in obstore.list(self.store, prefix=folder):
                yield from (found["path"] for found in batch)

    def remove(self, name: str) -> None:
        """Have the object no longer, nor a copy of it here."""
        import obstore  # noqa: PLC0415

        with self._explaining(), contextlib.suppress(FileNotFoundError):
            obstore.delete(self.store, name)
        self.cache.forget(name)

    def probe(self) -> None:
        """Ask the bucket for anything at all.

        Raises:
            StoreAwayError: nobody answers.
            ProductError: there is no such bucket, or the keys do not open it.
        """
        import obstore  # noqa: PLC0415

        with self._explaining():
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
                if not _says(error, _NO_CONDITIONS):
                    raise
            else:
                return True
        obstore.put(self.store, name, file, use_multipart=False)
        return True

    def _fetch(self, name: str, half: Path) -> None:
        import obstore  # noqa: PLC0415

        with self._explaining(), half.open("wb") as opened:
            found = obstore.get(self.store, name)
            for chunk in found.stream(min_chunk_size=1 << 20):
                opened.write(chunk)
            if opened.tell() != found.meta["size"]:
                raise StoreAwayError(
                    f"{self._url}/{name} broke off after {opened.tell()} of "
                    f"{found.meta['size']} bytes"
                )

    @property
    def _url(self) -> str:
        return f"s3://{self.bucket}/{self.prefix}".rstrip("/")

    @contextlib.contextmanager
    def _explaining(self, *, sending: bool = False) -> Iterator[None]:
        """Say what the object store's errors mean, and what to do about them.

        Raises:
            FileNotFoundError: there is no such object.
            StoreAwayError: nobody answers, which may pass.
            ProductError: there is no such bucket, or the keys do not open it.
        """
        from obstore.exceptions import (  # noqa: PLC0415
            BaseError,
            PermissionDeniedError,
            UnauthenticatedError,
        )

        try:
            yield
        except (BaseError, FileNotFoundError) as error:
            if _says(error, ("NoSuchBucket",)) or (sending and _is_missing(error)):
                raise ProductError(
                    f"there is no bucket {self.bucket} at {_endpoint()}; make it, or set "
                    "SOLMAP_STORE_URL and AWS_ENDPOINT_URL right"
                ) from error
            if _is_missing(error):
                raise
            refused = isinstance(error, PermissionDeniedError | UnauthenticatedError)
            if refused or _says(error, _REFUSALS):
                raise ProductError(
                    f"{_endpoint()} does not open {self._url} with these keys: {_first(error)}; "
                    "set AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_REGION right"
                ) from error
            raise StoreAwayError(
                f"the object store {self._url} at {_endpoint()} does not answer: {_first(error)}; "
                "is it running, and is AWS_ENDPOINT_URL right?"
            ) from error


def bucket_shelf(elsewhere: Elsewhere, root: Path) -> BucketShelf:
    """The objects below a URL, with copies in a store's folder; one client for a whole process.

    Raises:
        ProductError: the URL is of another kind, or what reads it is not installed.
    """
    return _shelf(elsewhere, root, os.getpid(), _endpoint())


@lru_cache(maxsize=16)
def _shelf(elsewhere: Elsewhere, root: Path, _process: int, endpoint: str) -> BucketShelf:
    url, parts = elsewhere.url, urlsplit(elsewhere.url)
    prefix = parts.path.strip("/")
    if parts.scheme != "s3" or not parts.netloc or parts.query or parts.fragment:
        raise ProductError(f"products cannot lie at {url!r}; {_URLS}")
    try:
        from obstore.store import S3Store  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise ProductError(
            f"products at {url} are read with obstore, which is not installed; "
            "install solmap with its extra `cluster`"
        ) from error
    _tell_gdal(endpoint, parts.netloc)
    store = S3Store(
        parts.netloc,
        prefix=prefix or None,
        client_options={
            "allow_http": endpoint.startswith("http://"),
            "connect_timeout": timedelta(seconds=_CONNECT_S),
            "read_timeout": timedelta(seconds=_SILENCE_S),
            "timeout": timedelta(seconds=_REQUEST_S),
        },
        retry_config={"max_retries": _RETRIES, "retry_timeout": timedelta(seconds=_RETRY_S)},
    )
    cache = ReadCache(root / _CACHE, round(elsewhere.cache_gb * (1 << 30)))
    return BucketShelf(parts.netloc, prefix, store, cache)


def _endpoint() -> str:
    """Where the object store is."""
    names = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")
    given = (os.environ.get(name) for name in names)
    return next((url for url in given if url), "https://s3.amazonaws.com")


def _tell_gdal(endpoint: str, bucket: str) -> None:
    """Give GDAL the same endpoint in its own words; it reads the variables of keys by itself.

    What it could not open it would remember as absent, long after the store answers again.
    """
    os.environ["CPL_VSIL_CURL_NON_CACHED"] = f"/vsis3/{bucket}"
    for name, value in _GDAL.items():
        os.environ.setdefault(name, value)
    if os.environ.get("AWS_DEFAULT_REGION"):
        os.environ.setdefault("AWS_REGION", os.environ["AWS_DEFAULT_REGION"])
    if endpoint == "https://s3.amazonaws.com":
        return
    parts = urlsplit(endpoint)
    os.environ["AWS_S3_ENDPOINT"] = parts.netloc + parts.path.rstrip("/")
    os.environ["AWS_HTTPS"] = "NO" if parts.scheme == "http" else "YES"
    os.environ["AWS_VIRTUAL_HOSTING"] = "FALSE"


def _is_missing(error: Exception) -> bool:
    return isinstance(error, FileNotFoundError)


def _says(error: Exception, words: tuple[str, ...]) -> bool:
    return any(word in str(error) for word in words)


def _first(error: Exception) -> str:
    """What happened, without the client's own record of it."""
    return " ".join(str(error).partition("Debug source")[0].split())
