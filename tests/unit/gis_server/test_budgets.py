"""Heavy requests take turns, are refused when there are too many, and delay no light one."""

from __future__ import annotations

import asyncio
import contextlib
import copy
import errno
import os
import signal
import threading
from collections import Counter
from dataclasses import replace
from http import HTTPStatus

import httpx
import pytest
from fastapi import Response
from prometheus_client.parser import text_string_to_metric_families

from solmap.gis_server import budgets as budgets_module
from solmap.gis_server import workers as workers_module
from solmap.gis_server.app import create_app
from solmap.gis_server.budgets import (
    FILES,
    MOST_SPOOLED,
    QUESTIONS,
    Budgets,
    HeavyRequests,
    RefusedError,
    client_of,
    kind_of,
)
from solmap.gis_server.workers import Answer, AnswerStorageError, Worker, WorkerLostError, collect
from solmap.products.model import ProductKind
from tests.unit.gis_server.conftest import ref_of

STL = "/models/s/dtm/d/terrain.stl"


class Slow:
    """An application whose heavy answers wait until they are let go."""

    def __init__(self) -> None:
        self.at_work, self.most_at_work = 0, 0
        self.go = asyncio.Event()

    async def __call__(self, scope, receive, send):
        if scope["path"] == STL:
            self.at_work += 1
            self.most_at_work = max(self.most_at_work, self.at_work)
            await self.go.wait()
            self.at_work -= 1
        await Response(scope["path"])(scope, receive, send)


def requested(app, path=STL, client="10.0.0.1"):
    transport = httpx.ASGITransport(app, client=(client, 1))
    return httpx.AsyncClient(transport=transport, base_url="http://map").get(path)


async def until(condition):
    for _ in range(400):
        if condition():
            return
        await asyncio.sleep(0.005)
    raise AssertionError("it did not come to pass")


def test_heavy_requests_queue_and_light_ones_do_not_wait_for_them():
    async def crowd():
        slow, budgets = Slow(), Budgets({})
        app = HeavyRequests(slow, budgets)
        heavy = [asyncio.create_task(requested(app, client=f"10.0.0.{k}")) for k in range(5)]
        await until(lambda: slow.at_work == 1)
        light = await asyncio.wait_for(requested(app, "/healthz"), 1.0)
        slow.go.set()
        answers = await asyncio.gather(*heavy)
        return light, answers, slow.most_at_work, budgets

    light, answers, most, budgets = asyncio.run(crowd())
    assert light.text == "/healthz"
    assert [one.status_code for one in answers] == [200] * 5
    assert most == 1
    assert budgets.answered == {"solid": 5}
    assert not budgets.lanes[FILES].places


def test_a_client_with_too_many_requests_gets_retry_after_and_others_are_served():
    async def crowd():
        slow, budgets = Slow(), Budgets({})
        app = HeavyRequests(slow, budgets)
        greedy = [asyncio.create_task(requested(app)) for _ in range(FILES.per_client + 3)]
        await until(lambda: sum(one.done() for one in greedy) == 3)
        other = asyncio.create_task(requested(app, client="10.0.0.2"))
        await until(lambda: budgets.lanes[FILES].places["10.0.0.2"])
        slow.go.set()
        return await asyncio.gather(*greedy), await other, budgets

    greedy, other, budgets = asyncio.run(crowd())
    statuses = Counter(one.status_code for one in greedy)
    assert statuses == {200: FILES.per_client, 429: 3}
    refused = next(one for one in greedy if one.status_code == 429)
    assert 1 <= int(refused.headers["retry-after"]) <= 60
    assert "4 files of yours are in progress" in refused.json()["description"]
    assert other.status_code == 200
    assert budgets.refused == {("solid", 429): 3}


def test_a_request_beyond_all_places_is_refused_with_503():
    async def crowd():
        slow, budgets = Slow(), Budgets({})
        budgets.lanes[FILES].lane = replace(FILES, places=2)
        app = HeavyRequests(slow, budgets)
        held = [asyncio.create_task(requested(app, client=f"10.0.0.{k}")) for k in range(2)]
        await until(lambda: budgets.lanes[FILES].places.total() == 2)
        refused = await requested(app, client="10.0.0.9")
        slow.go.set()
        await asyncio.gather(*held)
        return refused

    refused = asyncio.run(crowd())
    assert refused.status_code == 503
    assert "retry-after" in refused.headers


