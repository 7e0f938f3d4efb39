"""Work on two items at a time: NumPy and OpenCV mostly compute without the interpreter's lock."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

THREADS = 2
"""As many as stages run at a time; each view that is worked on takes some 50 MB."""
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1"}
"""Environment in which NumPy and OpenCV use one thread for a call: where two calls run at a time,
further threads only wait for each other."""
Item = TypeVar("Item")
Result = TypeVar("Result")


def use_one_thread_a_call() -> None:
    """Set `ONE_THREAD`, unless the user has set it; call before NumPy is imported."""
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)


def in_threads(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Results in the order of the items; the first error is raised."""
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(work, items))


def stream_in_threads(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """The results in the same order, made as they are taken, `THREADS` at a time."""
    with ThreadPoolExecutor(THREADS) as pool:
        waiting = deque[Future[Result]]()
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) == THREADS:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
