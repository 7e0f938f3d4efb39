"""`solmap up`: the real engine, scheduler, map and inbox on one machine."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

PATIENCE_S = 180.0
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def free_ports(number: int) -> list[int]:
    probes = [socket.socket() for _ in range(number)]
    for probe in probes:
        probe.bind(("127.0.0.1", 0))
    ports = [probe.getsockname()[1] for probe in probes]
    for probe in probes:
        probe.close()
    return ports


def until(holds, what: str, seconds: float = PATIENCE_S):
    end = time.monotonic() + seconds
    while not (answer := holds()):
        assert time.monotonic() < end, f"{what} within {seconds:.0f} s"
        time.sleep(0.3)
    return answer


def answer(url: str, body: dict | None = None):
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"content-type": "application/json"})
    try:
        with urllib.request.urlopen(request, timeout=5) as response:
            return json.loads(response.read() or b"null")
    except (urllib.error.URLError, OSError, ValueError):
        return None


class Up:
    """`solmap up` on a store of its own."""

    def __init__(self, root: Path) -> None:
        self.root, self.inbox = root, root / "inbox"
        engine, self.port = free_ports(2)
        self.map = f"http://127.0.0.1:{self.port}"
        self.engine = f"http://127.0.0.1:{engine}/api"
        self.environment = {**os.environ, "SOLMAP_ENGINE_PORT": str(engine)}
        self.environment.pop("PREFECT_API_URL", None)
        self.environment.pop("PREFECT_HOME", None)
        self.environment["PREFECT_RUNNER_POLL_FREQUENCY"] = "2"

    def start(self) -> subprocess.Popen:
        store, port = str(self.root / "store"), str(self.port)
        command = (sys.executable, "-m", "solmap.flows.cli", "up", "--store", store)
        with (self.root / "up.log").open("ab") as log:
            return subprocess.Popen(
                (*command, "--inbox", str(self.inbox), "--port", port),
                env=self.environment,
                stdout=log,
                stderr=log,
            )

    @property
    def said(self) -> str:
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

    def deployments(self) -> list | None:
        found = answer(f"{self.engine}/deployments/filter", {})
        return found if found and len(found) == 4 else None


@pytest.fixture
def up(tmp_path):
    (tmp_path / "inbox").mkdir()
    return Up(tmp_path)


@pytest.mark.skipif(sys.platform != "linux", reason="looks at processes in /proc")
def test_files_that_arrive_are_processed_and_nothing_outlives_it(up):
    process = up.start()
    try:
        until(up.is_up, "map and deployments are there")
        (up.inbox / "broken.img").write_bytes(b"no image at all")
        until(lambda: "the inbox was processed" in up.said, "the inbox is processed")
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
        assert up.said.count("files came") == 1  # what was processed is not processed again
    finally:
        again.kill()
