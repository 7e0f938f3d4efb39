"""How an object store is reached: its endpoint, its client, and what its errors mean.

Keys, region and endpoint come from the usual AWS_* variables; GDAL is told the same endpoint.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from datetime import timedelta
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from solmap.products.errors import ProductError, StoreAwayError

if TYPE_CHECKING:
    from obstore.store import S3Store

_RETRIES, _RETRY_S = 4, 60
_CONNECT_S, _SILENCE_S, _REQUEST_S = 5, 60, 600
_AMAZON = "https://s3.amazonaws.com"
_URLS = "say SOLMAP_STORE_URL=s3://bucket/prefix, or leave it out"
_REFUSALS = ("AccessDenied", "InvalidAccessKeyId", "SignatureDoesNotMatch", "403 Forbidden")
_GDAL = {
    "GDAL_HTTP_MAX_RETRY": "3",
    "GDAL_HTTP_RETRY_DELAY": "0.2",
    "GDAL_HTTP_CONNECTTIMEOUT": str(_CONNECT_S),
    "GDAL_HTTP_TIMEOUT": str(_SILENCE_S),
}


def bucket_and_prefix(url: str) -> tuple[str, str]:
    """The two parts of `s3://bucket/prefix`.

    Raises:
        ProductError: the URL is of another kind.
    """
    parts = urlsplit(url)
    if parts.scheme != "s3" or not parts.netloc or parts.query or parts.fragment:
        raise ProductError(f"products cannot lie at {url!r}; {_URLS}")
    return parts.netloc, parts.path.strip("/")


def client_of(bucket: str, prefix: str) -> S3Store:
    """A client of the objects below a prefix; threads may share it, processes may not.

    Raises:
        ProductError: what reads objects is not installed.
    """
    try:
        from obstore.store import S3Store  # noqa: PLC0415 - only where a store is given by URL
    except ModuleNotFoundError as error:
        raise ProductError(
            f"products at s3://{bucket}/{prefix} are read with obstore, which is not installed; "
            "install solmap with its extra `cluster`"
        ) from error
    _tell_gdal(bucket)
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


def endpoint() -> str:
    """Where the object store is."""
    names = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")
    return next((url for url in map(os.environ.get, names) if url), _AMAZON)


def _tell_gdal(bucket: str) -> None:
    """Give GDAL the same endpoint in its own words; it reads the variables of keys by itself.

    What it could not open it would remember as absent, long after the store answers again.
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
def explaining(url: str, *, sending: bool = False) -> Iterator[None]:
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
        is_missing = isinstance(error, FileNotFoundError)
        if says(error, ("NoSuchBucket",)) or (sending and is_missing):
            raise ProductError(
                f"there is no bucket {urlsplit(url).netloc} at {endpoint()}; make it, or set "
                "SOLMAP_STORE_URL and AWS_ENDPOINT_URL right"
            ) from error
        if is_missing:
            raise
        refused = isinstance(error, PermissionDeniedError | UnauthenticatedError)
        if refused or says(error, _REFUSALS):
            raise ProductError(
                f"{endpoint()} does not open {url} with these keys: {_first(error)}; "
                "set AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_REGION right"
            ) from error
        raise StoreAwayError(
            f"the object store {url} at {endpoint()} does not answer: {_first(error)}; "
            "is it running, and is AWS_ENDPOINT_URL right?"
        ) from error


def says(error: Exception, words: tuple[str, ...]) -> bool:
    """Whether an error of the client has one of some words."""
    return any(word in str(error) for word in words)


def _first(error: Exception) -> str:
    """What happened, without the client's own record of it."""
    return " ".join(str(error).partition("Debug source")[0].split())