def test_a_request_that_waits_too_long_is_refused_with_503(monkeypatch):
    monkeypatch.setattr(budgets_module, "WAIT_S", 0.05)

    async def crowd():
        slow = Slow()
        app = HeavyRequests(slow, Budgets({}))
        first = asyncio.create_task(requested(app))
        await until(lambda: slow.at_work == 1)
        refused = await requested(app, client="10.0.0.2")
        slow.go.set()
        return await first, refused

    first, refused = asyncio.run(crowd())
    assert (first.status_code, refused.status_code) == (200, 503)
    assert "took more than" in refused.json()["description"]


def test_a_recently_served_client_is_refused_while_others_wait_long():
    async def crowd():
        slow, budgets = Slow(), Budgets({})
        budgets.lanes[FILES].lane = replace(FILES, busy_s=0.0)
        app = HeavyRequests(slow, budgets)
        slow.go.set()
        served = await requested(app)
        slow.go.clear()
        others = [asyncio.create_task(requested(app, client=f"10.0.1.{k}")) for k in range(2)]
        await until(lambda: budgets.lanes[FILES].ahead_s > 0)
        again, fresh = await requested(app), asyncio.create_task(requested(app, client="10.0.0.3"))
        slow.go.set()
        await asyncio.gather(*others)
        return served, again, await fresh

    served, again, fresh = asyncio.run(crowd())
    assert [one.status_code for one in (served, again, fresh)] == [200, 429, 200]


def test_a_client_that_disconnects_frees_its_place():
    async def crowd():
        slow, budgets = Slow(), Budgets({})
        app = HeavyRequests(slow, budgets)
        first = asyncio.create_task(requested(app))
        await until(lambda: slow.at_work == 1)
        left = asyncio.Event()
        scope = {"type": "http", "method": "GET", "path": STL, "client": ("10.0.0.2", 1)}

        async def receive():
            await left.wait()
            return {"type": "http.disconnect"}

        async def send(message):
            raise AssertionError(f"nobody listens to {message}")

        waiting = asyncio.create_task(app(scope, receive, send))
        await until(lambda: budgets.lanes[FILES].places["10.0.0.2"])
        left.set()
        await waiting
        places = dict(budgets.lanes[FILES].places)
        slow.go.set()
        await first
        return places, slow.most_at_work

    places, most = asyncio.run(crowd())
    assert places == {"10.0.0.1": 1}
    assert most == 1


def test_a_slow_reader_holds_a_place_and_no_turn():
    async def crowd():
        slow, budgets = Slow(), Budgets({})
        app = HeavyRequests(slow, budgets)
        slow.go.set()
        reads = asyncio.Event()

        async def receive():
            await reads.wait()
            return {"type": "http.disconnect"}

        async def send(message):
            if message["type"] == "http.response.body":
                await reads.wait()

        scope = {"type": "http", "method": "GET", "path": STL, "client": ("10.0.0.2", 1)}
        reader = asyncio.create_task(app({**scope, "headers": []}, receive, send))
        await until(lambda: budgets.lanes[FILES].places["10.0.0.2"])
        answer = await asyncio.wait_for(requested(app), 1.0)
        held = dict(budgets.lanes[FILES].places)
        reads.set()
        await reader
        return answer, held

    answer, held = asyncio.run(crowd())
    assert answer.status_code == 200
    assert held == {"10.0.0.2": 1}


@pytest.mark.parametrize(
    ("host", "client"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("fe80::1%eth0", "fe80::/64"),
        ("testclient", "testclient"),
        (None, ""),
    ],
)
def test_a_client_is_an_address_or_a_network_of_64_bits(host, client):
    assert client_of({"client": host and (host, 1)}) == client


def test_heavy_requests_are_recognised_by_their_url(world):
    """The description of the API has a word for it: each of them may be answered 429."""
    document = create_app(world.root).openapi()
    heavy = {path: found[0] for path in document["paths"] if (found := kind_of(path))}
    kinds = {kind for kind, _, _ in budgets_module.KINDS}
    assert set(heavy.values()) == kinds
    assert "/healthz" not in heavy
    assert "/api/missions/{mission}/edits/ties" not in heavy
    assert "/tiles/{scope}/{kind}/{digest}/{z}/{x}/{y}.png" not in heavy
    for path in heavy:
        for operation in document["paths"][path].values():
            assert "429" in operation["responses"], path


def test_metrics_give_the_limits_and_their_use(client, world):
    ref = ref_of(world, ProductKind.DTM)
    client.get(f"/models/{ref.scope.name}/dtm/{ref.digest}/terrain.stl")
    families = text_string_to_metric_families(client.get("/metrics").text)
    figures = {
        (one.name, *one.labels.values()): one.value
        for family in families
        for one in family.samples
        if "heavy" in one.name
    }
    assert figures["solmap_heavy_limit", "files", "client"] == FILES.per_client
    assert figures["solmap_heavy_limit", "questions", "all"] == QUESTIONS.places
    assert figures["solmap_heavy_spooled_bytes", "now"] == 0
    assert figures["solmap_heavy_spooled_bytes", "limit"] == MOST_SPOOLED
    assert figures["solmap_heavy_requests_now", "files", "waiting"] == 0
    assert figures["solmap_heavy_answered_total", "solid"] >= 1


