"""What is made of a server's refusals, by the client and by GDAL."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from solmap.products.errors import ProductError, StoreAwayError
from solmap.products.formats.raster.raster import open_raster
from solmap.products.store.backends import ObjectStorage
from solmap.products.store.faults import is_transient
from solmap.products.store.object_backend import ReadCache, bucket_and_prefix, client_of
from solmap.products.store.product_store import ProductStore
from tests.support.object_store import environment, environment_of

pytest.importorskip("obstore", reason="obstore is not installed")
BODY = "<Error><Code>{}</Code><Message>{}</Message></Error>"
SLOW_DOWN = BODY.format("SlowDown", "Please reduce your request rate.")
DENIED = BODY.format("AccessDenied", "Access Denied")


class Answers(BaseHTTPRequestHandler):
    """Gives the same answer to every request."""

    def do_GET(self) -> None:
        status, body = self.server.answer
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body.encode())

    do_HEAD = do_GET

    def log_message(self, *_: object) -> None:
        """Log nothing."""


@pytest.fixture
def server() -> Iterator[ThreadingHTTPServer]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as found:
        thread = threading.Thread(target=found.serve_forever, daemon=True)
        thread.start()
        quick = {"GDAL_HTTP_MAX_RETRY": "0"}
        with environment(**environment_of(f"http://127.0.0.1:{found.server_port}"), **quick):
            yield found
        found.shutdown()
        thread.join()


@pytest.mark.parametrize(
    ("status", "body", "kind", "passes"),
    [
        (503, SLOW_DOWN, StoreAwayError, True),
        (403, DENIED, ProductError, False),
        (200, "no raster" * 100, ProductError, False),
    ],
)
def test_gdal_errors_are_classified(server, status, body, kind, passes):
    server.answer = status, body
    client_of("bucket", "maps")  # which gives GDAL the address of the server
    with pytest.raises(kind) as refused:
        open_raster(f"/vsis3/bucket/maps/{status}.tif")
    assert is_transient(refused.value) is passes


@pytest.mark.parametrize(
    ("status", "body", "message", "passes"),
    [
        (503, SLOW_DOWN, "does not respond", True),
        (403, DENIED, "does not give access to s3://bucket/maps with these keys", False),
    ],
)
def test_client_errors_are_classified(server, tmp_path, status, body, message, passes):
    server.answer = status, body
    with pytest.raises(ProductError, match=message) as refused:
        ProductStore.open(tmp_path, ObjectStorage("s3://bucket/maps"))
    assert is_transient(refused.value) is passes
    assert len(str(refused.value)) < 600


def test_a_url_is_a_bucket_and_a_prefix():
    assert bucket_and_prefix("s3://bucket/some/prefix/") == ("bucket", "some/prefix")
    assert bucket_and_prefix("s3://bucket") == ("bucket", "")


def fetch_of(size, requested):
    def fetch(path):
        requested.append(path)
        path.write_bytes(b"x" * size)

    return fetch


def age(cache, name, seconds):
    past = time.time() - seconds
    os.utime(cache.folder / name, (past, past))


def held(cache):
    return {
        path.relative_to(cache.folder).as_posix()
        for path in cache.folder.rglob("*")
        if path.is_file()
    }


def test_a_file_is_fetched_once(tmp_path):
    cache, requested = ReadCache(tmp_path, 1000), []
    for _ in range(2):
        assert cache.path("dtm/a.tif", fetch_of(10, requested)).read_bytes() == b"x" * 10
    assert len(requested) == 1


def test_the_least_recently_used_files_are_removed_first_and_the_limit_holds(tmp_path):
    cache, requested = ReadCache(tmp_path, 1000), []
    for number in range(12):
        name = f"dtm/{number}.tif"
        cache.path(name, fetch_of(100, requested))
        age(cache, name, 3600 - number)
        if number == 4:
            age(cache, "dtm/0.tif", 400)  # used again
    assert sum(path.stat().st_size for path in tmp_path.rglob("*.tif")) <= 1000
    assert "dtm/0.tif" in held(cache)
    assert {"dtm/1.tif", "dtm/2.tif"}.isdisjoint(held(cache))
    assert "dtm/11.tif" in held(cache)


def test_recently_used_files_stay_even_above_the_limit(tmp_path):
    cache = ReadCache(tmp_path, 100)
    for number in range(5):
        cache.path(f"{number}.tif", fetch_of(100, []))
    assert len(held(cache)) == 5


def test_a_failed_fetch_leaves_no_file(tmp_path):
    def fail(path):
        path.write_bytes(b"half")
        raise ConnectionError

    cache = ReadCache(tmp_path, 100)
    with pytest.raises(ConnectionError):
        cache.path("a.tif", fail)
    assert held(cache) == set()
    assert cache.path("a.tif", fetch_of(3, [])).read_bytes() == b"xxx"


def test_partial_files_of_a_killed_process_are_removed(tmp_path):
    cache = ReadCache(tmp_path, 1000)
    for name, seconds in ((".half-old", 7200.0), (".half-young", 60.0)):
        (tmp_path / name).write_bytes(b"half")
        age(cache, name, seconds)
    cache.evict()
    assert held(cache) == {".half-young"}
