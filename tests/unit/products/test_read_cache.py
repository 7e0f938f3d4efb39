import os
import time

import pytest

from solmap.products.store.object_backend import ReadCache


def fetch_of(size, asked):
    def fetch(path):
        asked.append(path)
        path.write_bytes(b"x" * size)

    return fetch


def age(cache, name, seconds):
    past = time.time() - seconds
    os.utime(cache.folder / name, (past, past))


def held(cache):
    return {
        path.relative_to(cache.folder).as_posix()
        for path in cache.folder.rglob("*")
        if path.is_file()
    }


def test_a_file_is_fetched_once(tmp_path):
    cache, asked = ReadCache(tmp_path, 1000), []
    for _ in range(2):
        assert cache.path("dtm/a.tif", fetch_of(10, asked)).read_bytes() == b"x" * 10
    assert len(asked) == 1


def test_the_least_recently_used_go_first_and_the_limit_holds(tmp_path):
    cache, asked = ReadCache(tmp_path, 1000), []
    for number in range(12):
        name = f"dtm/{number}.tif"
        cache.path(name, fetch_of(100, asked))
        age(cache, name, 3600 - number)
        if number == 4:
            age(cache, "dtm/0.tif", 400)  # used again
    assert sum(path.stat().st_size for path in tmp_path.rglob("*.tif")) <= 1000
    assert "dtm/0.tif" in held(cache)
    assert {"dtm/1.tif", "dtm/2.tif"}.isdisjoint(held(cache))
    assert "dtm/11.tif" in held(cache)


def test_what_was_just_used_stays_even_over_the_limit(tmp_path):
    cache = ReadCache(tmp_path, 100)
    for number in range(5):
        cache.path(f"{number}.tif", fetch_of(100, []))
    assert len(held(cache)) == 5


def test_a_fetch_that_fails_leaves_nothing(tmp_path):
    def fail(path):
        path.write_bytes(b"half")
        raise ConnectionError

    cache = ReadCache(tmp_path, 100)
    with pytest.raises(ConnectionError):
        cache.path("a.tif", fail)
    assert held(cache) == set()
    assert cache.path("a.tif", fetch_of(3, [])).read_bytes() == b"xxx"


def test_what_a_killed_process_left_half_done_is_cleared(tmp_path):
    cache = ReadCache(tmp_path, 1000)
    for name, seconds in ((".half-old", 7200.0), (".half-young", 60.0)):
        (tmp_path / name).write_bytes(b"half")
        age(cache, name, seconds)
    cache.make_room()
    assert held(cache) == {".half-young"}
