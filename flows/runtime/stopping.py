"""Ctrl-C and SIGTERM interrupt a command and end its process soon, in any state.

An interrupted block is left in order if that is quick: records are closed, child processes stopped.
A thread that computes in a library or a read that hangs is not waited for longer than `GRACE_S`;
finished products are complete, others are drafts, as after a kill. A guard, a small process, is
notified of the signal by the kernel and kills a process that cannot run because a library keeps the
interpreter's lock.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from solmap.flows.runtime.children import kill_children

GRACE_S = 6.0
"""Time from the signal to the end of the process; children are killed with it."""
STOPPED = "stopped; what was made is kept; run again to continue"
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_GUARD = """
import os, select, sys, time
pid, grace_s, signals = int(sys.argv[1]), float(sys.argv[2]), sys.argv[3:]
while (number := os.read(0, 1)) and str(number[0]) not in signals:
    pass
if number:
    os.write(1, number)
    end = time.monotonic() + grace_s
    while select.select([0], [], [], max(0.0, end - time.monotonic()))[0]:
        if not os.read(0, 1):
            sys.exit()  # the process has ended
    os.kill(pid, 9)
"""
"""Script of the guard: it passes on the first signal and kills a process that does not end."""


@contextmanager
def end_on_signals(on_signal: Callable[[], None] | None = None) -> Iterator[None]:
    """Interrupt the block on Ctrl-C and SIGTERM; the process ends within `GRACE_S`.

    A second signal ends it at once.

    Args:
        on_signal: Called instead of interrupting the block.
    """
    signals: list[int] = []

    def interrupt(number: int, _: FrameType | None) -> None:
        signals.append(number)
        if len(signals) > 1:
            end_process(number)
        if on_signal is None:
            raise KeyboardInterrupt
        on_signal()

    # The interpreter writes the number of a signal here at once, also where Prefect has a handler
    # of its own, and while the main thread is in a library.
    reader, writer = socket.socketpair()
    writer.settimeout(0.0)
    descriptor = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    handlers = {number: signal.signal(number, interrupt) for number in _SIGNALS}
    with reader:
        guard = _start_guard(reader)
    is_over = threading.Event()
    watch = threading.Thread(target=_watch, args=(guard, is_over), name="signals", daemon=True)
    watch.start()
    try:
        yield
    except BaseException as error:
        if not (isinstance(error, KeyboardInterrupt) or hasattr(error, "signal")):  # Prefect's own
            raise
        end_process(signals[0] if signals else signal.SIGINT)
    finally:
        is_over.set()
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(descriptor)
        writer.close()


def end_process(number: int) -> NoReturn:
    """End the process and its children as after a signal, with one line."""
    kill_children()
    sys.stderr.write(f"{STOPPED}\n")
    sys.stderr.flush()
    os._exit(128 + number)


def _start_guard(reader: socket.socket) -> subprocess.Popen[bytes]:
    limit = (str(os.getpid()), str(GRACE_S + 1.0), *(str(int(number)) for number in _SIGNALS))
    return subprocess.Popen(  # noqa: S603 - our own command line
        (sys.executable, "-I", "-S", "-c", _GUARD, *limit),
        stdin=reader.fileno(),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _watch(guard: subprocess.Popen[bytes], is_over: threading.Event) -> None:
    """Kill the process some time after the signal, if it has not ended by then."""
    with guard:
        number = guard.stdout.read(1) if guard.stdout else b""
        if number and not is_over.wait(GRACE_S):
            end_process(number[0])
