"""`solmap up`: the real engine, scheduler, map and inbox on one machine."""

import base64
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import psutil
import pytest

from solmap.flows.runtime.engine import free_port

PATIENCE_S = 180.0
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def until(holds, what: str, seconds: float = PATIENCE_S):
    end = time.monotonic() + seconds
    while not (answer := holds()):
        assert time.monotonic() < end, f"{what} within {seconds:.0f} s"
        time.sleep(0.3)
    return answer


def answer(url: str, body: dict | None = None, password: str = "", method: str | None = None):
    data = None if body is None else json.dumps(body).encode()
    token = base64.b64encode(password.encode()).decode()
    headers = {"content-type": "application/json"}
    headers |= {"authorization": f"Basic {token}"} if password else {}
    request = urllib.request.Request(url, data, headers, method=method)
    try:
        with urllib.request.urlopen(request, timeout=30) as response:
            if response.headers.get_content_type() == "text/event-stream":
                return None  # it never ends
            return json.loads(response.read() or b"null")
    except (urllib.error.URLError, OSError, ValueError):
        return None


class Up:
    """`solmap up` on a store of its own."""

    def __init__(self, root: Path) -> None:
        self.root, self.inbox = root, root / "inbox"
        engine, self.port = free_port(), free_port()
        self.map = f"http://127.0.0.1:{self.port}"
        self.engine = f"http://127.0.0.1:{engine}/api"
        self.environment = {**os.environ, "SOLMAP_ENGINE_PORT": str(engine)}
        self.environment.pop("PREFECT_API_URL", None)
        self.environment.pop("PREFECT_HOME", None)
        self.environment.pop("PREFECT_API_AUTH_STRING", None)
        self.environment["PREFECT_RUNNER_POLL_FREQUENCY"] = "2"
        self.environment["SOLMAP_INBOX_SETTLE_S"] = "2"

    def start(self) -> subprocess.Popen:
        store, port = str(self.root / "store"), str(self.port)
        command = (sys.executable, "-P", "-m", "solmap.flows.cli", "up", "--store", store)
        with (self.root / "up.log").open("ab") as log:
            return subprocess.Popen(
                (*command, "--inbox", str(self.inbox), "--port", port),
                env=self.environment,
                stdout=log,
                stderr=log,
            )

    @property
    def printed(self) -> str:
        return (self.root / "up.log").read_text()

    def children(self) -> list[int]:
        """Processes that work on this store."""
        mine = str(self.root)
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                environment = (folder / "environ").read_bytes()
                state = (folder / "stat").read_text().rsplit(")", 1)[1].split()[0]
            except OSError:
                continue
            if mine.encode() in environment and state != "Z" and int(folder.name) != os.getpid():
                found.append(int(folder.name))
        return found

    def is_up(self) -> bool:
        return bool(answer(f"{self.map}/healthz")) and self.deployments() is not None

    @property
    def password(self) -> str:
        file = self.root / "store" / "prefect" / "password"
        return file.read_text() if file.exists() else ""

    def query(self, path: str, body: dict | None = None, method: str | None = None):
        return answer(f"{self.engine}{path}", body, self.password, method)

    def deployments(self) -> list | None:
        found = self.query("/deployments/filter", {})
        return found if found and len(found) == 4 else None


@pytest.fixture
def up(tmp_path):
    (tmp_path / "inbox").mkdir()
    return Up(tmp_path)


@pytest.mark.skipif(sys.platform != "linux", reason="looks at processes in /proc")
def test_arriving_files_are_processed_and_no_process_is_left(up):
    process = up.start()
    try:
        until(up.is_up, "map and deployments are there")
        (up.inbox / "broken.img").write_bytes(b"no image at all")
        until(lambda: "the inbox was processed" in up.printed, "the inbox is processed")
        status = subprocess.run(
            (
                sys.executable,
                "-m",
                "solmap.flows.cli",
                "status",
                "--json",
                "--store",
                up.root / "store",
            ),
            capture_output=True,
            text=True,
            check=True,
        )
        assert "broken.img" in status.stdout
        schedules = {found["name"]: bool(found["schedules"]) for found in up.deployments()}
        assert schedules == {"inbox": True, "weekly": True, "on-demand": False}
        process.kill()
        process.wait()
        until(lambda: not up.children(), "all children end with a parent that was killed")
    finally:
        process.kill()

    again = up.start()
    try:
        until(up.is_up, "it comes up again")
        second = subprocess.run(
            (sys.executable, "-m", "solmap.flows.cli", "up", "--store", up.root / "store"),
            capture_output=True,
            text=True,
            check=False,
        )
        assert second.returncode != 0
        assert "another `solmap up` runs" in second.stderr + second.stdout
        again.send_signal(signal.SIGTERM)
        assert again.wait(60) == 0
        until(lambda: not up.children(), "all children end with an orderly stop", 20.0)
        assert up.printed.count("files came") == 1  # what was processed is not processed again
    finally:
        again.kill()


SHELL = [{"prefect.deployments.steps.run_shell_script": {"script": "touch MARK"}}]
KINDS = ("post", "put", "patch", "delete", "get")


def listening(process: subprocess.Popen) -> set[int]:
    """Ports of the process and all that it started; none of them is open to other machines."""
    found = set()
    for one in [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]:
        for connection in one.net_connections():
            if connection.status == psutil.CONN_LISTEN:
                assert connection.laddr.ip in {"127.0.0.1", "::1"}, (one.cmdline(), connection)
                found.add(connection.laddr.port)
    return found


