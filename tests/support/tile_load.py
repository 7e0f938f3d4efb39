"""A bare HTTP client that times requests on kept connections, and a server's processor time.

Much lighter than a client library, so that what is timed is the server.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Load:
    """How a server answered some requests."""

    seconds: np.ndarray
    """Of every answer."""
    wall_s: float
    cpu_s: float
    """Of the server's process."""
    size: int
    """Bytes of all bodies."""

    @property
    def figures(self) -> dict[str, float]:
        count = len(self.seconds)
        p50, p95 = (float(np.percentile(self.seconds, p)) for p in (50, 95))
        return {
            "p50 ms": round(1e3 * p50, 2),
            "p95 ms": round(1e3 * p95, 2),
            "tiles/s": round(count / self.wall_s),
            "cpu ms/tile": round(1e3 * self.cpu_s / count, 2),
            "kB/tile": round(self.size / count / 1e3, 1),
        }


def load(port: int, pid: int, paths: Sequence[str], connections: int = 1) -> Load:
    """Request all paths, shared among some connections."""
    shares = [paths[first::connections] for first in range(connections)]
    results: list[tuple[list[float], int]] = [([], 0)] * connections
    clients = [_Connection(port) for _ in range(connections)]

    def request(number: int) -> None:
        results[number] = clients[number].request(shares[number])

    threads = [threading.Thread(target=request, args=(number,)) for number in range(connections)]
    before, started = cpu_seconds(pid), time.perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    wall, cpu = time.perf_counter() - started, cpu_seconds(pid) - before
    for client in clients:
        client.close()
    seconds = np.array([one for times, _ in results for one in times])
    assert len(seconds) == len(paths)
    return Load(seconds, wall, cpu, sum(size for _, size in results))


def cpu_seconds(pid: int) -> float:
    """Processor time that a process has taken, in its own code and in the system's for it."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


class _Connection:
    """One kept connection."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def close(self) -> None:
        self.socket.close()

    def request(self, paths: Sequence[str]) -> tuple[list[float], int]:
        seconds, size = [], 0
        for path in paths:
            started = time.perf_counter()
            self.socket.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            size += self._answer(path)
            seconds.append(time.perf_counter() - started)
        return seconds, size

    def _answer(self, path: str) -> int:
        data = b""
        while b"\r\n\r\n" not in data:
            data += self._more(path)
        head, body = data.split(b"\r\n\r\n", 1)
        lines = head.decode("latin-1").lower().split("\r\n")
        assert lines[0].split()[1] == "200", f"{path}: {lines[0]}"
        length = next(
            int(line.split(":")[1]) for line in lines if line.startswith("content-length")
        )
        missing = length - len(body)
        while missing > 0:
            missing -= len(self._more(path))
        return length

    def _more(self, path: str) -> bytes:
        part = self.socket.recv(1 << 18)
        assert part, f"{path}: the connection was closed"
        return part
