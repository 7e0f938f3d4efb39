"""By configuration alone: Dask and PostgreSQL give what the embedded run gives, byte for byte."""

import hashlib
import json
import os
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
import sqlalchemy as sa

from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from tests.support.live_server import running

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]
OWN = ("PREFECT_", "SOLMAP_")
"""Variables of the tests' own engine, which runs here must not see."""


@pytest.fixture(scope="module")
def downlink(tmp_path_factory) -> Path:
    from solmap.flows.simulation import write_downlink  # noqa: PLC0415 - slow to import

    folder = tmp_path_factory.mktemp("small")
    write_downlink(folder, WorldParams("hills", TraverseParams(stops=2), pairs=2), seed=3)
    return folder


def environment(**settings: str) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(OWN)}
    return {**kept, "SOLMAP_PIPELINE": "quicklook", **settings}


def run(downlink: Path, store: Path, settings: dict[str, str]) -> str:
    command = (
        sys.executable,
        "-m",
        "solmap.flows.cli",
        "run",
        str(downlink),
        "--store",
        str(store),
    )
    ran = subprocess.run(
        command, env=environment(**settings), capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout + ran.stderr


def products(store: Path) -> dict[str, str]:
    """Checksums of all products by their address."""
    return {
        str(path.relative_to(store)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in (store / "products").rglob("*")
        if path.is_file() and not path.name.endswith(".provenance.json")
    }


def layers(store: Path, settings: dict[str, str]) -> list[dict]:
    """What a server over the store lists, but for when it was made."""
    command = [sys.executable, "-m", "solmap.flows.cli", "serve", "--store", str(store), "--port"]
    with running(command, settings) as server:
        url = f"{server.address}/api/missions/MER2/layers"
        with urllib.request.urlopen(url, timeout=60) as answer:
            listed = json.loads(answer.read())
    return [{key: value for key, value in layer.items() if key != "made_at"} for layer in listed]


@pytest.fixture(scope="module")
def embedded(downlink, tmp_path_factory) -> Path:
    store = tmp_path_factory.mktemp("embedded") / "store"
    run(downlink, store, {})
    return store


def test_two_workers_of_dask_make_the_same_products(downlink, embedded, tmp_path):
    settings = {"SOLMAP_TASK_RUNNER": "dask", "SOLMAP_TASK_WORKERS": "2"}
    run(downlink, tmp_path / "store", settings)
    assert products(tmp_path / "store") == products(embedded)


def test_four_workers_and_postgresql_for_all_make_and_serve_the_same(
    downlink, embedded, tmp_path, postgres
):
    catalogue, prefect = postgres.database(), postgres.database("asyncpg")
    settings = {
        "SOLMAP_TASK_RUNNER": "dask",
        "SOLMAP_TASK_WORKERS": "4",
        "SOLMAP_CATALOGUE_URL": catalogue,
        "PREFECT_API_DATABASE_CONNECTION_URL": prefect,
    }
    store = tmp_path / "store"
    run(downlink, store, settings)
    assert products(store) == products(embedded)
    assert not list(store.rglob("catalogue.sqlite"))
    assert not list(store.rglob("prefect.db"))
    engine = sa.create_engine(prefect.replace("asyncpg", "psycopg"))
    with engine.connect() as connection:
        names = set(connection.scalars(sa.text("SELECT name FROM flow_run")))
    engine.dispose()
    assert {"downlink MER2 sol 155-156", "MER2 sol 155", "MER2 sol 156"} <= names
    listed = layers(store, settings)
    assert len(listed) > 20
    assert listed == layers(embedded, {})


def test_a_second_run_skips_unchanged_inputs(downlink, embedded):
    before = products(embedded)
    message = run(downlink, embedded, {})
    assert "match stereo pairs" not in message
    assert "converged" in message  # the outcome of the sols is reported nevertheless
    assert products(embedded) == before
