"""The tail of events: a bounded number of listeners, each a bounded way behind."""

import asyncio

import pytest
import sqlalchemy as sa

from solmap.gis_server.live import EventTail, TooManyListenersError
from solmap.products.catalogue.catalogue import Catalogue


@pytest.fixture
def catalogue(tmp_path, catalogue_url):
    return Catalogue.open(tmp_path, catalogue_url)


def test_listener_places_are_limited_and_freed(catalogue):
    async def crowd():
        tail = EventTail(catalogue.engine, most=1)
        async with tail.listening():
            with pytest.raises(TooManyListenersError, match="1 browsers listen already"):
                async with tail.listening():
                    pass
        async with tail.listening() as queue:
            return queue.empty()

    assert asyncio.run(crowd())


def test_a_listener_that_lags_gets_a_notice_and_holds_bounded_memory(catalogue):
    async def fall_behind():
        tail = EventTail(catalogue.engine)
        async with tail.listening() as queue:
            for number in range(300):
                catalogue.append_event("run.changed", {"number": number})
            await asyncio.sleep(1.0)
            return [queue.get_nowait() for _ in range(queue.qsize())]

    reported = asyncio.run(fall_behind())
    assert reported[0] is None
    assert [event.id for event in reported[1:]] == list(range(258, 301))


def test_the_database_is_not_polled_without_listeners(catalogue):
    looks = []
    sa.event.listen(
        catalogue.engine, "before_cursor_execute", lambda *reported: looks.append(reported[2])
    )

    async def come_and_go():
        tail = EventTail(catalogue.engine)
        async with tail.listening():
            await asyncio.sleep(0.6)
        await asyncio.sleep(0.4)
        before = len(looks)
        await asyncio.sleep(0.8)
        return before, len(looks)

    before, after = asyncio.run(come_and_go())
    assert before >= 3
    assert after == before


def test_a_listener_after_many_others_still_receives_events(catalogue):
    async def crowd():
        tail = EventTail(catalogue.engine)
        for _ in range(60):  # more than the pool has connections
            async with tail.listening():
                await asyncio.sleep(0.001)
        async with tail.listening() as queue:
            catalogue.append_event("run.changed", {"number": 7})
            return await asyncio.wait_for(queue.get(), 5.0)

    assert asyncio.run(crowd()).document == {"number": 7}


def test_events_without_listeners_are_not_sent_later_as_new(catalogue):
    async def late():
        tail = EventTail(catalogue.engine)
        async with tail.listening():
            pass
        catalogue.append_event("run.changed", {"number": 1})
        async with tail.listening() as queue:
            catalogue.append_event("run.changed", {"number": 2})
            return await asyncio.wait_for(queue.get(), 5.0)

    assert asyncio.run(late()).document == {"number": 2}


def test_the_callback_runs_before_an_event_is_sent(catalogue):
    done = []

    async def hear():
        tail = EventTail(catalogue.engine, before=done.append)
        async with tail.listening() as queue:
            catalogue.append_event("run.changed", {"number": 1})
            reported = await asyncio.wait_for(queue.get(), 30)
            return reported, list(done)

    reported, before = asyncio.run(hear())
    assert before == [[reported]]
