"""Processes that belong to another: they are watched, restarted, and never outlive it.

The kernel kills a child when its parent dies (`PR_SET_PDEATHSIG`), so that even `kill -9` of the
parent leaves no orphan behind. On systems without it children end when they are stopped in order.

No child reads code or settings from the folder that a user is in: Python starts with `-P`, in the
folder of the logs, and with those variables of the environment only that are meant for it.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

_NICENESS = 10
_PR_SET_PDEATHSIG = 1
_RESTED_S = 60.0
"""A child that ran so long has started well; how often it died before is forgotten."""
_LONGEST_PAUSE_S = 30.0
_LARGEST_LOG_BYTES = 16_000_000
_PASSED_ON = re.compile(
    r"PATH|LD_LIBRARY_PATH|HOME|USER|LOGNAME|TMPDIR|TZ|LANG|LANGUAGE|LC_\w+|XDG_\w+|MPLCONFIGDIR"
    r"|(SOLMAP|PREFECT|AWS|DASK|GDAL|CPL|VSI|PROJ|MALLOC)_\w+|PG[A-Z]+|DO_NOT_TRACK"
    r"|\w+_NUM_THREADS|OMP_\w+|SSL_CERT_(FILE|DIR)|\w+_CA_BUNDLE|(?i:(https?|all|no)_proxy)"
)
"""Variables of the environment that children get. Not among them: what makes an interpreter or
the loader run other code (`PYTHONPATH`, `PYTHONSTARTUP`, `LD_PRELOAD`), and others' secrets."""


def module_command(module: str, *arguments: str) -> tuple[str, ...]:
    """The command line of a Python module that is never taken from the current folder."""
    return (sys.executable, "-P", "-m", module, *arguments)


def clean_environment() -> dict[str, str]:
    """The environment that children start with; `-P` holds for what they start themselves too."""
    kept = {name: value for name, value in os.environ.items() if _PASSED_ON.fullmatch(name)}
    return {**kept, "PYTHONSAFEPATH": "1"}


def kill_children() -> None:
    """Kill all children of this process and what they started."""
    for child in _started:
        child.kill()


def die_with_parent() -> None:
    """Have the kernel kill this process when the thread that started it ends."""
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    except (AttributeError, OSError):
        return  # no Linux: the parent's orderly stop is all there is


def lower_priority() -> None:
    """Leave the processors to the map's server first: for processes that nobody waits for.

    Where the kernel shares processors out by session (autogroups, sched(7)), to the session too, so
    its first process sets it.
    """
    os.nice(_NICENESS)
    with contextlib.suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(_NICENESS))


@dataclass(slots=True, eq=False)
class Child:
    """A process that should always run, and what is known of its running."""

    name: str
    command: Sequence[str]
    environment: Mapping[str, str]
    log: Path
    """What it prints is added here."""
    process: subprocess.Popen[bytes] | None = None
    deaths: int = 0
    _started_at: float = 0.0
    _not_before: float = 0.0
    _stopping: bool = field(default=False)

    @property
    def is_alive(self) -> bool:
        """Whether it runs now."""
        return self.process is not None and self.process.poll() is None

    @property
    def is_stopping(self) -> bool:
        """Whether it is stopping and is not to be started again."""
        return self._stopping

    def start(self) -> None:
        """Start it; it hears no signal of the terminal, only those that it is sent."""
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(  # noqa: S603 - our own command line
                list(self.command),
                cwd=self.log.parent,
                env={**clean_environment(), **self.environment},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=die_with_parent,  # noqa: PLW1509 - asks the kernel one thing
            )
        self._started_at = time.monotonic()
        if self not in _started:
            _started.append(self)

    def revive(self) -> str | None:
        """Start it again if it died, after a pause that grows each time; returns a message."""
        self._shorten_log()
        if self.is_alive or self._stopping:
            return None
        now = time.monotonic()
        if self._not_before == 0.0:
            self.deaths = 1 if now - self._started_at > _RESTED_S else self.deaths + 1
            pause = min(_LONGEST_PAUSE_S, 2.0 ** (self.deaths - 1))
            self._not_before = now + pause
            code = self.process.returncode if self.process else None
            return f"{self.name} ended with {code}; started again in {pause:.0f} s, see {self.log}"
        if now >= self._not_before:
            self._not_before = 0.0
            self.start()
        return None

    def request_end(self) -> None:
        """Send it SIGTERM and start it no more."""
        self._stopping = True
        if self.process is not None:
            self._signal(signal.SIGTERM)

    def stop(self, patience_s: float = 4.0) -> None:
        """End it and all that it started: by a signal, then by killing it."""
        self.request_end()
        if self.process is None:
            return
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(patience_s)
        self._signal(signal.SIGKILL)  # and whatever of its own it left behind
        self.process.wait()

    def kill(self) -> None:
        """End it and all that it started at once."""
        self._stopping = True
        if self.process is not None:
            self._signal(signal.SIGKILL)

    def _shorten_log(self) -> None:
        """Move what a long log holds to a second file; the child goes on adding to the first."""
        with contextlib.suppress(OSError):
            if self.log.stat().st_size > _LARGEST_LOG_BYTES:
                shutil.copyfile(self.log, self.log.with_suffix(".log.1"))
                os.truncate(self.log, 0)

    def _signal(self, number: int) -> None:
        try:
            os.killpg(self.process.pid, number)  # type: ignore[union-attr]
        except ProcessLookupError:
            return


_started: list[Child] = []
