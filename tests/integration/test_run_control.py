"""Runs are cancelled and run again, deployments paused: over HTTP, by the real engine."""

import json
import os
import signal
import sys
import time
from pathlib import Path

import httpx
import pytest

from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.products.catalogue.tokens import Role, Tokens
from tests.integration.test_up import Up, answer, until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1200),
    pytest.mark.skipif(sys.platform != "linux", reason="looks at processes in /proc"),
]


@pytest.fixture
def up(tmp_path):
    from solmap.flows.simulation import write_downlink  # noqa: PLC0415 - slow to import

    (tmp_path / "inbox").mkdir()
    write_downlink(tmp_path / "world", WorldParams("hills", TraverseParams(stops=2)), seed=11)
    machine = Up(tmp_path)
    process = machine.start()
    try:
        until(machine.is_up, "map and deployments are there")
        yield machine
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(60)


def post(up, path, token, body=None):
    headers = {"Authorization": f"Bearer {token}"}
    sent = httpx.post(f"{up.map}/api/{path}", json=body, headers=headers, timeout=60)
    assert sent.status_code == 202, sent.text
    return sent.json()


def engine(up):
    return answer(f"{up.map}/api/engine") or {"is_up": False, "deployments": [], "queued": []}


def deployment(up, name):
    return next((one for one in engine(up)["deployments"] if one["name"] == name), {})


def runs(up, state):
    return [one for one in answer(f"{up.map}/api/runs")["runs"] if one["state"] == state]


def alone(left):
    """What stays of processes, where that is no more than the scheduler's tracker of resources."""
    found = [Path(f"/proc/{pid}/cmdline").read_bytes() for pid in left]
    return found if all(b"resource_tracker" in line for line in found) else None


def test_runs_are_cancelled_with_their_processes_and_restarted(up):
    _, token = Tokens.of(up.root / "store").add("Ada", Role.OPERATOR)
    until(lambda: len(engine(up)["deployments"]) == 4 and engine(up)["is_up"], "a state is there")
    idle = set(up.children())

    post(up, "engine/deployments/overall-adjustment/weekly/pause", token)
    weekly = "overall-adjustment/weekly"
    until(lambda: deployment(up, weekly).get("is_paused"), "the deployment is paused")
    until(lambda: deployment(up, weekly)["next_run"] is None, "nothing is scheduled")
    command = b"solmap.flows.service.deployments"
    (scheduler,) = [pid for pid in idle if command in Path(f"/proc/{pid}/cmdline").read_bytes()]

    for file in (up.root / "world").iterdir():
        file.rename(up.inbox / file.name)
    (run,) = until(
        lambda: [one for one in runs(up, "running") if "match" in (one["stage"] or "")],
        "a run matches pairs",
        400,
    )
    until(lambda: list((up.root / "store" / "products").rglob("*.*")), "something is made")
    assert run["actions"] == ["cancel"]
    assert run["parameters"] == {"settle_s": 2.0}
    post(up, "runs", token, {"kind": "region", "mission": None})
    (queued,) = until(lambda: engine(up)["queued"], "another run waits")
    assert queued["deployment"] == "refresh-region/on-demand"
    post(up, f"runs/{queued['flow_run']}/cancel", token)
    until(lambda: not engine(up)["queued"], "it waits no more")

    working = set(up.children()) - idle
    assert working
    products = (up.root / "store" / "products").rglob("*.*")
    made = {path: path.stat().st_mtime_ns for path in products if path.is_file()}
    assert made
    post(up, f"runs/{run['id']}/cancel", token)
    (ended,) = until(lambda: runs(up, "cancelled"), "the run is cancelled")
    assert (ended["id"], ended["actions"]) == (run["id"], ["restart"])
    left = until(lambda: alone(working & set(up.children())), "its processes have ended", 60.0)
    assert len(left) == 1
    assert all(path.is_file() for path in made)
    until(lambda: "the inbox was processed: cancelled" in up.printed, "no run follows by itself")
    assert not runs(up, "running")

    post(up, f"runs/{run['id']}/restart", token)
    until(lambda: runs(up, "running"), "it is run again")
    (done,) = until(lambda: runs(up, "succeeded"), "the run ends", 900.0)
    assert done["parameters"] == run["parameters"]
    assert {path: path.stat().st_mtime_ns for path in made} == made  # nothing was made again
    until(lambda: deployment(up, "downlink/inbox")["last_state"] == "completed", "the engine too")

    os.kill(scheduler, signal.SIGKILL)
    until(lambda: "scheduler ended" in up.printed, "its end is noticed")
    until(lambda: deployment(up, weekly)["is_ready"], "it is started again")
    time.sleep(10.0)  # its deployments have been applied again by now
    assert deployment(up, weekly)["is_paused"]
    post(up, "engine/deployments/overall-adjustment/weekly/resume", token)
    until(lambda: deployment(up, weekly)["next_run"], "runs are scheduled again")
    kept = json.loads((up.root / "store" / "engine.json").read_text())
    assert kept["is_up"]
