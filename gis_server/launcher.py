"""The process that workers fork from.

A child of the server itself would end with the thread that started it (PR_SET_PDEATHSIG), and its
start holds Python's lock, which stops all threads of the server for a tenth of a second or more on
few processors. A forked worker has the modules of the launcher at once, in shared memory.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.reduction import send_handle

_ENVIRONMENT = {
    "MALLOC_ARENA_MAX": "2",
    "GDAL_CACHEMAX": "64",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}
_POLL_S = 0.02
_START = "from solmap.gis_server.worker_process import launch; launch()"


@dataclass(slots=True, eq=False)
class Launcher:
    """Starts and ends workers through a process that is started with the first of them."""

    _process: subprocess.Popen[bytes] | None = None
    _control: Connection | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _number: int = 0
    _pids: dict[int, int] = field(default_factory=dict)
    """Process ids of workers, as the launcher reports them."""

    def start(self) -> tuple[int, Connection]:
        """Number of a new worker, which is still starting, and the connection with it."""
        mine, other = Pipe()
        with other, self._lock:
            self._number += 1
            try:
                self._pass_connection(other)
            except OSError:  # the process was killed, and its workers with it
                self._close()
                self._pass_connection(other)
            return self._number, mine

    def end(self, number: int) -> None:
        """End a worker in any state; the kernel may take 0.4 s to free its memory."""
        with self._lock, contextlib.suppress(OSError, EOFError):  # all ended with the process
            if self._control is not None:
                self._control.send((number, False))
                while number not in self._pids or self._pids[number]:
                    self._note_pid(self._control)
        self._pids.pop(number, None)

    def pid(self, number: int) -> int | None:
        """The process of a worker, once it is known."""
        with self._lock, contextlib.suppress(OSError, EOFError):
            while self._control is not None and self._control.poll():
                self._note_pid(self._control)
        return self._pids.get(number)

    def wait_for(self, number: int, most_s: float) -> None:
        """Wait until a worker has forked, that is until all modules are imported."""
        end = time.monotonic() + most_s
        while self.pid(number) is None and time.monotonic() < end:
            time.sleep(_POLL_S)

    def close(self) -> None:
        """End the process, which ends the remaining workers."""
        with self._lock:
            self._close()

    def _pass_connection(self, connection: Connection) -> None:
        if self._process is None or self._control is None:
            self._control, other = Pipe()
            with other:
                self._process = subprocess.Popen(  # noqa: S603 - this program
                    [sys.executable, "-P", "-c", _START, str(other.fileno())],
                    env={**_ENVIRONMENT, **os.environ},
                    stdin=subprocess.DEVNULL,
                    pass_fds=[other.fileno()],
                )
        self._control.send((self._number, True))
        send_handle(self._control, connection.fileno(), self._process.pid)

    def _note_pid(self, control: Connection) -> None:
        number, pid = control.recv()
        self._pids[number] = pid

    def _close(self) -> None:
        if self._control is not None:
            self._control.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process = self._control = None
        self._pids.clear()
