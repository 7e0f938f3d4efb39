"""Work in threads gives what work in a loop gives."""

from __future__ import annotations

import threading

import pytest

from solmap.photogrammetry.threads import THREADS, in_threads, stream_in_threads


def test_results_are_in_the_order_of_the_items():
    assert in_threads(lambda n: n * n, range(40)) == [n * n for n in range(40)]


def test_items_are_worked_on_at_the_same_time():
    together = threading.Barrier(THREADS, timeout=30)
    assert in_threads(lambda _: together.wait() >= 0, range(2 * THREADS)) == [True] * 2 * THREADS


def test_an_error_is_raised():
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda n: 1 // n, [1, 0, 1])


def test_streamed_results_come_in_order_and_are_made_as_they_are_taken():
    begun = []

    def work(n: int) -> int:
        begun.append(n)
        return n * n

    results = stream_in_threads(work, range(10))
    assert begun == []
    assert [next(results) for _ in range(3)] == [0, 1, 4]
    assert len(begun) <= 3 + THREADS
    assert list(results) == [n * n for n in range(3, 10)]


def test_two_streamed_items_are_worked_on_at_once():
    together = threading.Barrier(THREADS, timeout=60)
    assert all(n >= 0 for n in stream_in_threads(lambda _: together.wait(), range(2 * THREADS)))


def test_an_error_ends_a_stream_at_its_item():
    results = stream_in_threads(lambda n: 1 // n, [1, 0, 1])
    assert next(results) == 1
    with pytest.raises(ZeroDivisionError):
        next(results)