@pytest.fixture(scope="module")
def worker(world, tmp_path_factory):
    """A worker process of the small world."""
    found = Worker((world.root,), 300)
    found.start(tmp_path_factory.mktemp("answers"))
    yield found
    found.stop()
    found.launcher.close()


def scope_of(path):
    return {
        "type": "http",
        "method": "GET",
        "path": path,
        "query_string": b"",
        "headers": [(b"host", b"map")],
        "client": ("10.0.0.1", 1),
        "scheme": "http",
        "server": ("map", 80),
        "root_path": "",
        "http_version": "1.1",
        "app": object(),
    }


async def body_of(app_or_worker, path):
    if isinstance(app_or_worker, Worker):
        answer = await app_or_worker.answer(scope_of(path), b"", 120.0)
    else:
        answer = await collect(app_or_worker, scope_of(path), b"", None)
    body = answer.body if isinstance(answer.body, bytes) else answer.body.read_bytes()
    return answer, body


def test_a_worker_gives_the_answers_of_the_server(world, worker):
    ref = ref_of(world, ProductKind.DTM)
    path = f"/models/{ref.scope.name}/dtm/{ref.digest}/terrain.stl"
    here = asyncio.run(body_of(create_app(world.root), path))
    there = asyncio.run(body_of(worker, path))
    assert there[0].status == here[0].status == 200
    assert there[0].route == "/models/{scope}/dtm/{digest}/terrain.stl"
    assert there[1] == here[1]
    assert dict(there[0].headers)[b"content-type"] == b"model/stl"
    assert worker.memory_bytes > 50_000_000


def large(app, folder):
    return asyncio.run(collect(app, scope_of(STL), b"", folder))


def test_an_answer_that_is_too_large_is_refused_and_leaves_no_file(tmp_path, monkeypatch):
    whole = Response(bytes(3 << 20))
    answer = large(whole, tmp_path)
    assert answer.file_bytes == 3 << 20
    answer.remove()
    monkeypatch.setattr(workers_module, "LARGEST", 2 << 20)
    with pytest.raises(AnswerStorageError, match="more than 2 MiB") as refused:
        large(whole, tmp_path)
    assert refused.value.status == 422
    assert copy.copy(refused.value).what == refused.value.what  # as the pipe copies it
    assert not list(tmp_path.iterdir())


def test_a_too_large_answer_is_refused_with_advice_to_request_less():
    class Refusing:
        async def answer(self, *_request):
            raise AnswerStorageError(HTTPStatus.UNPROCESSABLE_ENTITY, "request less at once")

    app = HeavyRequests(Slow(), budgets := Budgets({FILES: Refusing()}))
    refused = asyncio.run(requested(app))
    assert refused.status_code == 422
    assert "request less" in refused.json()["description"]
    assert "retry-after" not in refused.headers
    assert not budgets.lanes[FILES].places


def test_an_answer_that_does_not_fit_the_disk_is_not_sent_in_part(tmp_path, monkeypatch):
    class Full:
        name = str(tmp_path / "answer")

        def write(self, _part):
            raise OSError(errno.ENOSPC, "No space left on device")

        def close(self):
            raise OSError(errno.ENOSPC, "No space left on device")

    def made(**_given):
        (tmp_path / "answer").touch()
        return Full()

    monkeypatch.setattr(workers_module.tempfile, "NamedTemporaryFile", made)
    with pytest.raises(AnswerStorageError, match="No space left") as refused:
        large(Response(bytes(3 << 20)), tmp_path)
    assert refused.value.status == 503
    assert not list(tmp_path.iterdir())


def test_answer_files_have_a_total_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(budgets_module, "MOST_SPOOLED", 200)
    budgets = Budgets({})

    def answer(size):
        file = tmp_path / f"{size}"
        file.write_bytes(bytes(size))
        return Answer(200, [], file, None)

    with budgets.file_of("a", answer(80)):
        with pytest.raises(RefusedError) as of_one, budgets.file_of("a", answer(21)):
            pass
        with budgets.file_of("b", answer(81)):
            with pytest.raises(RefusedError) as of_all, budgets.file_of("c", answer(40)):
                pass
            with budgets.file_of("c", Answer(200, [], b"small", None)):
                assert budgets.spooled.total() == 161
    assert (of_one.value.status, of_all.value.status) == (429, 503)
    assert of_all.value.retry_s > 1
    assert not budgets.spooled
    assert {file.name for file in tmp_path.iterdir()} == {"80", "81"}  # refused ones are removed


