"""A server as a process of its own, for clients that only use HTTP."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import queue
import subprocess
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import httpx
import uvicorn

from solmap.flows.runtime.engine import free_port
from solmap.gis_server.app import create_app

_FORKS = multiprocessing.get_context("forkserver")
"""Servers are forked from a process that has imported them: that takes longer than most tests."""
_FORKS.set_forkserver_preload(["solmap.gis_server.app", "uvicorn"])


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
    port = free_port()
    process = _FORKS.Process(target=_serve, args=(root, port, dict(os.environ)), daemon=True)
    process.start()
    server = Server(port, process.pid or 0)
    try:
        _await(server, process.is_alive)
        yield server.address
    finally:
        process.terminate()
        process.join(30)


def _serve(root: Path, port: int, environment: dict[str, str]) -> None:
    os.environ.clear()
    os.environ.update(environment)
    app = create_app(root)
    uvicorn.run(app, port=port, log_level="error", timeout_graceful_shutdown=1)


@contextlib.contextmanager
def running(command: list[str], environment: Mapping[str, str] | None = None) -> Iterator[Server]:
    """The server that `command`, with a free port as its last word, starts; it answers /healthz."""
    port = free_port()
    process = subprocess.Popen([*command, str(port)], env={**os.environ, **(environment or {})})
    server = Server(port, process.pid)
    try:
        _await(server, lambda: process.poll() is None)
        yield server
    finally:
        process.terminate()
        process.wait(timeout=30)


def _await(server: Server, is_alive: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120.0
    while not _is_ready(server.address):
        assert is_alive(), "the server ended before it was ready"
        assert time.monotonic() < deadline, "the server is not ready after two minutes"
        time.sleep(0.1)


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
