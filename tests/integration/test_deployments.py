"""Deployments: typed and documented parameters, tags, schedules; those of prefect.yaml at work."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest
import yaml

from solmap.config.settings import Settings
from solmap.flows.runtime.engine import free_port

ROOT = Path(__file__).resolve().parents[2]
PREFECT = Path(sys.executable).with_name("prefect")


@pytest.fixture(scope="module")
def deployed(engine, tmp_path_factory):  # noqa: ARG001 - deployed to it
    """All deployments, as the engine gives them back."""
    from prefect.client.orchestration import get_client  # noqa: PLC0415 - after its settings

    from solmap.flows.service.deployments import served  # noqa: PLC0415 - as above

    settings = Settings(inbox=tmp_path_factory.mktemp("up") / "inbox")
    made = [flow.to_deployment(**options) for flow, options in served(settings)]
    with get_client(sync_client=True) as client:
        return {one.flow_name: client.read_deployment(one.apply()) for one in made}


def test_every_parameter_of_every_deployment_has_a_type_and_a_description(deployed):
    assert set(deployed) == {"downlink", "overall-adjustment", "refresh-region", "fetch-archive"}
    for name, deployment in deployed.items():
        for parameter, schema in deployment.parameter_openapi_schema["properties"].items():
            assert schema.get("description"), f"{name}: {parameter} is not described"
            assert {"type", "anyOf", "format"} & set(schema), f"{name}: {parameter} has no type"


def test_deployments_have_descriptions_tags_and_the_schedules_of_the_settings(deployed):
    for deployment in deployed.values():
        assert deployment.description
        assert "solmap" in deployment.tags
    crons = {name: [s.schedule.cron for s in d.schedules] for name, d in deployed.items()}
    assert crons["downlink"] == [Settings().downlink_cron]
    assert crons["overall-adjustment"] == [Settings().overall_cron]
    assert crons["refresh-region"] == crons["fetch-archive"] == []


def test_the_deployments_file_agrees_with_the_served_deployments(deployed):
    from prefect.flows import load_flow_from_entrypoint  # noqa: PLC0415 - after the engine is set

    written = yaml.safe_load((ROOT / "prefect.yaml").read_text())["deployments"]
    assert len(written) == len(deployed)
    for reported in written:
        flow = load_flow_from_entrypoint(reported["entrypoint"])
        served = deployed[flow.name]
        assert reported["name"] == served.name
        assert reported["tags"] == served.tags
        assert reported["description"] == served.description
        crons = [schedule["cron"] for schedule in reported.get("schedules", [])]
        assert crons == [schedule.schedule.cron for schedule in served.schedules]
        assert "parameters" not in reported
        flow.validate_parameters(_requested(flow))


def _requested(flow):
    """Parameters of a fetch."""
    return {"mission": "MER2", "sols": "155"} if flow.name == "fetch-archive" else {}


def test_the_name_of_a_run_states_its_task():
    from solmap.flows.runtime.run_page import format_sols  # noqa: PLC0415 - imports Prefect

    assert format_sols([158, 156, 157]) == "156-158"
    assert format_sols([156, 158, 159, 163]) == "156,158-159,163"
    assert format_sols(range(1, 500, 2)) == "1-499 (250 sols)"


def test_a_worker_with_a_relative_store_path_is_refused(monkeypatch):
    from solmap.config.records import ConfigError  # noqa: PLC0415 - as above
    from solmap.flows.service.deployed import adjust_missions  # noqa: PLC0415 - as above

    monkeypatch.setenv("SOLMAP_STORE", "store")
    with pytest.raises(ConfigError, match="SOLMAP_STORE is store; name the store by its whole"):
        adjust_missions.fn()


@pytest.fixture(scope="module")
def installation(tmp_path_factory):
    """Environment and folder of commands, client of a Prefect server with a password."""
    folder = tmp_path_factory.mktemp("deployed")
    inbox = folder / "inbox"
    inbox.mkdir()
    shutil.copy(ROOT / "prefect.yaml", folder)  # the only file of a clone that deploying reads
    archive = folder / "archive.toml"
    archive.write_text(
        "[transfer]\nattempts = 1\nfirst_wait_s = 0.01\ntimeout_s = 5.0\n"
        '[missions.MER2]\ntitle = "Spirit"\nbase_urls = ["http://127.0.0.1:9/"]\n'
        'volumes = { navcam = "mer2no_0xxx" }\n'
    )
    password = f"solmap:{folder.name}"
    port = free_port()
    environment = {
        **{name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ},
        "PREFECT_HOME": str(folder / "prefect"),
        "PREFECT_API_URL": f"http://127.0.0.1:{port}/api",
        "PREFECT_API_AUTH_STRING": password,
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "DO_NOT_TRACK": "1",
        "SOLMAP_STORE": str(folder / "store"),
        "SOLMAP_INBOX": str(inbox),
        "SOLMAP_ARCHIVE": str(archive),
    }
    command = [PREFECT, "server", "start", "--host", "127.0.0.1", "--port", str(port), "--no-ui"]
    with (folder / "server.log").open("wb") as log:
        server = subprocess.Popen(
            command,
            env={**environment, "PREFECT_SERVER_API_AUTH_STRING": password},
            cwd=folder,
            stdout=log,
            stderr=log,
        )
    try:
        with httpx.Client(base_url=f"{environment['PREFECT_API_URL']}/", timeout=60) as client:
            client.auth = tuple(password.split(":"))
            wait_for(lambda: is_ready(client), 120, "Prefect's server answers")
            yield environment, folder, client
    finally:
        server.terminate()
        server.wait(60)


def is_ready(client):
    try:
        return client.get("health").status_code == 200
    except httpx.TransportError:
        return False


def wait_for(condition, seconds, what):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"{what} within {seconds} s"
        time.sleep(0.2)


@pytest.mark.slow  # a wrong change fails the test that the file agrees with what is served
def test_the_file_of_deployments_deploys_and_every_deployment_runs(installation):
    environment, folder, client = installation

    def prefect(*words):
        done = subprocess.run(
            [PREFECT, "--no-prompt", *words],
            env=environment,
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    anonymous = httpx.post(f"{environment['PREFECT_API_URL']}/deployments/filter", json={})
    assert anonymous.status_code == 401
    prefect("work-pool", "create", "solmap", "--type", "process")
    prefect("deploy", "--all")
    listed = prefect("deployment", "ls")
    requested = {
        "downlink/inbox": {"settle_s": 0.0},
        "overall-adjustment/weekly": {},
        "refresh-region/on-demand": {},
        "fetch-archive/on-demand": {"mission": "MER2", "sols": "155"},
    }
    runs = {}
    for name, parameters in requested.items():
        assert name in listed
        known = client.get(f"deployments/name/{name}").json()
        made = client.post(
            f"deployments/{known['id']}/create_flow_run", json={"parameters": parameters}
        )
        assert made.is_success, made.text
        runs[name] = made.json()["id"]
    prefect("worker", "start", "--pool", "solmap", "--run-once", "--limit", "4")
    states = {name: client.get(f"flow_runs/{run}").json()["state"] for name, run in runs.items()}
    ended = {name: state["type"] for name, state in states.items()}
    assert ended == {**dict.fromkeys(requested, "COMPLETED"), "fetch-archive/on-demand": "FAILED"}
    assert "127.0.0.1 cannot be reached" in states["fetch-archive/on-demand"]["message"]
