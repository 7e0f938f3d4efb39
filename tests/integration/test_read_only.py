"""A read-only store is served and listed, and changes are refused with the reason."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from solmap.products.catalogue.workspace import Workspace
from tests.support.old_store import EDITS, LAYERS, unpack_old_store

NOBODY = 65534
_READ_ONLY = 'mount --bind "$0" "$0" && mount -o remount,ro,bind "$0" && exec "$@"'
_REQUEST = """
import json, sys, tempfile
from pathlib import Path
from fastapi.testclient import TestClient
from typer.testing import CliRunner
from solmap.flows.cli import app
from solmap.gis_server.app import create_app

root, token = sys.argv[1:]
told = {}
def call(*command):
    done = CliRunner().invoke(app, [*command, "--store", root])
    told[" ".join(command[:2])] = done.exit_code, done.output
for command in ("status", "products", "positions", "prune", "check", "token list"):
    call(*command.split())
call("report", "MER2", "156", "--out", tempfile.mkdtemp() + "/report.html")
changes = "prune --yes", "check --repair", "token add ada", "adjust --overall --mission MER2"
for command in changes:
    call(*command.split())
ties = Path(sys.argv[1] + ".ties.csv")
call("ties", str(ties))
with TestClient(create_app(Path(root))) as client:
    layers = client.get("/api/missions/MER2/layers").json()
    told["layers"] = len(layers)
    told["edits"] = len(client.get("/api/missions/MER2/edits").json())
    told["runs"] = client.get("/api/runs").status_code
    statuses = []
    for layer in layers:
        for url in (layer["features"], layer["download"], layer["provenance"]):
            statuses += [client.get(url).status_code] if url else []
    told["statuses"] = sorted(set(statuses))
    note = {"geometry": {"type": "Point", "coordinates": [0, 0]}, "text": "a stone"}
    client.headers["Authorization"] = f"Bearer {token}"
    answer = client.post("/api/missions/MER2/edits/annotations", json=note)
    told["note"] = answer.status_code, answer.text
print("told", json.dumps(told))
"""


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder that others may look into."""
    made = Path(tempfile.mkdtemp(prefix="solmap-read-only-"))
    made.chmod(0o755)
    (made / "home").mkdir()
    (made / "home").chmod(0o777)
    yield made
    for path in (made, *made.rglob("*")):
        path.chmod(path.stat().st_mode | 0o200)
    shutil.rmtree(made)


def requested(root: Path, *before: str) -> dict[str, Any]:
    """Answers of commands and server in a process of its own that may only read the store."""
    token = (root / "token.txt").read_text().strip()
    ties = root.with_name(f"{root.name}.ties.csv")
    ties.write_text("action,first_image,first_sample,first_line\nveto,2n1,2.0,3.0\n")
    command = [*before, sys.executable, "-c", _REQUEST, str(root), token]
    environment = {**os.environ, "HOME": str(root.parent / "home"), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=environment, cwd="/"
    )
    assert "told " in done.stdout, done.stderr[-3000:]
    return json.loads(done.stdout.rpartition("told ")[2])


def files_of(root: Path) -> dict[str, int]:
    """Every file and its date."""
    return {str(one.relative_to(root)): one.stat().st_mtime_ns for one in root.rglob("*")}


def holds(reported: dict[str, Any], *, has_token: bool) -> None:
    """What may be done is done, what may not is refused in one line."""
    for command in ("status", "products", "positions", "prune", "check", "report MER2"):
        assert reported[command][0] == 0, reported[command]
    changes = ["prune --yes", "check --repair", "token add", "ties"]
    for command in (*changes, *(["adjust --overall"] if has_token else ())):  # it starts processes
        name = next(one for one in reported if one.startswith(command))
        code, output = reported[name]
        assert code == 1, output
        assert "is read-only" in output
        assert len(output.strip().splitlines()) == 1
    assert reported["layers"] > LAYERS / 2
    assert reported["edits"] == EDITS
    assert reported["statuses"] == [200]
    assert reported["runs"] == 200
    status, text = reported["note"]
    assert status == 403, text
    assert ("is read-only" if has_token else "belongs to another user") in text
    assert reported["token list"][0] == (0 if has_token else 1)


@pytest.fixture(params=["as an earlier version left it", "of this version"])
def store(request, folder) -> Path:
    root = unpack_old_store(folder)
    if request.param == "of this version":
        Workspace.open(root).catalogue.engine.dispose()
    return root


@pytest.mark.slow
def test_a_store_on_a_read_only_disk_is_served(store):
    probe = ["unshare", "-m", "sh", "-c", _READ_ONLY, str(store), "true"]
    if shutil.which("unshare") is None or subprocess.run(probe, check=False).returncode:
        pytest.skip("this user may not mount")
    before = files_of(store)
    holds(requested(store, "unshare", "-m", "sh", "-c", _READ_ONLY, str(store)), has_token=True)
    assert files_of(store) == before


@pytest.mark.slow
def test_a_store_of_another_user_is_served(store):
    for path in (store, *store.rglob("*")):
        path.chmod(path.stat().st_mode & 0o555)
    before = files_of(store)
    as_other = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    holds(requested(store, *(as_other if os.geteuid() == 0 else ())), has_token=os.geteuid() != 0)
    assert files_of(store) == before


@pytest.mark.slow
def test_a_store_in_use_by_another_user_is_served(store):
    if os.geteuid() != 0:
        pytest.skip("there is no other user")
    workspace = Workspace.open(store)
    with workspace.catalogue.engine.connect() as connection:  # its log lies beside it
        connection.exec_driver_sql("SELECT 1 FROM missions")
        workspace.catalogue.append_event("run.changed", {})
        as_other = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
        holds(requested(store, *as_other), has_token=False)
    workspace.catalogue.engine.dispose()
