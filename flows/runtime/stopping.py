"""Ctrl-C and SIGTERM: they interrupt a command, and end its process soon whatever it is doing.

An interrupted block is left in order where that is quick: records are closed, child processes
stopped. A thread that computes in a library or a read that hangs is not waited for longer than
`GRACE_S`; what was made by then is whole or a draft, as after a kill.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from solmap.flows.runtime.children import kill_children

GRACE_S = 6.0
"""From the signal to the end of the process; children are killed with it."""
STOPPED = "stopped; what was made is kept; run again to continue"
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


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
    told, tells = socket.socketpair()
    tells.settimeout(0.0)
    descriptor = signal.set_wakeup_fd(tells.fileno(), warn_on_full_buffer=False)
    handlers = {number: signal.signal(number, interrupt) for number in _SIGNALS}
    is_over = threading.Event()
    watch = threading.Thread(target=_watch, args=(told, is_over), name="signals", daemon=True)
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
        tells.close()


def end_process(number: int) -> NoReturn:
    """End the process as one that a signal stopped, and its children, with one line."""
    kill_children()
    sys.stderr.write(f"{STOPPED}\n")
    sys.stderr.flush()
    os._exit(128 + number)


def _watch(told: socket.socket, is_over: threading.Event) -> None:
    """End the process some time after it was told to end, if it has not by then."""
    with told:
        number = 0
        while number not in _SIGNALS:
            received = told.recv(1)
            if not received:
                return
            number = received[0]
    if not is_over.wait(GRACE_S):
        end_process(number)