@pytest.mark.parametrize("is_file", [True, False])
def test_a_too_slow_reader_is_disconnected(is_file, tmp_path, monkeypatch):
    monkeypatch.setattr(workers_module, "STALL_S", 0.2)
    monkeypatch.setattr(workers_module, "LEAST_BYTES_S", 1e8)
    file = tmp_path / "answer"
    file.write_bytes(bytes(20 << 20))
    sent = []

    async def send(message):
        sent.append(message)
        await asyncio.sleep(0.15 if is_file else 60.0)  # a megabyte in time, the whole not

    answer = Answer(200, [], file if is_file else b"small", None)
    asyncio.run(asyncio.wait_for(answer.send(send), 5.0))
    assert sum(len(one.get("body", b"")) for one in sent) < 20 << 20
    assert file.exists() != is_file


@pytest.mark.slow
def test_a_worker_that_was_killed_or_took_too_long_is_replaced(worker):
    half = worker._folder / "half"
    half.touch()
    worker.wait(20.0)
    os.kill(
        worker.launcher.pid(worker._number), signal.SIGKILL
    )  # what the system does that lacks memory
    worker._connection.poll(5.0)
    assert asyncio.run(body_of(worker, "/api/missions"))[0].status == 200
    with pytest.raises(TimeoutError):
        asyncio.run(worker.answer(scope_of("/api/missions"), b"", 0.0))
    assert not half.exists()
    assert asyncio.run(body_of(worker, "/api/missions"))[0].status == 200


@pytest.mark.slow
def test_workers_end_with_their_launcher_and_another_one_is_started(worker):
    assert asyncio.run(body_of(worker, "/api/missions"))[0].status == 200
    worker.wait(20.0)
    pid = worker.launcher.pid(worker._number)
    assert pid
    os.kill(worker.launcher._process.pid, signal.SIGKILL)
    assert worker._connection.poll(5.0)
    assert asyncio.run(body_of(worker, "/api/missions"))[0].status == 200
    worker.wait(20.0)
    assert worker.launcher.pid(worker._number) not in {None, pid}


def test_processes_end_and_start_outside_the_event_loop(worker, monkeypatch):
    """To free a worker's memory the kernel takes some tenths of a second."""
    threads, stop = [], Worker.stop

    def note(self):
        threads.append(threading.current_thread())
        stop(self)

    monkeypatch.setattr(Worker, "stop", note)
    with pytest.raises(TimeoutError):
        asyncio.run(worker.answer(scope_of("/api/missions"), b"", 0.0))
    assert asyncio.run(body_of(worker, "/api/missions"))[0].status == 200
    assert len(threads) == 2  # when the request was given up, and before the next start
    assert threading.main_thread() not in threads


def test_a_request_that_lacked_memory_beside_others_is_repeated_in_a_new_process(
    worker, monkeypatch
):
    asyncio.run(body_of(worker, "/api/missions"))
    processes, exchange = [], Worker._exchange

    async def lack_memory_once(self, request, body):
        processes.append(self._number)
        answer, is_full, _ = await exchange(self, request, body)
        return answer, is_full, len(processes) == 1

    monkeypatch.setattr(Worker, "_exchange", lack_memory_once)
    assert asyncio.run(body_of(worker, "/api/missions"))[0].status == 200
    assert len(set(processes)) == 2


@pytest.mark.slow
def test_a_process_that_lacks_memory_reports_it(world, tmp_path):
    ref = ref_of(world, ProductKind.DTM)
    path = f"/models/{ref.scope.name}/dtm/{ref.digest}/terrain.stl"
    worker = Worker((world.root,), 8)
    worker.start(tmp_path)
    try:
        reported = asyncio.run(worker._exchange(scope_of(path), b""))
        assert reported[0].status == 422
        assert reported[2]
    finally:
        worker.stop()
        worker.launcher.close()


@pytest.mark.slow
def test_a_request_that_takes_too_much_memory_fails_alone(world, tmp_path):
    ref = ref_of(world, ProductKind.DTM)
    path = f"/models/{ref.scope.name}/dtm/{ref.digest}/terrain.stl"
    worker = Worker((world.root,), 8)
    worker.start(tmp_path)
    try:
        with contextlib.suppress(WorkerLostError):  # libraries of C may end the process
            assert asyncio.run(body_of(worker, path))[0].status == 422
        assert asyncio.run(body_of(worker, "/api/missions"))[0].status == 200
    finally:
        worker.stop()
        worker.launcher.close()
