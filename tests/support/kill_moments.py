"""Moments at which to kill: at random, or when the kernel reports a step of storing a product.

inotify reports a new draft, a file that is renamed out of its draft, and a write to the catalogue;
a kill some milliseconds later lands between the two renames of a product, inside of
a transaction, or between the transaction and what follows it. The code that is killed is not
changed for it.
"""

from __future__ import annotations

import ctypes
import os
import select
import struct
import time
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np

IN_MODIFY, IN_MOVED_FROM, IN_CREATE = 0x02, 0x40, 0x100
_HEADER = struct.Struct("iIII")


class Step(StrEnum):
    """What a kill follows."""

    TIME = "any time"
    DRAFT = "a draft begun"
    RENAME = "a file renamed into place"
    WRITE = "a write to the catalogue"


@dataclass(frozen=True)
class Moment:
    """When to kill."""

    step: Step
    after: int
    """So many of these steps."""
    delay_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, longest_s: float, early: float) -> Moment:
        """A random moment of a run that takes up to `longest_s`: a share is early, the rest any."""
        step = Step(rng.choice(list(Step), p=[0.25, 0.1, 0.3, 0.35]))
        soon, most = (0.08, 150) if step is Step.WRITE else (0.15, 60)
        after = int(rng.geometric(soon) if rng.random() < early else rng.integers(1, most))
        delays = {Step.TIME: longest_s, Step.DRAFT: 0.3, Step.RENAME: 0.002, Step.WRITE: 0.02}
        return cls(step, after, float(rng.uniform(0.0, delays[step])))


@dataclass
class Watch:
    """Counts the steps of all processes that write to a store."""

    root: Path
    counts: dict[Step, int] = field(default_factory=dict)
    _folders: dict[int, Path] = field(default_factory=dict)

    def __enter__(self) -> Watch:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._file = self._libc.inotify_init1(os.O_NONBLOCK)
        self._add(self.root, IN_MODIFY)
        self._add(self.root / "drafts", IN_CREATE)
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._file)

    def wait(self, seconds: float) -> None:
        """Count what happens in the next moment."""
        if not select.select([self._file], [], [], seconds)[0]:
            return
        data = os.read(self._file, 1 << 16)
        at = 0
        while at < len(data):
            number, mask, _, length = _HEADER.unpack_from(data, at)
            at += _HEADER.size
            name = data[at : at + length].rstrip(b"\0").decode()
            at += length
            self._take(number, mask, name)

    def reaches(self, moment: Moment, alive: object, limit_s: float) -> bool:
        """Wait for a moment; whether it came before the process ended."""
        end = time.monotonic() + (moment.delay_s if moment.step is Step.TIME else limit_s)
        while time.monotonic() < end and alive():  # type: ignore[operator]
            self.wait(min(0.05, max(0.0, end - time.monotonic())))
            if self.counts.get(moment.step, 0) >= moment.after:
                time.sleep(moment.delay_s)
                return True
        return bool(alive())  # type: ignore[operator]

    def _take(self, number: int, mask: int, name: str) -> None:
        folder = self._folders.get(number)
        if folder == self.root:
            step = Step.WRITE if name.startswith("catalogue.sqlite") else None
        elif folder == self.root / "drafts":
            step = Step.DRAFT
            self._add(folder / name, IN_MOVED_FROM)
        else:
            step = Step.RENAME if mask & IN_MOVED_FROM else None
        if step is not None:
            self.counts[step] = self.counts.get(step, 0) + 1

    def _add(self, folder: Path, mask: int) -> None:
        number = self._libc.inotify_add_watch(self._file, os.fsencode(folder), mask)
        if number >= 0:  # a draft may be gone already
            self._folders[number] = folder
