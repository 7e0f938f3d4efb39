"""Child processes: they are watched, restarted, and end with their parent.

The kernel kills a child when its parent dies (`PR_SET_PDEATHSIG`), so that even `kill -9` of the
parent leaves no orphan behind. On systems without it children end when they are stopped in order.

No child reads code or settings from the folder that a user is in: Python starts with `-P`, in the
folder of the logs, and with a list of permitted environment variables only.
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
"""Running time after which a child has started well: its earlier failures no longer count."""
_LONGEST_PAUSE_S = 30.0
_LARGEST_LOG_BYTES = 16_000_000
_PASSED_ON = re.compile(
    r"PATH|LD_LIBRARY_PATH|HOME|USER|LOGNAME|TMPDIR|TZ|LANG|LANGUAGE|LC_\w+|XDG_\w+|MPLCONFIGDIR"
    r"|(SOLMAP|PREFECT|AWS|DASK|GDAL|CPL|VSI|PROJ|MALLOC)_\w+|PG[A-Z]+|DO_NOT_TRACK"
    r"|\w+_NUM_THREADS|OMP_\w+|SSL_CERT_(FILE|DIR)|\w+_CA_BUNDLE|(?i:(https?|all|no)_proxy)"
)
"""Environment variables that children get.

Left out are those that make an interpreter or the loader run other code (`PYTHONPATH`,
`PYTHONSTARTUP`, `LD_PRELOAD`), and secrets of other programs.
"""


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
        return  # not Linux: children end only when the parent stops in order


def lower_priority() -> None:
    """Lower the priority below that of the map's server, for work that no user waits for.

    If the kernel shares processors by session (autogroups, sched(7)), the session's priority is
    lowered too, by its first process.
    """
    os.nice(_NICENESS)
    with contextlib.suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(_NICENESS))


@dataclass(slots=True, eq=False)
class Child:
    """A process that should always run, and its state."""

    name: str
    command: Sequence[str]
    environment: Mapping[str, str]
    log: Path
    """File to which its output is appended."""
    process: subprocess.Popen[bytes] | None = None
    failures: int = 0
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
        """Start it in a session of its own, so that signals of the terminal do not reach it."""
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
                preexec_fn=die_with_parent,  # noqa: PLW1509 - one system call
            )
        self._started_at = time.monotonic()
        if self not in _started:
            _started.append(self)

    def restart_if_ended(self) -> str | None:
        """Start it again if it died, after a pause that grows each time; returns a message."""
        self._shorten_log()
        if self.is_alive or self._stopping:
            return None
        now = time.monotonic()
        if self._not_before == 0.0:
            self.failures = 1 if now - self._started_at > _RESTED_S else self.failures + 1
            pause = min(_LONGEST_PAUSE_S, 2.0 ** (self.failures - 1))
            self._not_before = now + pause
            code = self.process.returncode if self.process else None
            return f"{self.name} ended with {code}; started again in {pause:.0f} s, see {self.log}"
        if now >= self._not_before:
            self._not_before = 0.0
            self.start()
        return None

    def request_end(self) -> None:
        """Send it SIGTERM and do not restart it."""
        self._stopping = True
        if self.process is not None:
            self._signal(signal.SIGTERM)

    def stop(self, patience_s: float = 4.0) -> None:
        """End it and its children: by a signal, then by killing them."""
        self.request_end()
        if self.process is None:
            return
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(patience_s)
        self._signal(signal.SIGKILL)  # and its remaining children
        self.process.wait()

    def kill(self) -> None:
        """End it and all that it started at once."""
        self._stopping = True
        if self.process is not None:
            self._signal(signal.SIGKILL)

    def _shorten_log(self) -> None:
        """Move a long log to a second file; the child continues to append to the first."""
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
