"""The run's own server of Prefect, killed while a flow is on."""

import os
import signal
import subprocess
import sys

import psutil

RUN = """
import sys
from pathlib import Path
from solmap.flows.runtime.engine import start_engine
from solmap.products.store.process import log_to_store
log_to_store(Path(sys.argv[1]), "flows")
start_engine(Path(sys.argv[1]))
from prefect import flow, task

@task
def one(number: int) -> int:
    return number

@flow
def many() -> int:
    first = one(1)
    print("begun", flush=True)
    input()  # the server dies now
    return first + one(2)

print("made", many(), flush=True)
"""


def test_a_run_continues_on_a_new_engine_after_the_first_one_ends(tmp_path):
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PREFECT_")}
    run = subprocess.Popen(
        [sys.executable, "-c", RUN, str(tmp_path)],
        env={**environment, "PREFECT_SERVER_ANALYTICS_ENABLED": "false"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert run.stdout is not None
    for line in run.stdout:
        if line.startswith("begun"):
            break
    (server,) = [
        child
        for child in psutil.Process(run.pid).children()
        if "solmap.flows.runtime.prefect_server" in child.cmdline()
    ]
    server.send_signal(signal.SIGKILL)
    server.wait(60)
    message, _ = run.communicate("\n", timeout=300)
    assert run.returncode == 0, message
    assert "made 3" in message
    kept = (tmp_path / "logs" / "flows.jsonl").read_text()
    assert "engine ended with -9; started again in 1 s" in kept
    assert not psutil.pid_exists(server.pid)
