"""Prefect's server as solmap starts it gives nothing to clients without its password."""

import json
import os
import re
import sqlite3
import time
from collections import Counter
from contextlib import closing
from pathlib import Path

import httpx
import psutil
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from solmap.flows.runtime.engine import (
    address,
    await_engine,
    engine_child,
    free_port,
    password_file,
    prepare_engine,
)

WRITES = {"post", "put", "patch", "delete"}
OPEN = {"/api/health", "/api/ready"}
SCRIPT = [{"prefect.deployments.steps.run_shell_script": {"script": "touch MARK"}}]


class Engine:
    """A server with a deployment and an old run in it."""

    def __init__(self, store: Path) -> None:
        self.store = store
        before = dict(os.environ)
        try:
            for name in [name for name in os.environ if name.startswith("PREFECT_")]:
                del os.environ[name]
            prepare_engine(store)
            os.environ["PREFECT_SERVER_SERVICES_DB_VACUUM_LOOP_SECONDS"] = "5"
            self.port = free_port()
            self.child = engine_child(store, self.port, has_pages=True)
            self.child.start()
        finally:
            os.environ.clear()
            os.environ.update(before)
        await_engine(self.child, self.port)
        user, _, password = password_file(store).read_text().partition(":")
        self.friend = httpx.Client(base_url=self.url, auth=(user, password), timeout=30)
        self.anonymous = httpx.Client(base_url=self.url, timeout=30)

    @property
    def url(self) -> str:
        return address(self.port)

    def request(self, path: str, body: dict) -> dict:
        for _ in range(20):
            answer = self.friend.post(f"/api{path}", json=body)
            if answer.status_code != 503:  # a busy database: Prefect's own client retries too
                break
            time.sleep(0.5)
        return answer.raise_for_status().json()

    def rows(self) -> Counter[str]:
        database = self.store / "prefect" / "prefect.db"
        with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as file:
            names = file.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
            count = "SELECT count(*) FROM "
            return Counter({n: file.execute(f'{count}"{n}"').fetchone()[0] for (n,) in names})


@pytest.fixture(scope="module")
def engine(tmp_path_factory):
    started = Engine(tmp_path_factory.mktemp("closed") / "store")
    try:
        yield started
    finally:
        started.friend.close()
        started.anonymous.close()
        started.child.stop()


@pytest.fixture(scope="module")
def deployment(engine):
    flow = engine.request("/flows/", {"name": "harmless"})
    body = {"name": "served", "flow_id": flow["id"], "entrypoint": "harmless.flow"}
    return engine.request("/deployments/", body)


def test_the_password_file_is_readable_by_its_owner_only(engine):
    file = password_file(engine.store)
    assert file.stat().st_mode & 0o777 == 0o600
    secret = file.read_text().partition(":")[2]
    assert len(secret) >= 40
    assert secret not in " ".join(psutil.Process(engine.child.process.pid).cmdline())
    assert secret not in engine.child.log.read_text()
    others = [path for path in engine.store.rglob("*") if path.is_file() and path != file]
    assert not [path for path in others if secret.encode() in path.read_bytes()]


def test_the_engine_listens_on_this_machine_only(engine):
    found = psutil.Process(engine.child.process.pid).net_connections()
    listening = {one.laddr.ip for one in found if one.status == psutil.CONN_LISTEN}
    assert listening == {"127.0.0.1"}


def test_an_unauthenticated_client_neither_changes_nor_starts_a_deployment(
    engine, deployment, tmp_path
):
    script = json.loads(json.dumps(SCRIPT).replace("MARK", str(tmp_path / "mark")))
    one, anonymous = f"/api/deployments/{deployment['id']}", engine.anonymous
    answers = [
        anonymous.post("/api/deployments/filter", json={}),
        anonymous.patch(one, json={"pull_steps": script}),
        anonymous.post(f"{one}/create_flow_run", json={}),
        anonymous.get(f"/api/flow_runs/{deployment['id']}"),
    ]
    assert [answer.status_code for answer in answers] == [401] * 4
    kept = engine.friend.get(one).json()
    assert kept["pull_steps"] == deployment["pull_steps"]


def test_no_route_answers_an_unauthenticated_client(engine, deployment):
    routes = engine.anonymous.get("/openapi.json").json()["paths"]
    before = engine.rows()
    for path, methods in routes.items():
        url = re.sub(r"\{[^}]*\}", deployment["id"], f"/api{path}")
        for method in methods:
            answer = engine.anonymous.request(method, url, json={} if method in WRITES else None)
            if method == "get" and url in OPEN:
                assert len(answer.content) < 40
                continue
            assert answer.status_code == 401, (method, url, answer.text[:200])
    assert len(routes) > 100
    after = engine.rows()
    own = {"configuration", "worker", "events", "event_resources"}  # its services write these
    assert {n: after[n] for n in after if n not in own} == {
        n: before[n] for n in before if n not in own
    }


@pytest.mark.parametrize(
    "path", ["events/in", "events/out", "logs/out", "task_runs/subscriptions/scheduled"]
)
def test_no_socket_answers_an_unauthenticated_client(engine, path):
    url = f"ws://127.0.0.1:{engine.port}/api/{path}"
    for protocols, first in ((None, None), (["prefect"], '{"type": "auth", "token": "guess"}')):
        with pytest.raises((ConnectionClosed, InvalidStatus)):
            _listen(url, protocols, first)


def _listen(url, protocols, first):
    with connect(url, subprotocols=protocols, open_timeout=10) as socket:
        if first:
            socket.send(first)
        return socket.recv(timeout=10)


def test_pages_of_other_sites_are_not_answered(engine):
    requested = {"Origin": "https://evil.example", "Access-Control-Request-Method": "POST"}
    answer = engine.anonymous.options("/api/flows/filter", headers=requested)
    assert "access-control-allow-origin" not in answer.headers
    own = engine.anonymous.options("/api/flows/filter", headers={**requested, "Origin": engine.url})
    assert own.headers["access-control-allow-origin"] == engine.url


def test_old_runs_are_removed_and_recent_ones_kept(engine, deployment):
    """Their end is dated back; the server's own service does the rest."""
    start = f"/deployments/{deployment['id']}/create_flow_run"
    old, young = (engine.request(start, {})["id"] for _ in range(2))
    for run in (old, young):
        for state in ("RUNNING", "COMPLETED"):
            body = {"state": {"type": state}, "force": True}
            engine.request(f"/flow_runs/{run}/set_state", body)
    with closing(sqlite3.connect(engine.store / "prefect" / "prefect.db", timeout=30)) as file:
        date_back = "UPDATE flow_run SET end_time = '2020' || substr(end_time, 5) WHERE id = ?"
        file.execute(date_back, (old,))
        file.commit()
    end = time.monotonic() + 60
    while engine.friend.get(f"/api/flow_runs/{old}").status_code != 404:
        assert time.monotonic() < end, "an old run is still there"
        time.sleep(0.5)
    assert engine.friend.get(f"/api/flow_runs/{young}").status_code == 200
