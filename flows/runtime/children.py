"""Processes that belong to another: they are watched, restarted, and never outlive it.

The kernel tells a child when its parent dies (`PR_SET_PDEATHSIG`), so that even `kill -9` of the
parent leaves no orphan behind. On systems without it children end when they are stopped in order.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_RESTED_S = 60.0
"""A child that ran so long has started well; how often it died before is forgotten."""
_LONGEST_PAUSE_S = 30.0


def die_with_parent() -> None:
    """Ask the kernel to end this process when the one that started it ends."""
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    except (AttributeError, OSError):
        return  # no Linux: the parent's orderly stop is all there is


@dataclass(slots=True)
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
        """Whether it was asked to end and is not to be started again."""
        return self._stopping

    def start(self) -> None:
        """Start it; it hears no signal of the terminal, only those that it is sent."""
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(  # noqa: S603 - our own command line
                list(self.command),
                env={**os.environ, **self.environment},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=die_with_parent,  # noqa: PLW1509 - asks the kernel one thing
            )
        self._started_at = time.monotonic()

    def revive(self) -> str | None:
        """Start it again if it died, after a pause that grows with every death; what is to say."""
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

    def stop(self, patience_s: float = 15.0) -> None:
        """End it and all that it started: asked first, killed when it does not listen."""
        self._stopping = True
        if self.process is None:
            return
        self._signal(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(patience_s)
        self._signal(signal.SIGKILL)  # and whatever of its own it left behind
        self.process.wait()

    def _signal(self, number: int) -> None:
        try:
            os.killpg(self.process.pid, number)  # type: ignore[union-attr]
        except ProcessLookupError:
            return
