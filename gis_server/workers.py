"""Processes that answer heavy requests, one at a time each.

Heavy requests hold Python's lock for tenths of a second and memory for good, so they are answered
by another process that has the same application. It is given a request as ASGI has it and gives the
whole answer back; a large one lies in a file. A worker that has taken too long or too much memory
is ended, and a new one started.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

import anyio
from anyio import CapacityLimiter, to_thread
from starlette.types import ASGIApp, Message, Scope, Send

log = logging.getLogger(__name__)
_SENT_AS = (
    *("type", "http_version", "method", "scheme", "path", "raw_path", "query_string"),
    *("root_path", "headers", "client", "server"),
)
"""What a worker is told of a request: the rest of a scope belongs to the server's process."""
STALL_S = 60.0
"""Longest time that a client may take for the next megabyte of an answer."""
_SMALL = 1 << 20
"""Bytes of an answer that are handed over in memory; larger ones are handed over as a file."""
_ENVIRONMENT = {
    "MALLOC_ARENA_MAX": "2",
    "GDAL_CACHEMAX": "64",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}
_START = "from solmap.gis_server.worker_process import main; main()"


class WorkerLostError(Exception):
    """A worker ended before it had answered."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A whole answer."""

    status: int
    headers: list[tuple[bytes, bytes]]
    body: bytes | Path
    """Or the file that it lies in, which whoever sends it removes."""
    route: str | None
    """The template of the route that answered."""

    async def send(self, send: Send) -> None:
        """Send it, and remove its file."""
        start = {"type": "http.response.start", "status": self.status, "headers": self.headers}
        if isinstance(self.body, bytes):
            await send(start)
            await send({"type": "http.response.body", "body": self.body})
            return
        with self.body.open("rb") as file:
            self.body.unlink()
            await send(start)
            while chunk := file.read(_SMALL):
                with anyio.move_on_after(STALL_S) as reading:
                    await send({"type": "http.response.body", "body": chunk, "more_body": True})
                if reading.cancelled_caught:
                    return  # the server closes the connection
            await send({"type": "http.response.body", "body": b""})


async def collect(app: ASGIApp, scope: Scope, body: bytes, folder: Path | None) -> Answer:
    """The whole answer of an application; a large body becomes a file of the folder, if any."""
    has_come, starts, small = False, list[Message](), bytearray()
    file: IO[bytes] | None = None

    async def receive() -> Message:
        nonlocal has_come
        if has_come:
            await anyio.sleep_forever()  # nobody hears of clients that leave
        has_come = True
        return {"type": "http.request", "body": body, "more_body": False}

    async def keep(message: Message) -> None:
        nonlocal file
        if message["type"] == "http.response.start":
            starts.append(message)
            return
        part = message.get("body", b"")
        if file is None and folder is not None and len(small) + len(part) > _SMALL:
            file = tempfile.NamedTemporaryFile(dir=folder, delete=False)  # noqa: SIM115 - it stays
            file.write(small)
        (small.extend if file is None else file.write)(part)

    try:
        await app(scope, receive, keep)
    except Exception:
        if not starts:  # else the application has answered that it failed, and logged why
            raise
    finally:
        if file is not None:
            file.close()
    route = getattr(scope.get("route"), "path", None)
    found = bytes(small) if file is None else Path(file.name)
    return Answer(starts[0]["status"], list(starts[0]["headers"]), found, route)


@dataclass(slots=True, eq=False)
class Worker:
    """One such process, seen from the server."""

    arguments: tuple[Any, ...]
    """Of `create_app`."""
    memory_mb: int
    """What a request may take beyond what the application itself does."""
    _process: subprocess.Popen[bytes] | None = None
    _connection: Connection | None = None
    _threads: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(1))

    _folder: Path | None = None

    def start(self, folder: Path | None) -> None:
        """Start the process, which lays large answers into `folder`, and go on meanwhile."""
        self.stop()
        self._folder = folder
        self._threads = CapacityLimiter(1)  # the thread of a request that was given up may be left
        self._connection, other = Pipe()
        with other:
            self._process = subprocess.Popen(  # noqa: S603 - this program
                [sys.executable, "-P", "-c", _START, str(other.fileno())],
                env={**_ENVIRONMENT, **os.environ},
                stdin=subprocess.DEVNULL,
                pass_fds=[other.fileno()],
            )
        self._connection.send((self.arguments, self.memory_mb, folder))

    def stop(self) -> None:
        """End the process, whatever it does."""
        if self._connection is not None:
            self._connection.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process = self._connection = None

    async def ask(self, scope: Scope, body: bytes, most_s: float) -> Answer:
        """The answer to a request.

        Raises:
            TimeoutError: it took too long.
            WorkerLostError: the process ended, as one that takes too much memory does.
        """
        if self._process is None or self._process.poll() is not None:
            self.start(self._folder)
        request = {name: scope[name] for name in _SENT_AS if name in scope}
        try:
            with anyio.fail_after(most_s):
                answer, is_full = await to_thread.run_sync(
                    self._exchange, request, body, abandon_on_cancel=True, limiter=self._threads
                )
        except BaseException as error:
            self.stop()
            if isinstance(error, EOFError | OSError) and not isinstance(error, TimeoutError):
                raise WorkerLostError from error
            raise
        if is_full:
            self.start(self._folder)
        return answer

    @property
    def memory_bytes(self) -> int:
        """Resident memory of the process."""
        if self._process is None:
            return 0
        with contextlib.suppress(OSError, IndexError):
            return resident_bytes(self._process.pid)
        return 0

    def _exchange(self, request: dict[str, Any], body: bytes) -> tuple[Answer, bool]:
        assert self._connection is not None  # noqa: S101 - `ask` has started it
        connection = self._connection
        connection.send((request, body))
        answer: tuple[Answer, bool] = connection.recv()
        return answer


def limit_arenas() -> None:
    """Have this process's threads share memory that was freed: glibc keeps a heap a thread."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).mallopt(-8, 2)  # M_ARENA_MAX


def resident_bytes(pid: int) -> int:
    """Memory that a process holds now."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize()
