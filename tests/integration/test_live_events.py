"""Live updates over a real connection: two browsers, another process that publishes."""

from __future__ import annotations

import queue
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from solmap.products.catalogue.catalogue import Catalogue
from tests.support.live_server import listening, serving

_REPORT = """
import sys, time
from pathlib import Path
from solmap.products.catalogue.catalogue import Catalogue
catalogue = Catalogue.open(Path(sys.argv[1]))
for number in range(int(sys.argv[2])):
    catalogue.append_event("run.changed", {"number": number, "sent": time.time()})
    time.sleep(0.1)
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    Catalogue.open(tmp_path)
    return tmp_path


def report(root: Path, count: int) -> None:
    """Append events, in this process."""
    catalogue = Catalogue.open(root)
    for number in range(count):
        catalogue.append_event("run.changed", {"number": number})


def numbers(heard: queue.Queue, count: int) -> list[int]:
    return [heard.get(timeout=60)[2]["number"] for _ in range(count)]


def test_two_listeners_receive_every_event_of_another_process_in_order(root):
    with (
        serving(root) as server,
        listening(f"{server}/api/events") as first,
        listening(f"{server}/api/events") as second,
    ):
        assert first.get(timeout=10)[0] == second.get(timeout=10)[0] == "hello"
        subprocess.run([sys.executable, "-c", _REPORT, str(root), "20"], check=True)
        delays = []
        for heard in (first, second):
            events = [heard.get(timeout=60) for _ in range(20)]
            assert [event[2]["number"] for event in events] == list(range(20))
            assert [event[1] for event in events] == list(range(1, 21))
            delays += [arrived - data["sent"] for _, _, data, arrived in events]
    # a look is due every 0.25 s; the rest is room for a busy machine
    assert np.median(delays) < 1.0, f"median {np.median(delays):.3f} s"
    print(f"delay median {np.median(delays):.3f} s, worst {max(delays):.3f} s")  # noqa: T201


def test_a_client_that_reconnects_gets_the_missed_events(root):
    with serving(root) as server:
        report(root, 6)
        with listening(f"{server}/api/events", **{"Last-Event-ID": "2"}) as heard:
            assert heard.get(timeout=60)[:2] == ("hello", 2)
            assert numbers(heard, 4) == [2, 3, 4, 5]
            report(root, 1)
            assert numbers(heard, 1) == [0]
        with listening(f"{server}/api/events?since=6") as heard:
            assert numbers_after_hello(heard) == [0]


def numbers_after_hello(heard: queue.Queue) -> list[int]:
    assert heard.get(timeout=60)[0] == "hello"
    return numbers(heard, 1)


def test_events_of_other_missions_are_left_out_if_one_is_named(root):
    catalogue = Catalogue.open(root)
    with serving(root) as server, listening(f"{server}/api/events?mission=MER2") as heard:
        heard.get(timeout=60)
        for mission in ("MER1", "MER2"):
            catalogue.append_event("layers.published", {"mission": mission, "layers": []})
        catalogue.append_event("run.changed", {"id": "a"})  # of no mission
        reported = [heard.get(timeout=60) for _ in range(2)]
    assert [event[0] for event in reported] == ["layers.published", "run.changed"]
    assert reported[0][2]["mission"] == "MER2"


def test_a_client_that_missed_removed_events_is_advised_to_reload(root):
    catalogue = Catalogue.open(root)
    from solmap.products.catalogue.events import EVENTS  # noqa: PLC0415

    for _ in range(5):
        catalogue.append_event("run.changed", {})
    with catalogue.engine.begin() as connection:
        connection.execute(EVENTS.delete().where(EVENTS.c.id < 4))
    address = "/api/events?since=1"
    with serving(root) as server, listening(f"{server}{address}") as heard:
        assert [heard.get(timeout=60)[:2] for _ in range(2)] == [("hello", 5), ("reload", 5)]
