"""The tail of events: a bounded number of listeners, each a bounded way behind."""

import asyncio

import pytest

from gis_server.live import EventTail, TooManyListenersError
from products.catalogue import Catalogue


@pytest.fixture
def catalogue(tmp_path):
    return Catalogue.open(tmp_path)


def test_there_are_places_for_so_many_listeners_and_they_become_free_again(catalogue):
    async def crowd():
        tail = EventTail(catalogue.engine, most=1)
        async with tail.listening():
            with pytest.raises(TooManyListenersError, match="1 browsers listen already"):
                async with tail.listening():
                    pass
        async with tail.listening() as queue:
            return queue.empty()

    assert asyncio.run(crowd())


def test_a_listener_that_does_not_keep_up_is_told_so_and_holds_no_memory(catalogue):
    async def fall_behind():
        tail = EventTail(catalogue.engine)
        async with tail.listening() as queue:
            for number in range(300):
                catalogue.tell("run.changed", {"number": number})
            await asyncio.sleep(1.0)
            return [queue.get_nowait() for _ in range(queue.qsize())]

    told = asyncio.run(fall_behind())
    assert told[0] is None
    assert [event.id for event in told[1:]] == list(range(258, 301))


def test_nobody_looks_at_the_database_while_nobody_listens(catalogue):
    async def come_and_go():
        tail = EventTail(catalogue.engine)
        async with tail.listening():
            pass
        await asyncio.sleep(0.05)
        return len(asyncio.all_tasks())

    assert asyncio.run(come_and_go()) == 1  # this one
