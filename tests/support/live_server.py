"""The server as a process of its own, for clients that only speak HTTP."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

_SERVE = (
    "import sys, pathlib, uvicorn; from gis_server.app import create_app; "
    "uvicorn.run(create_app(pathlib.Path(sys.argv[1])), port=int(sys.argv[2]), "
    "log_level='error', timeout_graceful_shutdown=1)"
)


@contextlib.contextmanager
def serving(root: Path) -> Iterator[str]:
    """The address of a server of the store at `root`, which ends with the block."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen([sys.executable, "-c", _SERVE, str(root), str(port)])
    address = f"http://127.0.0.1:{port}"
    try:
        deadline = time.monotonic() + 60.0
        while not _is_ready(address):
            assert process.poll() is None, "the server ended before it was ready"
            assert time.monotonic() < deadline, "the server is not ready after a minute"
            time.sleep(0.1)
        yield address
    finally:
        process.terminate()
        process.wait(timeout=30)


def _is_ready(address: str) -> bool:
    try:
        with urllib.request.urlopen(f"{address}/healthz", timeout=5) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False
