"""Progress of a run, for listeners: a progress bar, a log, or none.

Flows report steps; the command line listens and shows them. Prefect's run page shows
the same tasks by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Step:
    """`done` of `total` parts of a stage are finished."""

    stage: str
    done: int
    total: int


Listener = Callable[[Step], None]
_listeners: list[Listener] = []


def report(stage: str, done: int, total: int) -> None:
    """Report the progress of a stage to every listener."""
    for listener in _listeners:
        listener(Step(stage, done, total))


@contextmanager
def listen(listener: Listener) -> Iterator[None]:
    """Call `listener` with every step inside the block."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)
