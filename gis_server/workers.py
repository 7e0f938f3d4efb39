"""Processes that answer heavy requests, one at a time each.

Heavy requests hold Python's lock for tenths of a second and do not release memory, so another
process with the same application answers them. It gets a request in the form of ASGI and returns
the whole answer, a large one in a file. A worker that has taken too long or too much memory is
ended, and a new one started.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import logging
import os
import resource
import tempfile
from dataclasses import dataclass, field
from http import HTTPStatus
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

import anyio
from anyio import CapacityLimiter, to_thread
from starlette.types import ASGIApp, Message, Scope, Send

from solmap.gis_server.launcher import Launcher

log = logging.getLogger(__name__)
_SENT_AS = (
    *("type", "http_version", "method", "scheme", "path", "raw_path", "query_string"),
    *("root_path", "headers", "client", "server"),
)
"""The parts of a request sent to a worker: the rest of a scope belongs to the server's process."""
STALL_S = 60.0
"""Longest time that a client may take for the next megabyte of an answer."""
LEAST_BYTES_S = 100_000
"""Least rate of a client, bytes per second; slower ones are disconnected and free their place."""
LARGEST = 256 << 20
"""Bytes of an answer that lies in a file: the largest part of a raster, 50 million cells of 4
bytes, has 200 MB. RLIMIT_FSIZE would also stop copies of larger products from an object store."""
_SMALL = 1 << 20
"""Bytes of a response passed in memory; larger ones are passed as a file."""


class WorkerLostError(Exception):
    """A worker ended before it had answered."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A whole answer."""

    status: int
    headers: list[tuple[bytes, bytes]]
    body: bytes | Path
    """Body, or its file, which the sender removes."""
    route: str | None
    """The template of the route that answered."""

    @property
    def file_bytes(self) -> int:
        """Size of its file, if it has one."""
        return self.body.stat().st_size if isinstance(self.body, Path) else 0

    def remove(self) -> None:
        """Remove its file, if it has one."""
        if isinstance(self.body, Path):
            self.body.unlink()

    async def send(self, send: Send) -> None:
        """Send it as long as the client reads fast enough, and remove its file."""
        with anyio.move_on_after(STALL_S + self.file_bytes / LEAST_BYTES_S):
            await self._send(send)  # the server closes the connection of an incomplete answer

    async def _send(self, send: Send) -> None:
        start = {"type": "http.response.start", "status": self.status, "headers": self.headers}
        if isinstance(self.body, bytes):
            await send(start)
            await send({"type": "http.response.body", "body": self.body})
            return
        with self.body.open("rb") as file:
            self.remove()
            await send(start)
            while chunk := file.read(_SMALL):
                with anyio.move_on_after(STALL_S) as reading:
                    await send({"type": "http.response.body", "body": chunk, "more_body": True})
                if reading.cancelled_caught:
                    return  # the server closes the connection
            await send({"type": "http.response.body", "body": b""})


class AnswerStorageError(Exception):
    """The body of an answer could not be written to a file; has the status and the reason."""

    def __init__(self, status: HTTPStatus, what: str) -> None:
        super().__init__(status, what)  # both are needed to pass it to another process
        self.status, self.what = status, what


@dataclass(slots=True, eq=False)
class _Body:
    """The body of an answer, part by part; a large one becomes a file of the folder, if any."""

    folder: Path | None
    small: bytearray = field(default_factory=bytearray)
    file: IO[bytes] | None = None
    error: OSError | None = None

    def add(self, part: bytes) -> None:
        """Keep a part."""
        try:
            self._add(part)
        except OSError as error:
            self.error = error
            raise

    def _add(self, part: bytes) -> None:
        if self.file is None and self.folder and len(self.small) + len(part) > _SMALL:
            self.file = tempfile.NamedTemporaryFile(dir=self.folder, delete=False)  # noqa: SIM115 - it stays
            self.file.write(self.small)
        if self.file is None:
            self.small += part
            return
        if self.file.tell() + len(part) > LARGEST:
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
        self.file.write(part)
        self.file.flush()

    def close(self) -> bytes | Path:
        """The collected body.

        Raises:
            AnswerStorageError: a part could not be written; no file is left.
        """
        file = None
        if self.file is not None:
            file = Path(self.file.name)
            with contextlib.suppress(OSError):  # of what could not be written before
                self.file.close()
        if self.error is None:
            return file or bytes(self.small)
        if file is not None:
            file.unlink()
        status = HTTPStatus.SERVICE_UNAVAILABLE
        what = f"the answer could not be written to a temporary file: {self.error.strerror}"
        if self.error.errno == errno.EFBIG:
            status = HTTPStatus.UNPROCESSABLE_ENTITY
            what = f"the answer has more than {LARGEST >> 20} MiB; request less at once"
        raise AnswerStorageError(status, what)


