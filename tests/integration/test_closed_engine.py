"""Prefect's server as solmap starts it: nothing without its password; commands reuse it."""

import json
import os
import re
import signal
import sqlite3
import subprocess
import sys
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
    port_file,
    prepare_engine,
    running_engine,
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
            os.environ["PREFECT_SERVER_SERVICES_SCHEDULER_LOOP_SECONDS"] = "2"
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

    @property
    def client(self) -> dict[str, str]:
        """Environment of a process that uses the server."""
        secret = password_file(self.store).read_text()
        return {"PREFECT_API_URL": f"{self.url}/api", "PREFECT_API_AUTH_STRING": secret}

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
    end = time.monotonic() + 300
    while engine.friend.get(f"/api/flow_runs/{old}").status_code != 404:
        assert time.monotonic() < end, "an old run is still there"
        time.sleep(0.5)
    assert engine.friend.get(f"/api/flow_runs/{young}").status_code == 200


@pytest.fixture
def offered(engine):
    """The server as `solmap up` offers it to commands on its store."""
    port_file(engine.store).write_text(str(engine.port))
    yield engine
    port_file(engine.store).unlink()


def test_only_the_server_of_the_same_store_is_used(offered, tmp_path):
    assert running_engine(offered.store) == offered.port
    other = tmp_path / "other"
    assert running_engine(other) is None
    password_file(other)
    port_file(other).write_text(str(offered.port))
    assert running_engine(other) is None
    port_file(offered.store).write_text(str(free_port()))
    assert running_engine(offered.store) is None


def environment() -> dict[str, str]:
    """What a command gets: nothing about a server."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}


COMMAND = """
import os
import sys
from pathlib import Path
from solmap.flows.cli.processing import engine_of

with engine_of(Path(sys.argv[1]), "prefect.main"):
    from prefect import flow
    flow(lambda: None, name="short")()
    print(os.environ["PREFECT_API_URL"])
"""


def test_a_command_runs_on_the_server_that_is_there(offered):
    ran = subprocess.run(
        (sys.executable, "-c", COMMAND, offered.store),
        env=environment(),
        check=True,
        timeout=120,
        capture_output=True,
        text=True,
    )
    assert ran.stdout.splitlines()[-1] == f"{offered.url}/api"
    found = offered.request("/flow_runs/filter", {"flows": {"name": {"any_": ["short"]}}})
    assert [run["tags"] for run in found] == [["by-command"]]
    assert found[0]["state"]["type"] == "COMPLETED"


def test_a_dead_scheduler_does_not_end_runs_of_commands(offered):
    from prefect import settings  # noqa: PLC0415 - after the engine's settings
    from prefect.settings import temporary_settings  # noqa: PLC0415

    from solmap.flows.service.submission import mark_crashed_runs  # noqa: PLC0415

    flow = offered.request("/flows/", {"name": "harmless"})["id"]
    running = {"flow_id": flow, "state": {"type": "RUNNING"}}
    own = offered.request("/flow_runs/", {**running, "tags": ["by-command"]})["id"]
    scheduled = offered.request("/flow_runs/", running)["id"]
    for of_commands, expected in ((False, ["RUNNING", "CRASHED"]), (True, ["CRASHED"] * 2)):
        with temporary_settings({getattr(settings, k): v for k, v in offered.client.items()}):
            mark_crashed_runs(of_commands=of_commands)
        states = [
            offered.friend.get(f"/api/flow_runs/{run}").json()["state"]["type"]
            for run in (own, scheduled)
        ]
        assert states == expected


SCHEDULED = """
import sys
from pathlib import Path
from prefect import flow, serve

@flow
def leave_a_mark(marker: str) -> None:
    Path(marker).touch()

if __name__ == "__main__":
    serve(leave_a_mark.to_deployment("marks", interval=5, parameters={"marker": sys.argv[1]}))
"""


@pytest.mark.timeout(700)
def test_a_scheduled_deployment_starts_at_its_time(engine, tmp_path):
    """Prefect and its dependencies install in combinations whose scheduler runs and never fires.

    The pins in pyproject.toml avoid the two known ones; this test notices the next.
    """
    script, marker = tmp_path / "deployment.py", tmp_path / "marker"
    script.write_text(SCHEDULED)
    own = {"PREFECT_HOME": str(tmp_path / "prefect"), "PREFECT_RUNNER_POLL_FREQUENCY": "2"}
    with (tmp_path / "log").open("w") as log:
        served = subprocess.Popen(
            (sys.executable, script, marker),
            env={**environment(), **engine.client, **own},
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        try:
            end = time.monotonic() + 300
            while not marker.exists():
                assert served.poll() is None, (tmp_path / "log").read_text()
                assert time.monotonic() < end, (tmp_path / "log").read_text()
                time.sleep(0.2)
        finally:
            os.killpg(served.pid, signal.SIGKILL)  # nothing of it is needed: no wait for its runs
            served.wait()
