"""Work in threads gives what work in a loop gives."""

from __future__ import annotations

import threading

import pytest

from solmap.photogrammetry.threads import THREADS, in_threads


def test_results_are_in_the_order_of_the_items():
    assert in_threads(lambda n: n * n, range(40)) == [n * n for n in range(40)]


def test_items_are_worked_on_at_the_same_time():
    together = threading.Barrier(THREADS, timeout=30)
    assert in_threads(lambda _: together.wait() >= 0, range(2 * THREADS)) == [True] * 2 * THREADS


def test_an_error_is_raised():
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda n: 1 // n, [1, 0, 1])
