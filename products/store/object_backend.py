"""The storage backend of S3-compatible object stores: objects, their client, and a read cache.

Uploads are atomic, in one request or in parts. Two processes may make the same product at once:
small objects are created only if they do not exist, large ones overwrite an object of equal bytes.
GDAL reads ranges of objects directly; tasks read local copies, of which the least recently used are
removed first. Copies are completed by renaming; all processes of a machine share the folder.

Keys, region and endpoint come from the usual AWS_* variables; GDAL uses the same endpoint. Without
keys, the clients would query the cloud's instance metadata service; an error is raised instead,
unless AWS_EC2_METADATA_DISABLED is set to false.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import timedelta
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from solmap.products.errors import ProductError, StoreAwayError
from solmap.products.store.backends import ObjectStorage

if TYPE_CHECKING:
    from obstore.store import S3Store

_CACHE = "cache"
_PIECE = 16 << 20
"""Files above this size are sent in parts, without the condition that the object is new."""
_PART, _PARTS_AT_ONCE = 8 << 20, 4
_NO_CONDITIONS = ("NotImplemented", "501 Not Implemented")


@dataclass(frozen=True, slots=True, eq=False)
class ObjectBackend:
    """Objects below `prefix` of a bucket, with local copies."""

    bucket: str
    prefix: str
    store: S3Store
    cache: ReadCache

    def has(self, name: str) -> bool:
        """Whether there is an object of this name."""
        return self.size(name) is not None

    def path(self, name: str) -> Path | None:
        """A local copy, fetched if necessary; None if there is no such object."""
        try:
            return self.cache.path(name, lambda half: self._fetch(name, half))
        except FileNotFoundError:
            return None

    def address(self, name: str) -> str:
        """The object's name in GDAL's virtual file system, for reading parts of it."""
        return "/".join(part for part in ("/vsis3", self.bucket, self.prefix, name) if part)

    def read(self, name: str) -> bytes | None:
        """Content of a small object; None if there is no such object."""
        import obstore  # noqa: PLC0415 - only where a store is given by URL

        try:
            with explain_errors(self.url):
                return bytes(obstore.get(self.store, name).bytes())
        except FileNotFoundError:
            return None

    def size(self, name: str) -> int | None:
        """Size of the object in bytes; None if there is no such object."""
        import obstore  # noqa: PLC0415

        try:
            with explain_errors(self.url):
                return obstore.head(self.store, name)["size"]
        except FileNotFoundError:
            return None

    def chunks(self, name: str, start: int, end: int) -> Iterator[bytes]:
        """The bytes from `start` up to `end` in order."""
        import obstore  # noqa: PLC0415

        if start >= end:
            return
        with explain_errors(self.url):
            found = obstore.get(self.store, name, options={"range": (start, end)})
            for chunk in found.stream(min_chunk_size=1 << 20):
                yield bytes(chunk)

    def put(self, file: Path, name: str, *, once: bool) -> None:
        """Upload a file; with `once`, an existing object is kept and the file becomes the copy."""
        with explain_errors(self.url, sending=True):
            is_ours = self._send(file, name, once=once)
        if once and is_ours:
            self.cache.put(file, name)

    def names(self, folder: str) -> Iterator[str]:
        """All names below a folder."""
        import obstore  # noqa: PLC0415

        with explain_errors(self.url):
            for batch in obstore.list(self.store, prefix=folder):
                yield from (found["path"] for found in batch)

    def remove(self, name: str) -> None:
        """Remove the object and its local copy."""
        import obstore  # noqa: PLC0415

        with explain_errors(self.url), contextlib.suppress(FileNotFoundError):
            obstore.delete(self.store, name)
        self.cache.remove(name)

    def probe(self) -> None:
        """Check whether the bucket responds.

        Raises:
            StoreAwayError: it does not respond.
            ProductError: there is no such bucket, or the keys do not give access to it.
        """
        import obstore  # noqa: PLC0415

        with explain_errors(self.url):
            next(iter(obstore.list(self.store, chunk_size=1)), None)

    def _send(self, file: Path, name: str, *, once: bool) -> bool:
        """Upload a file; False if an existing object of this name is kept."""
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
                if not mentions(error, _NO_CONDITIONS):
                    raise
            else:
                return True
        obstore.put(self.store, name, file, use_multipart=False)
        return True

    def _fetch(self, name: str, half: Path) -> None:
        import obstore  # noqa: PLC0415

        with explain_errors(self.url), half.open("wb") as opened:
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
        """Location of the objects."""
        return f"s3://{self.bucket}/{self.prefix}".rstrip("/")


def open_object_backend(object_storage: ObjectStorage, root: Path) -> ObjectBackend:
    """The objects below a URL, with copies in a store's folder; one client per process and URL.

    Raises:
        ProductError: it is not an s3:// URL, or the client library is not installed.
    """
    return _object_backend(object_storage, root, os.getpid(), endpoint())


@lru_cache(maxsize=16)
def _object_backend(
    object_storage: ObjectStorage, root: Path, _process: int, _endpoint: str
) -> ObjectBackend:
    bucket, prefix = bucket_and_prefix(object_storage.url)
    cache = ReadCache(root / _CACHE, round(object_storage.cache_gb * (1 << 30)))
    return ObjectBackend(bucket, prefix, client_of(bucket, prefix), cache)


_RETRIES, _RETRY_S = 4, 60
_CONNECT_S, _SILENCE_S, _REQUEST_S = 5, 60, 600
_AMAZON = "https://s3.amazonaws.com"
_URLS = "set SOLMAP_STORE_URL=s3://bucket/prefix, or omit it"
_REFUSALS = ("AccessDenied", "InvalidAccessKeyId", "SignatureDoesNotMatch", "403 Forbidden")
_KEYS = {"AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"}
_ROLES = {
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
}
"""Variables that name a source of keys."""
_GDAL = {
    "GDAL_HTTP_MAX_RETRY": "3",
    "GDAL_HTTP_RETRY_DELAY": "0.2",
    "GDAL_HTTP_CONNECTTIMEOUT": str(_CONNECT_S),
    "GDAL_HTTP_TIMEOUT": str(_SILENCE_S),
}


def bucket_and_prefix(url: str) -> tuple[str, str]:
    """The two parts of `s3://bucket/prefix`.

    Raises:
        ProductError: it is not such a URL.
    """
    parts = urlsplit(url)
    if parts.scheme != "s3" or not parts.netloc or parts.query or parts.fragment:
        raise ProductError(f"products cannot be stored at {url!r}; {_URLS}")
    return parts.netloc, parts.path.strip("/")


def client_of(bucket: str, prefix: str) -> S3Store:
    """A client of the objects below a prefix; threads may share it, processes may not.

    Raises:
        ProductError: the client library is not installed, or there are no keys.
    """
    try:
        from obstore.store import S3Store  # noqa: PLC0415 - only where a store is given by URL
    except ModuleNotFoundError as error:
        raise ProductError(
            f"products at s3://{bucket}/{prefix} are read with obstore, which is not installed; "
            "install solmap with its extra `cluster`"
        ) from error
    _check_keys(bucket, prefix)
    _configure_gdal(bucket)
    return S3Store(
        bucket,
        prefix=prefix or None,
        client_options={
            "allow_http": endpoint().startswith("http://"),
            "connect_timeout": timedelta(seconds=_CONNECT_S),
            "read_timeout": timedelta(seconds=_SILENCE_S),
            "timeout": timedelta(seconds=_REQUEST_S),
        },
        retry_config={"max_retries": _RETRIES, "retry_timeout": timedelta(seconds=_RETRY_S)},
    )


def _check_keys(bucket: str, prefix: str) -> None:
    """Check that the environment has keys or names a source of keys.

    Raises:
        ProductError: it does not.
    """
    given = {name for name, value in os.environ.items() if value}
    may_use_role = os.environ.get("AWS_EC2_METADATA_DISABLED", "").lower() in {"false", "no", "0"}
    is_open = os.environ.get("AWS_SKIP_SIGNATURE", "").lower() in {"true", "yes", "1"}
    if is_open:
        os.environ.setdefault("AWS_NO_SIGN_REQUEST", "YES")  # the same option of GDAL
    if not (may_use_role or is_open or given >= _KEYS or given & _ROLES):
        raise ProductError(
            f"there are no keys to s3://{bucket}/{prefix}: set AWS_ACCESS_KEY_ID and "
            "AWS_SECRET_ACCESS_KEY, or AWS_EC2_METADATA_DISABLED=false where the machine has a role"
        )


def endpoint() -> str:
    """Address of the object store."""
    names = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")
    return next((url for url in map(os.environ.get, names) if url), _AMAZON)


def _configure_gdal(bucket: str) -> None:
    """Set GDAL's variables to the same endpoint; GDAL reads the AWS variables of keys itself.

    Caching is disabled, because GDAL would cache failures after the store responds again.
    """
    os.environ["CPL_VSIL_CURL_NON_CACHED"] = f"/vsis3/{bucket}"
    for name, value in _GDAL.items():
        os.environ.setdefault(name, value)
    if os.environ.get("AWS_DEFAULT_REGION"):
        os.environ.setdefault("AWS_REGION", os.environ["AWS_DEFAULT_REGION"])
    if endpoint() == _AMAZON:
        return
    parts = urlsplit(endpoint())
    os.environ["AWS_S3_ENDPOINT"] = parts.netloc + parts.path.rstrip("/")
    os.environ["AWS_HTTPS"] = "NO" if parts.scheme == "http" else "YES"
    os.environ["AWS_VIRTUAL_HOSTING"] = "FALSE"


@contextlib.contextmanager
def explain_errors(url: str, *, sending: bool = False) -> Iterator[None]:
    """Convert errors of the object store to errors of solmap that name a remedy.

    Raises:
        FileNotFoundError: there is no such object.
        StoreAwayError: it does not respond, which may be transient.
        ProductError: there is no such bucket, or the keys give no access to it.
    """
    from obstore.exceptions import (  # noqa: PLC0415
        BaseError,
        PermissionDeniedError,
        UnauthenticatedError,
    )

    try:
        yield
    except (BaseError, FileNotFoundError) as error:
        is_missing = isinstance(error, FileNotFoundError)
        if mentions(error, ("NoSuchBucket",)) or (sending and is_missing):
            raise ProductError(
                f"there is no bucket {urlsplit(url).netloc} at {endpoint()}; make it, or set "
                "SOLMAP_STORE_URL and AWS_ENDPOINT_URL correctly"
            ) from error
        if is_missing:
            raise
        refused = isinstance(error, PermissionDeniedError | UnauthenticatedError)
        if refused or mentions(error, _REFUSALS):
            raise ProductError(
                f"{endpoint()} does not give access to {url} with these keys: {_first(error)}; "
                "check AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_REGION"
            ) from error
        raise StoreAwayError(
            f"the object store {url} at {endpoint()} does not respond: {_first(error)}; is it "
            "running, and is AWS_ENDPOINT_URL correct?"
        ) from error


def mentions(error: Exception, words: tuple[str, ...]) -> bool:
    """Whether the message of an error contains one of `words`."""
    return any(word in str(error) for word in words)


def _first(error: Exception) -> str:
    """The message without the client's stack trace."""
    return " ".join(str(error).partition("Debug source")[0].split())


