"""Prefect and its dependencies install in combinations whose scheduler runs and never fires.

The pins in pyproject.toml avoid the two known ones; this test notices the next.
"""

import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from solmap.flows.runtime.engine import free_port

SCRIPT = """
from pathlib import Path
from prefect import flow, serve

@flow
def leave_a_mark(marker: str) -> None:
    with Path(marker).open("a") as file:
        file.write("fired\\n")

if __name__ == "__main__":
    serve(leave_a_mark.to_deployment("marks", interval=5, parameters={"marker": "MARKER"}))
"""


def wait_until(condition, seconds: float, what: str) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"{what} within {seconds} s"
        time.sleep(0.5)


def answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=2) as response:
            return response.status == 200
    except (urllib.error.URLError, OSError):
        return False


def stop(process: subprocess.Popen) -> None:
    """End a process and the ones it started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGTERM)
    try:
        process.wait(20)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.timeout(700)
def test_a_scheduled_deployment_starts_at_its_time(tmp_path: Path):
    port = free_port()
    marker = tmp_path / "marker"
    script = tmp_path / "deployment.py"
    script.write_text(SCRIPT.replace("MARKER", str(marker)))
    api = f"http://127.0.0.1:{port}/api"
    environment = {
        # not the engine, nor its password, of tests that ran before in this process
        **{name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")},
        "PREFECT_HOME": str(tmp_path / "prefect"),
        "PREFECT_API_URL": api,
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "PREFECT_RUNNER_POLL_FREQUENCY": "2",
        "PREFECT_API_SERVICES_SCHEDULER_LOOP_SECONDS": "2",
        "DO_NOT_TRACK": "1",
    }
    log = (tmp_path / "log").open("w")
    start = {"env": environment, "stdout": log, "stderr": log, "start_new_session": True}
    server = subprocess.Popen(
        [sys.executable, "-m", "prefect", "server", "start", "--port", str(port)], **start
    )
    try:
        wait_until(lambda: answers(f"{api}/health"), 300, "the server answers")
        served = subprocess.Popen([sys.executable, str(script)], **start)
        try:
            wait_until(marker.exists, 300, "the deployment fires")
        finally:
            stop(served)
    finally:
        stop(server)
        log.close()