async def collect(app: ASGIApp, scope: Scope, body: bytes, folder: Path | None) -> Answer:
    """The whole answer of an application; a large body becomes a file of the folder, if any.

    Raises:
        AnswerStorageError: the file would be larger than `LARGEST`, or the disk is full.
    """
    has_come, starts, kept = False, list[Message](), _Body(folder)

    async def receive() -> Message:
        nonlocal has_come
        if has_come:
            await anyio.sleep_forever()  # disconnected clients are not reported
        has_come = True
        return {"type": "http.request", "body": body, "more_body": False}

    async def keep(message: Message) -> None:
        if message["type"] == "http.response.start":
            starts.append(message)
        else:
            kept.add(message.get("body", b""))

    try:
        await app(scope, receive, keep)
    except Exception:
        if not starts:  # else the application has answered that it failed, and logged why
            raise
    route = getattr(scope.get("route"), "path", None)
    return Answer(starts[0]["status"], list(starts[0]["headers"]), kept.close(), route)


@dataclass(slots=True, eq=False)
class Worker:
    """The server's side of one worker process."""

    arguments: tuple[Any, ...]
    """Arguments of `create_app`."""
    memory_mb: int
    """Memory limit of a request, beyond that of the application."""
    launcher: Launcher = field(default_factory=Launcher)
    """Several workers may share it."""
    _number: int | None = None
    """Number of its process at the launcher."""
    _connection: Connection | None = None
    _is_used: bool = False
    """Whether it has answered a request."""
    _threads: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(1))

    _folder: Path | None = None

    def start(self, folder: Path | None) -> None:
        """Start the process without waiting; it writes large answers to its own `folder`."""
        self.stop()
        self._folder = folder
        self._threads = CapacityLimiter(1)  # the thread of a request that was given up may be left
        self._number, self._connection = self.launcher.start()
        self._connection.send((self.arguments, self.memory_mb, folder))

    def wait(self, most_s: float) -> None:
        """Wait until the process has started, which takes seconds of processor time."""
        if self._number is not None:
            self.launcher.wait_for(self._number, most_s)

    def stop(self) -> None:
        """End the process in any state."""
        if self._number is not None:
            self.launcher.end(self._number)
        if self._connection is not None:
            self._connection.close()
        self._number = self._connection = None
        self._is_used = False

    async def answer(self, scope: Scope, body: bytes, most_s: float) -> Answer:
        """The response to a request; by a new process if memory is too low for it.

        Raises:
            TimeoutError: it took too long.
            WorkerLostError: the process ended, as one that takes too much memory does.
            AnswerStorageError: the answer is too large.
        """
        if (
            self._connection is None or self._connection.poll()
        ):  # it has ended: it sends nothing on its own
            await to_thread.run_sync(self.start, self._folder)
        request = {name: scope[name] for name in _SENT_AS if name in scope}
        try:
            with anyio.fail_after(most_s):
                answer, is_full = await self._answer_of(request, body)
        except BaseException as error:
            with anyio.CancelScope(shield=True):
                await to_thread.run_sync(self._discard)
            if isinstance(error, EOFError | OSError) and not isinstance(error, TimeoutError):
                raise WorkerLostError from error
            raise
        if is_full:
            with anyio.CancelScope(shield=True):  # else the file of the answer would stay
                await to_thread.run_sync(self.start, self._folder)
        if isinstance(answer, AnswerStorageError):
            raise answer
        return answer

    async def _answer_of(
        self, request: dict[str, Any], body: bytes
    ) -> tuple[Answer | AnswerStorageError, bool]:
        try:
            answer, is_full, lacked_memory = await self._exchange(request, body)
        except (EOFError, OSError):  # it has ended: libraries of C do so where memory is lacking
            if not self._is_used:
                raise
            lacked_memory = True
        if lacked_memory and self._is_used:
            with anyio.CancelScope(shield=True):
                await to_thread.run_sync(self._discard)
                await to_thread.run_sync(self.start, self._folder)
            answer, is_full, _ = await self._exchange(request, body)
        self._is_used = True
        return answer, is_full

    def _discard(self) -> None:
        """End the process and remove the answer that it was writing."""
        self.stop()
        with contextlib.suppress(OSError):  # the server ends, and its folder with it
            for half in self._folder.iterdir() if self._folder else ():
                half.unlink()  # earlier answers are open files without a name

    @property
    def memory_bytes(self) -> int:
        """Resident memory of the process."""
        pid = self._number and self.launcher.pid(self._number)
        with contextlib.suppress(OSError, IndexError):
            return resident_bytes(pid) if pid else 0
        return 0

    async def _exchange(
        self, request: dict[str, Any], body: bytes
    ) -> tuple[Answer | AnswerStorageError, bool, bool]:
        """Reply of the process: the response, whether it has grown, whether memory was lacking."""
        connection = self._connection
        assert connection is not None  # noqa: S101 - `answer` has started it

        def exchange() -> tuple[Answer | AnswerStorageError, bool, bool]:
            connection.send((request, body))
            result: tuple[Answer | AnswerStorageError, bool, bool] = connection.recv()
            return result

        return await to_thread.run_sync(exchange, abandon_on_cancel=True, limiter=self._threads)


def limit_arenas() -> None:
    """Share freed memory among the threads of this process: glibc keeps one heap per thread."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).mallopt(-8, 2)  # M_ARENA_MAX


def resident_bytes(pid: int) -> int:
    """Memory that a process holds now."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize()
