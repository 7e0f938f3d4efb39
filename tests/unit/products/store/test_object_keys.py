"""Without keys an object store is refused; no metadata service is queried."""

import socket
import threading

import pytest

from solmap.products.errors import ProductError
from solmap.products.store.backends import ObjectStorage
from solmap.products.store.object_backend import open_object_backend

STORAGE = ObjectStorage("s3://a-bucket/a-prefix", 1.0)


@pytest.fixture
def requested(monkeypatch):
    """Requests to the address where a cloud would hand out keys."""
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_WEB_IDENTITY_TOKEN_FILE"):
        monkeypatch.delenv(name, raising=False)
    found = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                with connection:
                    found.append(connection.recv(1000))
                    connection.sendall(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n")

        threading.Thread(target=answer, daemon=True).start()
        address = f"http://127.0.0.1:{server.getsockname()[1]}"
        monkeypatch.setenv("AWS_METADATA_ENDPOINT", address)
        monkeypatch.setenv("AWS_ENDPOINT_URL", address)
        yield found
        server.shutdown(socket.SHUT_RDWR)


def test_a_store_without_keys_is_refused_and_no_metadata_service_is_queried(requested, tmp_path):
    with pytest.raises(ProductError, match="no keys to s3://a-bucket/a-prefix: set AWS_ACCESS_KEY"):
        open_object_backend(STORAGE, tmp_path / "a").probe()
    assert not requested


def test_a_key_without_its_secret_is_incomplete(requested, tmp_path, monkeypatch):
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "maker")
    with pytest.raises(ProductError, match="AWS_SECRET_ACCESS_KEY"):
        open_object_backend(STORAGE, tmp_path / "b").probe()
    assert not requested


def test_a_machine_role_is_used_if_the_environment_permits_it(requested, tmp_path, monkeypatch):
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "false")
    with pytest.raises(Exception, match="a-bucket"):
        open_object_backend(STORAGE, tmp_path / "c").probe()
    assert any(b"/latest/" in request for request in requested)
