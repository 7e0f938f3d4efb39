"""What is made of a server's refusals, by the client and by GDAL."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from solmap.products.errors import ProductError, StoreAwayError
from solmap.products.formats.raster.raster import open_raster
from solmap.products.store.backends import ObjectStorage
from solmap.products.store.faults import is_transient
from solmap.products.store.object_backend import bucket_and_prefix, client_of
from solmap.products.store.product_store import ProductStore
from tests.support.object_store import environment, environment_of

pytest.importorskip("obstore", reason="obstore is not installed")
BODY = "<Error><Code>{}</Code><Message>{}</Message></Error>"
SLOW_DOWN = BODY.format("SlowDown", "Please reduce your request rate.")
DENIED = BODY.format("AccessDenied", "Access Denied")


class Answers(BaseHTTPRequestHandler):
    """Says the same to everybody."""

    def do_GET(self) -> None:
        status, body = self.server.answer
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body.encode())

    do_HEAD = do_GET

    def log_message(self, *_: object) -> None:
        """Say nothing."""


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
def test_what_gdal_says_is_told_apart(server, status, body, kind, passes):
    server.answer = status, body
    client_of("bucket", "maps")  # which tells GDAL where the server is
    with pytest.raises(kind) as refused:
        open_raster(f"/vsis3/bucket/maps/{status}.tif")
    assert is_transient(refused.value) is passes


@pytest.mark.parametrize(
    ("status", "body", "said", "passes"),
    [
        (503, SLOW_DOWN, "does not answer", True),
        (403, DENIED, "does not open s3://bucket/maps with these keys", False),
    ],
)
def test_what_the_client_says_is_told_apart(server, tmp_path, status, body, said, passes):
    server.answer = status, body
    with pytest.raises(ProductError, match=said) as refused:
        ProductStore.open(tmp_path, ObjectStorage("s3://bucket/maps"))
    assert is_transient(refused.value) is passes
    assert len(str(refused.value)) < 600


def test_a_url_is_a_bucket_and_a_prefix():
    assert bucket_and_prefix("s3://bucket/some/prefix/") == ("bucket", "some/prefix")
    assert bucket_and_prefix("s3://bucket") == ("bucket", "")