_JUST_USED_S = 300.0
_TOUCHED_S = 10.0
"""Uses within this interval are recorded once."""
_SLACK = 20
"""After adding 1/20 of the limit, a process removes old copies, down to 2/20 below the limit."""
_DEAD_S = 3600.0
"""Age from which an unfinished copy belongs to a killed process."""
_HALF = ".half-"


@dataclass(slots=True, eq=False)
class ReadCache:
    """A folder of local copies of objects; the least recently used are removed first."""

    folder: Path
    limit: int
    """Limit of their total size in bytes."""
    _added: int = field(default=0, init=False)
    """Bytes added since the last removal."""

    def path(self, name: str, fetch: Callable[[Path], None]) -> Path:
        """The copy of a file; `fetch` writes it if it does not exist."""
        path = self.folder / name
        try:
            _touch(path)
        except FileNotFoundError:
            path.parent.mkdir(parents=True, exist_ok=True)
            descriptor, half = tempfile.mkstemp(prefix=_HALF, dir=path.parent)
            os.close(descriptor)
            try:
                fetch(Path(half))
                self.put(Path(half), name)
            finally:
                Path(half).unlink(missing_ok=True)
        return path

    def put(self, file: Path, name: str) -> None:
        """Rename a complete file of the same file system to the copy of `name`."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        self._added += file.stat().st_size
        os.utime(file)
        file.replace(path)
        if self._added >= self.limit // _SLACK:
            self._added = 0
            self.evict()

    def remove(self, name: str) -> None:
        """Remove the copy of a file."""
        (self.folder / name).unlink(missing_ok=True)

    def evict(self) -> None:
        """Remove the least recently used copies until their size is well below the limit."""
        now, copies = time.time(), []
        for path in self.folder.rglob("*"):
            with contextlib.suppress(FileNotFoundError):  # other processes remove copies too
                stat = path.stat()
                if path.is_file():
                    copies.append((stat.st_mtime, stat.st_size, path))
        held = sum(size for _, size, _ in copies)
        for used, size, path in sorted(copies):
            half = path.name.startswith(_HALF)
            if now - used < (_DEAD_S if half else _JUST_USED_S):
                continue
            if half or held > self.limit - 2 * self.limit // _SLACK:
                path.unlink(missing_ok=True)
                held -= size


def _touch(path: Path) -> None:
    """Record a use of a copy.

    Raises:
        FileNotFoundError: there is none.
    """
    if time.time() - path.stat().st_mtime > _TOUCHED_S:
        os.utime(path)
