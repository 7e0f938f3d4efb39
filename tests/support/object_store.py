"""An S3 server in a process of its own, and a way to it that can be cut.

The server is moto's: objects in memory, the protocol of S3 over HTTP, conditional and multipart
puts among it.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from solmap.flows.runtime.engine import free_port

_BUFFER = 1 << 16


class NoObjectStoreError(Exception):
    """There is none on this machine."""


@dataclass(frozen=True)
class ObjectStore:
    """The server; its log has a line for every request."""

    port: int
    pid: int
    log: Path

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def requests(self) -> list[str]:
        """Method and address of every request so far."""
        lines = self.log.read_text().splitlines()
        return [line.split('"')[1] for line in lines if "HTTP/1.1" in line]

    def bucket(self, name: str) -> str:
        """Make a bucket, and return the URL of a prefix in it."""
        self.request("PUT", name)
        return f"s3://{name}/maps"

    def request(self, method: str, path: str, body: bytes | None = None) -> bytes:
        plain = {"content-type": "application/octet-stream"}
        requested = urllib.request.Request(f"{self.address}/{path}", body, plain, method=method)
        with urllib.request.urlopen(requested, timeout=10) as answer:
            return bytes(answer.read())


def environment_of(address: str) -> dict[str, str]:
    """The variables by which a client finds the server and its keys."""
    return {
        "AWS_ENDPOINT_URL": address,
        "AWS_ACCESS_KEY_ID": "maker",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "us-east-1",
    }


@contextlib.contextmanager
def running_object_store(folder: Path) -> Iterator[ObjectStore]:
    """A server that answers until the block ends.

    Raises:
        NoObjectStoreError: it is not installed.
    """
    if importlib.util.find_spec("moto") is None or importlib.util.find_spec("obstore") is None:
        raise NoObjectStoreError("moto's S3 server or obstore is not installed")
    port = free_port()
    log = folder / "requests.log"
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    with log.open("w") as opened:
        process = subprocess.Popen(command, stdout=opened, stderr=opened)
    try:
        store = ObjectStore(port, process.pid, log)
        deadline = time.monotonic() + 60.0
        while not _answers(store):
            assert process.poll() is None, f"the S3 server ended: {log.read_text()}"
            assert time.monotonic() < deadline, "the S3 server is not ready after a minute"
            time.sleep(0.1)
        yield store
    finally:
        process.kill()
        process.wait(timeout=30)


def _answers(store: ObjectStore) -> bool:
    try:
        store.request("GET", "moto-api/")
    except OSError:
        return False
    return True


@dataclass(eq=False)
class Wire:
    """A way to a server that can be cut, or be slow."""

    target: int
    port: int = 0
    pause_s: float = 0.0
    """Before every piece that goes to the server."""
    cut_after: int | None = None
    """Bytes to the server until every connection breaks."""
    is_cut: bool = False
    _ends: set[socket.socket] = field(default_factory=set)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def cut(self) -> None:
        """Break all connections, and take no more."""
        self.is_cut = True
        for end in list(self._ends):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def repair(self) -> None:
        self.is_cut, self.cut_after = False, None

    def serve(self, listening: socket.socket) -> None:
        while True:
            try:
                near, _ = listening.accept()
            except OSError:
                return
            if self.is_cut:
                near.close()
                continue
            far = socket.create_connection(("127.0.0.1", self.target))
            self._ends |= {near, far}
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=(source, sink, far), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket, far: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while piece := source.recv(_BUFFER):
                if sink is far:
                    time.sleep(self.pause_s)
                    if self.cut_after is not None:
                        self.cut_after -= len(piece)
                        if self.cut_after < 0:
                            self.cut()
                            break
                sink.sendall(piece)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
            self._ends.discard(end)


@contextlib.contextmanager
def wire_to(store: ObjectStore) -> Iterator[Wire]:
    """A way to the server on a port of its own."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        wire = Wire(store.port, listening.getsockname()[1])
        thread = threading.Thread(target=wire.serve, args=(listening,), daemon=True)
        thread.start()
        yield wire
        wire.cut()
        with contextlib.suppress(OSError):
            listening.shutdown(socket.SHUT_RDWR)
    thread.join(timeout=10)


@contextlib.contextmanager
def environment(**variables: str) -> Iterator[None]:
    """Other variables for a while; GDAL reads them in the middle of its work."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def forget_copies(root: Path) -> None:
    """Remove the copies of objects on this machine."""
    shutil.rmtree(root / "cache", ignore_errors=True)
