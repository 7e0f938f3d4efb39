"""A server as a process of its own, for clients that only use HTTP."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import httpx

from solmap.flows.runtime.engine import free_port

_SERVE = (
    "import sys, pathlib, uvicorn; from solmap.gis_server.app import create_app; "
    "uvicorn.run(create_app(pathlib.Path(sys.argv[1])), port=int(sys.argv[2]), "
    "log_level='error', timeout_graceful_shutdown=1)"
)


@dataclass(frozen=True, slots=True)
class Server:
    """A running server."""

    port: int
    pid: int

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"


@contextlib.contextmanager
def serving(root: Path) -> Iterator[str]:
    """The address of a server of the store at `root`, which ends with the block."""
    with running([sys.executable, "-c", _SERVE, str(root)]) as server:
        yield server.address


@contextlib.contextmanager
def running(command: list[str], environment: Mapping[str, str] | None = None) -> Iterator[Server]:
    """The server that `command`, with a free port as its last word, starts; it answers /healthz."""
    port = free_port()
    process = subprocess.Popen([*command, str(port)], env={**os.environ, **(environment or {})})
    server = Server(port, process.pid)
    try:
        deadline = time.monotonic() + 120.0
        while not _is_ready(server.address):
            assert process.poll() is None, f"{command} ended before it was ready"
            assert time.monotonic() < deadline, f"{command} is not ready after two minutes"
            time.sleep(0.1)
        yield server
    finally:
        process.terminate()
        process.wait(timeout=30)


def _is_ready(address: str) -> bool:
    try:
        with urllib.request.urlopen(f"{address}/healthz", timeout=5) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


@contextlib.contextmanager
def listening(address: str, **headers: str) -> Iterator[queue.Queue]:
    """Events as (kind, id, data, time of arrival), as they come."""
    heard: queue.Queue = queue.Queue()
    client = httpx.Client(timeout=httpx.Timeout(20.0))
    response = client.send(client.build_request("GET", address, headers=headers), stream=True)
    assert response.status_code == 200
    assert response.headers["content-type"].startswith("text/event-stream")

    def listen() -> None:
        fields: dict[str, str] = {}
        try:
            for line in response.iter_lines():
                name, colon, value = line.partition(": ")
                if colon and name:
                    fields[name] = value
                elif not line and "event" in fields:
                    data = json.loads(fields["data"])
                    heard.put((fields["event"], int(fields["id"]), data, time.time()))
                    fields = {}
        except (httpx.HTTPError, httpx.StreamError, OSError):
            pass  # the test has ended

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    try:
        yield heard
    finally:
        response.close()
        client.close()
        thread.join(5)
