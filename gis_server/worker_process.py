"""The worker process, and the launcher that it forks from.

A worker answers the requests that the server sends it, one by one.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import logging
import os
import resource
import signal
import sys
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle
from pathlib import Path
from typing import NoReturn

from anyio import to_thread

from solmap.gis_server.app import create_app
from solmap.gis_server.errors import LACKED_MEMORY
from solmap.gis_server.workers import Answer, AnswerStorageError, collect, resident_bytes
from solmap.products.store.garbage import collect_garbage_rarely, exempt_objects_from_collection
from solmap.products.store.process import log_to_store, return_free_memory

log = logging.getLogger(__name__)
_NICENESS = 10
"""Tiles and health come first where processors are few."""
_DIE_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of prctl(2)."""


def _limit_memory(memory_mb: int) -> None:
    """Limit memory: allocations fail beyond this amount above the current use."""
    with contextlib.suppress(OSError, ValueError):
        words = Path("/proc/self/status").read_text().split()
        taken = int(words[words.index("VmData:") + 1]) << 10
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (taken + (memory_mb << 20), hard))


async def _answer_all(connection: Connection) -> None:
    """Answer requests until the server ends."""
    arguments, memory_mb, folder = await to_thread.run_sync(connection.recv)
    with contextlib.suppress(OSError):  # a read-only store has no log
        log_to_store(arguments[0], "server")
    collect_garbage_rarely()
    app = create_app(*arguments)
    logging.getLogger("solmap").setLevel(logging.WARNING)  # the server logs the requests
    at_start = resident_bytes(os.getpid())
    _limit_memory(memory_mb)
    while True:
        try:
            request, body = await to_thread.run_sync(connection.recv)
        except EOFError:
            return
        answer: Answer | AnswerStorageError
        try:
            answer = await collect(app, request, body, folder)
        except AnswerStorageError as error:
            answer = error
        return_free_memory()
        lacked_memory = request.get(LACKED_MEMORY, False)
        is_full = resident_bytes(os.getpid()) > at_start + (memory_mb << 20) // 2
        await to_thread.run_sync(connection.send, (answer, is_full, lacked_memory))


def launch() -> None:
    """Start and end workers on requests of the server through a pipe, until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server ends its workers
    _die_with_parent()
    os.nice(_NICENESS)
    exempt_objects_from_collection()
    control, pids = Connection(int(sys.argv[1])), dict[int, int]()
    with contextlib.suppress(EOFError, OSError):
        while True:
            number, is_start = control.recv()
            if is_start:
                handle = recv_handle(control)
                pids[number] = os.fork()
                if pids[number] == 0:
                    control.close()
                    _work(Connection(handle))
                os.close(handle)
                control.send((number, pids[number]))
            else:
                _end(pids.pop(number))
                control.send((number, 0))
    for pid in pids.values():
        _end(pid)


def _end(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)  # its process id is not reused before the wait
    os.waitpid(pid, 0)


def _work(connection: Connection) -> NoReturn:
    """Run as a worker of the server at the other end."""
    try:
        _die_with_parent()
        asyncio.run(_answer_all(connection))
    except BaseException:
        log.exception("a process that answers heavy requests failed")
    finally:
        os._exit(0)


def _die_with_parent() -> None:
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