def state_of(up: Up) -> dict:
    """State of the engine, and content of the store."""
    runs = up.query(
        "/flow_runs/filter", {"flow_runs": {"state": {"type": {"any_": ["SCHEDULED"]}}}}
    )
    products = sorted(str(path) for path in (up.root / "store" / "products").rglob("*"))
    kept = ("id", "pull_steps", "entrypoint", "path", "parameters", "paused", "job_variables")
    deployments = sorted(up.deployments(), key=lambda one: one["id"])
    return {
        "deployments": [{name: one[name] for name in kept} for one in deployments],
        "runs": sorted(run["id"] for run in runs),
        "flows": up.query("/flows/count", {}),
        "blocks": up.query("/block_documents/count", {}),
        "variables": up.query("/variables/count", {}),
        "automations": up.query("/automations/count", {}),
        "products": products,
    }


@pytest.mark.skipif(sys.platform != "linux", reason="looks at the ports of processes")
def test_an_unauthenticated_client_on_any_port_changes_nothing(up, tmp_path):
    process = up.start()
    try:
        until(up.is_up, "map and deployments are there")
        ports = listening(process)
        assert len(ports) >= 2  # engine and map
        mark = tmp_path / "mark"
        shell = json.loads(json.dumps(SHELL).replace("MARK", str(mark)))
        deployment = up.deployments()[0]["id"]
        # schedules make runs of their own for a while
        until(lambda: (a := state_of(up)) == (time.sleep(5), state_of(up))[1] and a, "it is quiet")
        before = state_of(up)
        requested = 0
        for port in ports:
            root = f"http://127.0.0.1:{port}"
            one = f"{root}/api/deployments/{deployment}"
            answer(f"{root}/api/deployments/filter", {})
            answer(one, {"pull_steps": shell}, method="PATCH")
            answer(f"{one}/create_flow_run", {})
            for path, methods in ((answer(f"{root}/openapi.json") or {}).get("paths", {})).items():
                for method in KINDS:
                    if method in methods:
                        url = re.sub(
                            r"\{[^}]*\}", deployment, f"{root}/api{path.removeprefix('/api')}"
                        )
                        answer(url, None if method == "get" else {}, method=method.upper())
                        requested += 1
            with socket.create_connection(("127.0.0.1", port), timeout=5) as raw:
                raw.sendall(os.urandom(4096) + b"\r\n\r\n")
        assert requested > 200
        time.sleep(10.0)  # a run would have been taken by now
        assert state_of(up) == before
        assert not mark.exists()
        assert process.poll() is None
    finally:
        process.terminate()
        process.wait(20)


def test_the_password_holder_can_name_neither_path_nor_program(up, tmp_path):
    """The run of a deployment runs its flow, whatever is written into the deployment."""
    process = up.start()
    try:
        until(up.is_up, "map and deployments are there")
        mark, module = tmp_path / "mark", tmp_path / "evil.py"
        shell = json.loads(json.dumps(SHELL).replace("MARK", str(mark)))
        module.write_text(f"from pathlib import Path\nPath({str(mark)!r}).touch()\n")
        found = {one["name"]: one for one in up.deployments()}["inbox"]
        reported = {"pull_steps": shell, "entrypoint": f"{module}:flow", "path": str(tmp_path)}
        reported |= {
            "enforce_parameter_schema": False,
            "job_variables": {"command": f"touch {mark}"},
        }
        up.query(f"/deployments/{found['id']}", reported, "PATCH")
        assert up.query(f"/deployments/{found['id']}")["pull_steps"] == shell
        runs = [{}, {"downlink": "/etc"}, {"store": str(tmp_path / "other")}, {"pipeline": "/x"}]
        start = f"/deployments/{found['id']}/create_flow_run"
        state = {"state": {"type": "SCHEDULED"}}
        made = [up.query(start, {"parameters": one, **state})["id"] for one in runs]

        def ended(run: str) -> str | None:
            kind = up.query(f"/flow_runs/{run}")["state"]["type"]
            return kind if kind in {"COMPLETED", "FAILED", "CRASHED"} else None

        states = [until(lambda run=run: ended(run), "the run ends") for run in made]
        assert states[0] == "COMPLETED"
        assert set(states[1:]) <= {"FAILED", "CRASHED"}  # it has no such parameter
        assert not mark.exists()
        assert not (tmp_path / "other").exists()
    finally:
        process.terminate()
        process.wait(20)


@pytest.mark.parametrize("after_s", [0.5, 4.0, None])
def test_sigterm_ends_all_processes_within_ten_seconds(up, after_s):
    process = up.start()
    try:
        if after_s is None:  # while a run is on
            until(up.is_up, "map and deployments are there")
            (up.inbox / "broken.img").write_bytes(b"no image at all")
            until(lambda: "files came" in up.printed, "a run was requested")
        time.sleep(after_s or 3.0)
        began = time.monotonic()
        process.terminate()
        process.wait(30)
        until(lambda: not up.children(), "all parts are gone", 5.0)
        assert time.monotonic() - began < 10.0
        if after_s is None or up.printed:  # else it was still being loaded
            assert up.printed.splitlines()[-1].startswith("stopped; what was made is kept")
    finally:
        process.kill()
